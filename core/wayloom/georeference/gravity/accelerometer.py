"""Up by an accelerometer: its specific force, less the acceleration that the odometry saw, over windows of time.

With C the rotation of the IMU in the odometry's world, the mean of C f over a window is g up + (v_1 - v_0) / T: what shakes within
the window falls out, and of the odometry only its velocities at both ends count.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayloom.georeference.fixes import interpolate
from wayloom.logs.types import ImuTrack
from wayloom.odometry.types import Trajectory

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
WINDOW_NS, END_NS = 4_000_000_000, 400_000_000
GRAVITY_M_S2 = 9.81
LEAST_SAMPLES = 20


@dataclass(frozen=True, slots=True)
class ForceWindows:
    """frame (n,) in the middle of each window; up_cam (n, 3) unit vectors in its camera; sigma_rad (n,)."""

    frame: IntArray
    up_cam: FloatArray
    sigma_rad: FloatArray


def up_by_accelerometer(
    imu: ImuTrack, T_cam_imu: FloatArray, trajectory: Trajectory, scale_sigma: float, position_m: float
) -> ForceWindows:
    """Windows of WINDOW_NS that were tracked throughout.

    scale_sigma : of the odometry; position_m : its sigma from one end of END_NS to the other
    """
    T_world_imu = trajectory.T_world_cam @ T_cam_imu
    frames, ups, sigmas = [], [], []
    edges = np.arange(trajectory.t_ns[0] + END_NS, trajectory.t_ns[-1] - END_NS, WINDOW_NS)
    for start, stop in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        first, last = np.searchsorted(trajectory.t_ns, [start - END_NS, stop + END_NS])
        whole = slice(int(first), int(last) + 1)
        if not trajectory.tracked[whole].all() or np.ptp(trajectory.segment[whole]) > 0:
            continue
        rows = np.flatnonzero((imu.t_ns >= start) & (imu.t_ns < stop))
        if len(rows) < LEAST_SAMPLES:
            continue
        R = _at(trajectory.t_ns, T_world_imu, imu.t_ns[rows])[:, :3, :3]
        force = np.einsum("nij,nj->i", R, imu.specific_force[rows]) / len(rows)
        v = [_velocity(trajectory.t_ns, T_world_imu, time) for time in (start, stop)]
        acceleration = (v[1] - v[0]) / (1e-9 * (stop - start))
        up = force - acceleration
        middle = int(np.searchsorted(trajectory.t_ns, (start + stop) // 2))
        frames.append(middle)
        ups.append(trajectory.T_world_cam[middle, :3, :3].T @ (up / np.linalg.norm(up)))
        speed_m_s = position_m / (1e-9 * END_NS)
        error = np.hypot(scale_sigma * float(np.linalg.norm(acceleration)), speed_m_s / (1e-9 * WINDOW_NS))
        sigmas.append(error / GRAVITY_M_S2)
    return ForceWindows(np.array(frames, np.int64), np.array(ups).reshape(-1, 3), np.array(sigmas))


def _at(t_ns: IntArray, T: FloatArray, time_ns: IntArray) -> FloatArray:
    """(M, 4, 4) poses T (N, 4, 4) at times between the frames'."""
    before = np.clip(np.searchsorted(t_ns, time_ns, side="right") - 1, 0, len(t_ns) - 2)
    share = (time_ns - t_ns[before]) / (t_ns[before + 1] - t_ns[before])
    return interpolate(T[before], T[before + 1], share)


def _velocity(t_ns: IntArray, T: FloatArray, time_ns: int) -> FloatArray:
    """(3,) m/s by the places END_NS before and after."""
    ends = _at(t_ns, T, np.array([time_ns - END_NS, time_ns + END_NS]))
    return np.asarray((ends[1, :3, 3] - ends[0, :3, 3]) / (2e-9 * END_NS))
