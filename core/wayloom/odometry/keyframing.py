"""When a frame becomes a keyframe."""

import math

from numpy import float64
from numpy.typing import NDArray

from wayloom.odometry.kernels.tracking import mean_flow
from wayloom.odometry.settings import OdometrySettings
from wayloom.odometry.track import Alignment, Reference


def is_due(
    fit: Alignment, reference: Reference, camera: NDArray[float64], first_rms: float, image_extent: int, settings: OdometrySettings
) -> bool:
    """Whether the view has changed enough: flow, flow without rotation (occlusions) and brightness together (Engel et al. 2018,
    sec. 3.1), or half of the points out of view, or a residual twice that of the first frame after the keyframe.

    camera (4,) of the finest level; image_extent: width + height in px, of which the thresholds are shares.
    """
    flow, shift = mean_flow(reference.levels[0], fit.T_frame_keyframe, camera)
    change = flow / (settings.keyframe_flow * image_extent) + shift / (settings.keyframe_shift * image_extent)
    change += abs(math.log(max(fit.brightness[0], 1e-3))) / settings.keyframe_brightness
    return bool(change > 1.0 or fit.visible < 0.5 or fit.rms > 2.0 * first_rms)
