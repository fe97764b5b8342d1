"""Motion of a rigid body as a function of time: camera poses and sensor twists."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3

F64 = NDArray[np.float64]
TWIST_STEP_S = 1e-3


class Motion(Protocol):
    """A rigid body's smooth pose as a function of time from start_s to end_s (s since the city's time zero)."""

    @property
    def start_s(self) -> float: ...
    @property
    def end_s(self) -> float: ...

    def pose(self, t_s: F64) -> F64:
        """t_s (M,) s since the city's time zero to T_enu_body (M, 4, 4)."""
        ...


def camera_poses(motion: Motion, T_body_cam: F64, t_s: F64) -> F64:
    """T_enu_cam (M, 4, 4) of a camera fixed to the body, at t_s (M,)."""
    return np.asarray(motion.pose(t_s) @ T_body_cam)


def twists(motion: Motion, T_body_sensor: F64, t_s: F64) -> F64:
    """(M, 6) velocity m/s, angular rate rad/s of a sensor fixed to the body, in its own axes, by differences within the drive."""
    before_s, after_s = np.maximum(t_s - TWIST_STEP_S, motion.start_s), np.minimum(t_s + TWIST_STEP_S, motion.end_s)
    before, after = (camera_poses(motion, T_body_sensor, t) for t in (before_s, after_s))
    steps = np.array([se3.log(T) for T in se3.inverse(before) @ after])
    return np.asarray(steps / (after_s - before_s)[:, None])
