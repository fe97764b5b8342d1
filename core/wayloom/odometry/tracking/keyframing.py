"""Keyframe decision: change of view, brightness and residual since the newest keyframe."""

import math

from numpy import float64
from numpy.typing import NDArray

from wayloom.odometry.kernels.tracking import mean_flow
from wayloom.odometry.settings import OdometrySettings
from wayloom.odometry.tracking.alignment import Alignment, Reference

FIT_FACTOR = 2.0
STILL_PX = 1.0
"""Flow under which the car stands: what moves then is others, a new keyframe would give no depth, and clouds that come and go would
make one each time."""


def reason(
    fit: Alignment, reference: Reference, camera: NDArray[float64], first_rms: float, image_extent: int, settings: OdometrySettings
) -> str | None:
    """Why the view has changed enough for a keyframe, or None: while the car moves flow, flow without rotation (occlusions) and
    brightness together (Engel et al. 2018, sec. 3.1) or a residual twice that of the first frame after the keyframe; always half of
    the points out of view.

    camera (4,) of the finest level; image_extent: width + height in px, of which the thresholds are shares.
    """
    flow, shift = mean_flow(reference.levels[0], fit.T_frame_keyframe, camera)
    shares = {
        "flow": flow / (settings.keyframe_flow * image_extent),
        "parallax": shift / (settings.keyframe_shift * image_extent),
        "brightness": abs(math.log(max(fit.brightness[0], 1e-3))) / settings.keyframe_brightness,
    }
    moves = flow > STILL_PX
    if moves and sum(shares.values()) > 1.0:
        return max(shares, key=lambda name: shares[name])
    if fit.visible < 0.5:
        return "points out of view"
    if moves and fit.rms > FIT_FACTOR * first_rms:
        return "residual"
    return None
