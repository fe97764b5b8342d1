"""Selection of usable GNSS fixes, and their association with odometry poses."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.logs.types import FixType, GnssTrack
from wayloom.odometry.types import Trajectory

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
TWIST_NS = 400_000_000


@dataclass(frozen=True, slots=True)
class UsableFixes:
    """rows (M,) of the GNSS track, in time order; T_world_cam (M, 4, 4) at their times; twist (M, 6) of the camera there, (v,
    omega) in its own frame, m/s and rad/s; frame (M,) the last frame not after each; unusable counts the others by reason."""

    rows: IntArray
    T_world_cam: FloatArray
    twist: FloatArray
    frame: IntArray
    unusable: dict[str, int]


def usable_fixes(gnss: GnssTrack, trajectory: Trajectory, max_rate_hz: float) -> UsableFixes:
    """Fixes with a type, a covariance and a tracked pose at their time. The pose is interpolated between frames."""
    unusable: dict[str, int] = {}
    rows = np.arange(len(gnss))

    def keep(good: NDArray[np.bool_], reason: str) -> None:
        nonlocal rows
        if not good.all():
            unusable[reason] = int((~good).sum())
        rows = rows[good]

    keep(gnss.fix_type[rows] != FixType.NONE, "no fix")
    keep(_on_earth(gnss.lon_lat_height[rows]), "no place on Earth")
    keep(_sound(gnss.lon_lat_height[rows], gnss.covariance_enu[rows]), "no usable covariance")
    t = gnss.t_ns[rows]
    keep((t >= trajectory.t_ns[0]) & (t <= trajectory.t_ns[-1]), "outside the drive's time")
    keep(_thin(gnss.t_ns[rows], max_rate_hz), "faster than needed")
    before, share = _between_frames(gnss.t_ns[rows], trajectory.t_ns)
    after = np.minimum(before + 1, len(trajectory) - 1)
    tracked = trajectory.tracked[before] & trajectory.tracked[after] & (trajectory.segment[before] == trajectory.segment[after])
    keep(tracked, "track lost")
    before, after, share = before[tracked], after[tracked], share[tracked]
    T = interpolate(trajectory.T_world_cam[before], trajectory.T_world_cam[after], share)
    return UsableFixes(rows, T, _smooth_twists(trajectory, gnss.t_ns[rows], before), before, unusable)


def _smooth_twists(trajectory: Trajectory, t_ns: IntArray, frame: IntArray) -> FloatArray:
    """(M, 6) the camera's twist at each time, over TWIST_NS before and after, within its segment.

    From one frame to the next it would hold the odometry's noise of that step, which the poses hold as well: a time offset could
    then explain noise.
    """
    first, last = _segment_ends(trajectory.segment)
    low = np.maximum(np.searchsorted(trajectory.t_ns, t_ns - TWIST_NS), first[frame])
    high = np.minimum(np.searchsorted(trajectory.t_ns, t_ns + TWIST_NS, side="right") - 1, last[frame])
    high = np.maximum(high, low)
    seconds = np.maximum(1e-9 * (trajectory.t_ns[high] - trajectory.t_ns[low]), 1e-9)
    return np.asarray(twists(trajectory.T_world_cam[low], trajectory.T_world_cam[high]) / seconds[:, None])


def _segment_ends(segment: NDArray[np.int32]) -> tuple[IntArray, IntArray]:
    """(N,) first and (N,) last frame of each frame's segment."""
    change = np.flatnonzero(np.diff(segment)) + 1
    bounds = np.concatenate([[0], change, [len(segment)]])
    piece = np.searchsorted(bounds, np.arange(len(segment)), side="right") - 1
    return bounds[piece], bounds[piece + 1] - 1


def twists(T_a: FloatArray, T_b: FloatArray) -> FloatArray:
    """(N, 6) log(T_a^-1 T_b) of T_a, T_b (N, 4, 4)."""
    return np.array([se3.log(T) for T in se3.inverse(T_a) @ T_b]).reshape(-1, 6)


def interpolate(T_a: FloatArray, T_b: FloatArray, share: FloatArray) -> FloatArray:
    """(N, 4, 4) motions a share (N,) of the way from T_a to T_b (N, 4, 4): T_a exp(share log(T_a^-1 T_b))."""
    return T_a @ se3.exp(share[:, None] * twists(T_a, T_b))


def _on_earth(lon_lat_height: FloatArray) -> NDArray[np.bool_]:
    lon, lat = np.abs(lon_lat_height[:, 0]), np.abs(lon_lat_height[:, 1])
    return np.asarray((lon <= 180.0) & (lat <= 90.0))


def _sound(lon_lat_height: FloatArray, covariance: FloatArray) -> NDArray[np.bool_]:
    finite = np.asarray(np.isfinite(lon_lat_height).all(axis=1) & np.isfinite(covariance).all(axis=(1, 2)))
    eigenvalues = np.linalg.eigvalsh(np.where(finite[:, None, None], covariance, np.eye(3)))
    return np.asarray(finite & (eigenvalues[:, 0] > 0.0))


def _thin(t_ns: IntArray, max_rate_hz: float) -> NDArray[np.bool_]:
    """(M,) a subset in which neighbours are at least nine tenths of the period apart (a clock jitters)."""
    period_ns = int(0.9e9 / max_rate_hz)
    good = np.zeros(len(t_ns), dtype=np.bool_)
    last: int | None = None
    for i, t in enumerate(t_ns.tolist()):
        if last is None or t - last >= period_ns:
            good[i], last = True, t
    return good


def _between_frames(t_ns: IntArray, frame_t_ns: IntArray) -> tuple[IntArray, FloatArray]:
    """The last frame not after each time, and the share (M,) of the way to the next frame."""
    before = np.clip(np.searchsorted(frame_t_ns, t_ns, side="right") - 1, 0, max(len(frame_t_ns) - 2, 0))
    after = np.minimum(before + 1, len(frame_t_ns) - 1)
    step = np.maximum(frame_t_ns[after] - frame_t_ns[before], 1)
    return before, (t_ns - frame_t_ns[before]) / step
