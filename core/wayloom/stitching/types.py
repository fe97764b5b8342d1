"""Meeting of two drives: a measured relative pose between a submap of each."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Meeting:
    """One registration of a submap of drive b to a submap of drive a.

    submap_a, submap_b  index in the drive's submaps, in the order of the road
    T_a_b       (4, 4) from the frame of submap b to that of submap a, m
    covariance  (6, 6) of its left perturbation (v, omega), in the frame of submap a: T_a_b <- exp(xi) T_a_b; m^2 and rad^2
    """

    drive_a: str
    submap_a: int
    drive_b: str
    submap_b: int
    T_a_b: FloatArray
    covariance: FloatArray
