"""Results of the parts of a drive with exact truth, and noise of a kind that is known."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.geometry.camera import PinholeCamera, StereoRig
from wayloom.odometry.parts.plan import DrivePart
from wayloom.odometry.types import Keyframes, OdometryResult, Points, Trajectory

F64 = NDArray[np.float64]
RIG = StereoRig(PinholeCamera(200.0, 200.0, 159.5, 99.5, 320, 200), (-0.5, 0.0, 0.0))


def way(frames: int) -> F64:
    """(frames, 4, 4) T_world_cam of a winding way, 0.8 m a frame."""
    t = np.arange(frames)
    twists = np.zeros((frames, 6))
    twists[:, 4] = 0.4 * np.sin(0.05 * t)
    T = se3.exp(twists)
    T[:, 0, 3], T[:, 1, 3], T[:, 2, 3] = 3.0 * np.sin(0.04 * t), 0.2 * np.sin(0.1 * t), 0.8 * t
    return np.asarray(se3.inverse(T[0]) @ T)


def autoregressive(rng: np.random.Generator, n: int, rho: float) -> F64:
    """(n, 6) deviations of unit variance, each rho times the one before and something new."""
    out = rng.normal(size=(n, 6))
    for i in range(1, n):
        out[i] = rho * out[i - 1] + np.sqrt(1.0 - rho**2) * out[i]
    return out


def made_part(truth: F64, part: DrivePart, every: int, seed: int = 0) -> OdometryResult:
    """A part of the drive without any error: keyframes at multiples of `every` from its own first frame on, four points each, seen
    in the next three keyframes. The points' grey tells the frame of their host."""
    T = se3.inverse(truth[part.first]) @ truth[part.first : part.stop]
    frame = np.arange(0, len(part), every)
    count, n = len(frame), 4 * len(frame)
    rng = np.random.default_rng([seed, part.number])
    host = np.repeat(np.arange(count), 4)
    seen = [np.arange(k + 1, min(k + 4, count)) for k in host]
    obs = np.concatenate(seen)
    points = Points(
        host.astype(np.int32), rng.uniform(10, 190, (n, 2)).astype(np.float32), rng.uniform(0.02, 0.2, n).astype(np.float32),
        np.full(n, 1e-6, np.float32), ((frame[host] + part.first) % 256).astype(np.uint8),
        np.concatenate([[0], np.cumsum([len(s) for s in seen])]), obs.astype(np.int32), rng.random(len(obs)) < 0.5,
        rng.random(n) < 0.5,
    )  # fmt: skip
    report = {
        "frames": len(part), "tracked": len(part), "activated_points": 2 * n, "losses": [], "doubted_steps": 0, "imu": None,
        "disparity_bias_px": 0.1,
        "seconds": {"track": 1.0},
    }  # fmt: skip
    t_ns, no_segment = (part.first + np.arange(len(part))) * 100_000_000, np.zeros(len(part), np.int32)
    trajectory = Trajectory(t_ns, T, np.ones(len(part), bool), no_segment)
    keyframes = Keyframes(frame.astype(np.int32), T[frame], np.zeros((count, 4)), no_segment[frame])
    return OdometryResult(RIG, trajectory, keyframes, points, 0.1, np.zeros(3), report)


def lost(result: OdometryResult, first: int, stop: int, new_segment: bool) -> OdometryResult:
    """The result as if the frames first to stop - 1 had not been tracked; a new segment begins at `stop` where wanted."""
    tracked, segment = result.trajectory.tracked.copy(), result.trajectory.segment.copy()
    tracked[first:stop] = False
    if new_segment:
        segment[stop:] += 1
    keyframes = replace(result.keyframes, segment=segment[result.keyframes.frame])
    losses = [{"frame": frame, "reason": "lost"} for frame in range(first, stop)]
    trajectory = replace(result.trajectory, tracked=tracked, segment=segment)
    return replace(result, trajectory=trajectory, keyframes=keyframes, report=result.report | {"losses": losses})
