"""When a frame is lost, in the odometry's own measures. Being lost is an outcome that is reported, never a crash."""

import math

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.odometry.settings import OdometrySettings
from wayloom.odometry.track import Alignment

FloatArray = NDArray[np.float64]
ALWAYS_BELIEVED_M = 0.3
MAX_SPEED_M_S = 90.0


def is_blank(image: NDArray[np.uint8], min_contrast: float) -> bool:
    """Whether an image (h, w) shows nothing: black, white, or grey all over. Looks at every fourth row."""
    return float(image[::4].std()) < min_contrast


def fit_failure(fit: Alignment, settings: OdometrySettings) -> str | None:
    """Why an alignment cannot be right, in words, or None."""
    if not (np.isfinite(fit.T_frame_keyframe).all() and np.isfinite(fit.brightness).all() and math.isfinite(fit.rms)):
        return "the alignment is not finite"
    if fit.visible < settings.min_visible:
        return f"{100 * fit.visible:.0f} % of the keyframe's points are in view"
    if fit.saturated > settings.max_saturated:
        return f"{100 * fit.saturated:.0f} % of the points fit worse than {settings.cutoff:g} grey levels"
    if not 1.0 / settings.max_gain < fit.brightness[0] < settings.max_gain:
        return f"the image is {fit.brightness[0]:.2g} times as bright as the keyframe"
    return None


def motion_failure(
    T_cam_world: FloatArray, T_last: FloatArray, T_expected: FloatArray, dt_s: float, starting: bool, settings: OdometrySettings
) -> str | None:
    """Why a motion cannot be real, in words, or None. T_cam_world (4, 4) of the frame, of the last one, and by constant motion."""
    motion = se3.log(T_cam_world @ se3.inverse(T_last))
    way, turn = float(np.linalg.norm(motion[:3])), float(np.linalg.norm(motion[3:]))
    if turn > settings.max_turn_rate * dt_s + 0.05:
        return f"a turn of {math.degrees(turn):.1f} deg in {dt_s:.2f} s"
    if way > MAX_SPEED_M_S * dt_s + ALWAYS_BELIEVED_M:
        return f"a way of {way:.2f} m in {dt_s:.2f} s"
    surprise = float(np.linalg.norm(se3.inverse(T_cam_world)[:3, 3] - se3.inverse(T_expected)[:3, 3]))
    if not starting and surprise > settings.max_acceleration * dt_s**2 + ALWAYS_BELIEVED_M + 0.2 * way:
        return f"{surprise:.2f} m from where constant motion leads"
    return None
