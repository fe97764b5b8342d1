"""Up by an accelerometer: its specific force, less the acceleration that the odometry saw, over windows of time.

With C the rotation of the IMU in the odometry's world, a mean of C f over a window is g up + (v_1 - v_0) / T: what shakes within
the window falls out, and of the odometry only its velocities at both ends count. A velocity of the odometry is a step over the
time 2 h about an end, the mean velocity of that time; so the difference of two of them is the integral of the acceleration under a
trapezoid, one within the window and falling to nothing from h before an end to h after it. The mean of C f takes the same weights:
with others a window that ends in a bend is wrong by the change of the acceleration there.

The odometry's scale errs by shares s_0 and s_1 at the two ends, an Ornstein-Uhlenbeck process over the road as in
`wayloom.mapping.odometry_links`, so up is wrong by (s_1 v_1 - s_0 v_0) / (T g): a scale that changes looks like an acceleration
along the road, and tilts up along the view; one that does not counts only where the velocity changes.
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
MAX_GAP_NS = 100_000_000
"""Without samples for longer, their sum is no integral."""


@dataclass(frozen=True, slots=True)
class ForceWindows:
    """frame (n,) in the middle of each window; up_cam (n, 3) unit vectors in its camera; covariance (n, 3, 3) rad^2."""

    frame: IntArray
    up_cam: FloatArray
    covariance: FloatArray


def up_by_accelerometer(
    imu: ImuTrack, T_cam_imu: FloatArray, trajectory: Trajectory, scale_sigma: float, scale_length_m: float, position_m: float
) -> ForceWindows:
    """Windows of WINDOW_NS that were tracked throughout and have samples all along.

    scale_sigma, scale_length_m : of the odometry's scale, and the road over which its correlation falls to 1/e
    position_m : sigma of the odometry from one end of END_NS to the other
    """
    T_world_imu = trajectory.T_world_cam @ T_cam_imu
    frames, ups, covariances = [], [], []
    white = position_m / (1e-9 * END_NS) / (1e-9 * WINDOW_NS) / GRAVITY_M_S2
    edges = np.arange(trajectory.t_ns[0] + END_NS, trajectory.t_ns[-1] - END_NS, WINDOW_NS)
    for start, stop in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        first, last = np.searchsorted(trajectory.t_ns, [start - END_NS, stop + END_NS])
        whole = slice(int(first), int(last) + 1)
        if not trajectory.tracked[whole].all() or np.ptp(trajectory.segment[whole]) > 0:
            continue
        rows = np.flatnonzero((imu.t_ns > start - END_NS) & (imu.t_ns < stop + END_NS))
        if np.diff(imu.t_ns[rows], prepend=start - END_NS, append=stop + END_NS).max() > MAX_GAP_NS:
            continue
        R = _at(trajectory.t_ns, T_world_imu, imu.t_ns[rows])[:, :3, :3]
        weight = _weights(imu.t_ns[rows], start, stop)
        force = np.einsum("n,nij,nj->i", weight, R, imu.specific_force[rows])
        v = [_velocity(trajectory.t_ns, T_world_imu, time) for time in (start, stop)]
        acceleration = (v[1] - v[0]) / (1e-9 * (stop - start))
        up = force - acceleration
        middle = int(np.searchsorted(trajectory.t_ns, (start + stop) // 2))
        frames.append(middle)
        R_cam_world = trajectory.T_world_cam[middle, :3, :3].T
        road_m = float(np.linalg.norm(np.diff(trajectory.T_world_cam[whole, :3, 3], axis=0), axis=1).sum())
        v_cam = np.array(v) @ R_cam_world.T
        ups.append(R_cam_world @ (up / np.linalg.norm(up)))
        per_speed = scale_sigma / (1e-9 * (stop - start) * GRAVITY_M_S2)
        covariances.append(white**2 * np.eye(3) + per_speed**2 * _of_scales(v_cam, np.exp(-road_m / scale_length_m)))
    return ForceWindows(np.array(frames, np.int64), np.array(ups).reshape(-1, 3), np.array(covariances).reshape(-1, 3, 3))


def _of_scales(v: FloatArray, correlation: float) -> FloatArray:
    """(3, 3) covariance of s_1 v_1 - s_0 v_0 of velocities v (2, 3), s of unit variance and correlated."""
    return np.asarray(v.T @ np.array([[1.0, -correlation], [-correlation, 1.0]]) @ v)


def _at(t_ns: IntArray, T: FloatArray, time_ns: IntArray) -> FloatArray:
    """(M, 4, 4) poses T (N, 4, 4) at times between the frames'."""
    before = np.clip(np.searchsorted(t_ns, time_ns, side="right") - 1, 0, len(t_ns) - 2)
    share = (time_ns - t_ns[before]) / (t_ns[before + 1] - t_ns[before])
    return interpolate(T[before], T[before + 1], share)


def _weights(t_ns: IntArray, start: int, stop: int) -> FloatArray:
    """(n,) weights of samples at t_ns, sum 1: the trapezoid over which the velocities at start and stop are means."""
    rise = np.minimum(t_ns - (start - END_NS), (stop + END_NS) - t_ns) / (2.0 * END_NS)
    weight = np.clip(rise, 0.0, 1.0)
    return np.asarray(weight / weight.sum())


def _velocity(t_ns: IntArray, T: FloatArray, time_ns: int) -> FloatArray:
    """(3,) m/s by the places END_NS before and after."""
    ends = _at(t_ns, T, np.array([time_ns - END_NS, time_ns + END_NS]))
    return np.asarray((ends[1, :3, 3] - ends[0, :3, 3]) / (2e-9 * END_NS))
