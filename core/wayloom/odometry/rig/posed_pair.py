"""A keyframe's stereo pair with its pose and the rectification of its right image, as calibration observes it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayloom.odometry.rig.rows import RightRectifier

Image = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class PosedPair:
    """A pair of the log and what the odometry knows of it.

    frame           its index in the drive
    left, right     (h, w) uint8, as the log gives them
    T_cam_world     (4, 4), as last estimated
    right_rectifier of the right camera as far as it is known
    disparity_bias  px, δ of u_right = u_left - bf rho - δ
    """

    frame: int
    left: Image
    right: Image
    T_cam_world: NDArray[np.float64]
    right_rectifier: RightRectifier
    disparity_bias: float
