"""Join of a drive's parts into one odometry result: one frame of reference, no frame, keyframe or point twice.

The overlap of two parts is cut once (`cut`): frames, keyframes and the points that these host are the earlier part's before the
cut and the later part's from it on. What was seen in a keyframe beyond the cut counts where the other part has a keyframe of that
frame.
Points are taken over one part after the other, into files without names: memory does not grow with the number of parts.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import StageError
from wayloom.odometry.parts.cut import Cut, cut_between
from wayloom.odometry.parts.plan import DrivePart
from wayloom.odometry.result.point_filter import KeptPoints
from wayloom.odometry.types import Keyframes, OdometryResult, Points, Trajectory

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
NO_COMMON_FRAMES = "the parts before and after have too few tracked frames in common"


@dataclass(frozen=True, slots=True)
class PlacedPart:
    """A part in its place.

    first, stop       the frames of the drive that are its own, after the cuts
    T_world_part      (4, 4) of its world frame in the drive's
    segment_offset    what its segments' numbers grow by
    keyframe_offset   row of its first own keyframe in the drive's keyframes
    own_keyframes     (k,) its rows in that order
    """

    part: DrivePart
    first: int
    stop: int
    T_world_part: FloatArray
    segment_offset: int
    keyframe_offset: int
    own_keyframes: IntArray


def join_parts(parts: Sequence[DrivePart], load: Callable[[DrivePart], OdometryResult]) -> OdometryResult:
    """The drive's result from those of its parts, of which only one is in memory at a time. load : reads one, twice in all.

    Raises StageError where a result is not that of its part.
    """
    heads = [_head(part, load(part)) for part in parts]
    cuts = [cut_between((a, x.trajectory), (b, y.trajectory)) for (a, x), (b, y) in pairwise(zip(parts, heads, strict=True))]
    placed = _place(parts, heads, cuts)
    trajectory, keyframes = _joined_trajectory(placed, heads), _joined_keyframes(placed, heads, cuts)
    points = _joined_points(placed, keyframes, heads, load)
    report = _joined_report(placed, heads, cuts, trajectory, len(keyframes), len(points))
    return replace(heads[-1], trajectory=trajectory, keyframes=keyframes, points=points, report=report)


def _head(part: DrivePart, result: OdometryResult) -> OdometryResult:
    """The result without its points."""
    if len(result.trajectory) != len(part):
        raise StageError(f"part {part.number} has {len(result.trajectory)} frames instead of {len(part)}: track the drive again")
    return replace(result, points=KeptPoints().points())


def _place(parts: Sequence[DrivePart], heads: Sequence[OdometryResult], cuts: Sequence[Cut]) -> list[PlacedPart]:
    placed: list[PlacedPart] = []
    T, offset, row = np.eye(4), 0, 0
    edges = [parts[0].first, *(cut.frame for cut in cuts), parts[-1].stop]
    for k, (part, head) in enumerate(zip(parts, heads, strict=True)):
        if k:
            cut, segment = cuts[k - 1], heads[k - 1].trajectory.segment
            T = T @ cut.T_before_after
            offset += int(segment[cut.frame - 1 - parts[k - 1].first]) - int(head.trajectory.segment[cut.frame - part.first])
            offset += cut.joint is None
        frame = head.keyframes.frame + part.first
        own = np.flatnonzero((frame >= edges[k]) & (frame < edges[k + 1]))
        placed.append(PlacedPart(part, edges[k], edges[k + 1], T, offset, row, own))
        row += len(own)
    return placed


def _joined_trajectory(placed: Sequence[PlacedPart], heads: Sequence[OdometryResult]) -> Trajectory:
    columns = []
    for p, head in zip(placed, heads, strict=True):
        own, of_part = slice(p.first - p.part.first, p.stop - p.part.first), head.trajectory
        T = p.T_world_part @ of_part.T_world_cam[own]
        columns.append((of_part.t_ns[own], T, of_part.tracked[own], (of_part.segment[own] + p.segment_offset).astype(np.int32)))
    return Trajectory(*(np.concatenate(column) for column in zip(*columns, strict=True)))


def _joined_keyframes(placed: Sequence[PlacedPart], heads: Sequence[OdometryResult], cuts: Sequence[Cut]) -> Keyframes:
    """The step over a cut errs by the joint as well as by what the later part says of its own step to that keyframe."""
    columns = []
    for k, (p, head) in enumerate(zip(placed, heads, strict=True)):
        own, of_part = p.own_keyframes, head.keyframes
        frame, segment = of_part.frame[own] + p.part.first, of_part.segment[own] + p.segment_offset
        T = p.T_world_part @ of_part.T_world_cam[own]
        steps = of_part.step_covariance[own].copy()
        if k and len(own):
            steps[0] += _over_cut(cuts[k - 1], head.trajectory.T_world_cam[:, :3, :3], of_part.frame[own[0]], p.part)
        columns.append((frame.astype(np.int32), T, of_part.affine[own], segment.astype(np.int32), steps))
    return Keyframes(*(np.concatenate(column) for column in zip(*columns, strict=True)))


def _over_cut(cut: Cut, R_part_cam: FloatArray, keyframe: int, part: DrivePart) -> FloatArray:
    """(6, 6) that a joint adds to the covariance of the step to a keyframe near it, in the axes there; NaN where there is none.

    R_part_cam : (n, 3, 3) of the part's frames
    """
    if cut.joint is None:
        return np.full((6, 6), np.nan)
    R = R_part_cam[keyframe].T @ R_part_cam[cut.frame - part.first]
    turn = np.kron(np.eye(2), R)
    return np.asarray(turn @ cut.joint.covariance @ turn.T)


def _joined_points(
    placed: Sequence[PlacedPart], keyframes: Keyframes, heads: Sequence[OdometryResult], load: Callable[[DrivePart], OdometryResult]
) -> Points:
    kept = KeptPoints()
    for p, head in zip(placed, heads, strict=True):
        kept.extend(_renumbered(load(p.part).points, p, _rows_in_drive(p, head.keyframes, keyframes)))
    return kept.points()


def _rows_in_drive(p: PlacedPart, of_part: Keyframes, of_drive: Keyframes) -> IntArray:
    """(K,) row in the drive's keyframes of each of a part's, by its frame; -1 where the drive has none of that frame."""
    frame = of_part.frame + p.part.first
    row = np.searchsorted(of_drive.frame, frame)
    found = of_drive.frame[np.minimum(row, len(of_drive.frame) - 1)] == frame if len(of_drive.frame) else np.zeros(len(frame), bool)
    return np.where(found, row, -1)


def _renumbered(points: Points, p: PlacedPart, row: IntArray) -> Points:
    """The points of a part that its own keyframes host, with the drive's numbers of keyframes; row (K,) as of `_rows_in_drive`."""
    is_own = np.zeros(len(row), bool)
    is_own[p.own_keyframes] = True
    good = is_own[points.host]
    seen = points.obs_start
    of_good = np.repeat(good, np.diff(seen)) & (row[points.obs_keyframe] >= 0)
    before = np.concatenate([[0], np.cumsum(of_good)])
    length = (before[seen[1:]] - before[seen[:-1]])[good]
    return Points(
        row[points.host[good]].astype(np.int32), points.uv_host[good], points.inverse_depth[good], points.variance[good],
        points.grey[good], np.concatenate([[0], np.cumsum(length)]), row[points.obs_keyframe[of_good]].astype(np.int32),
        points.obs_right[of_good], points.host_right[good],
    )  # fmt: skip


def _joined_report(
    placed: Sequence[PlacedPart], heads: Sequence[OdometryResult], cuts: Sequence[Cut], trajectory: Trajectory, keyframes: int,
    points: int,
) -> dict[str, Any]:  # fmt: skip
    """As of `Odometry.finish`: the counts of the drive, the calibration as last estimated; and the parts and their joints."""
    reports = [head.report for head in heads]
    starts = np.concatenate([[0], np.flatnonzero(np.diff(trajectory.segment)) + 1, [len(trajectory)]]).tolist()
    seconds: dict[str, float] = {}
    for report in reports:
        for name, spent in report.get("seconds", {}).items():
            seconds[name] = round(seconds.get(name, 0.0) + spent, 4)
    return reports[-1] | {
        "frames": len(trajectory),
        "tracked": int(trajectory.tracked.sum()),
        "keyframes": keyframes,
        "points": points,
        "activated_points": sum(report["activated_points"] for report in reports),
        "segments": [{"first_frame": a, "last_frame": b - 1} for a, b in pairwise(starts)],
        "losses": _losses(placed, reports, cuts),
        "doubted_steps": sum(report["doubted_steps"] for report in reports),
        "imu": _joined_imu(placed, heads),
        "parts": [
            {"first_frame": p.part.first, "last_frame": p.part.stop - 1, "disparity_bias_px": report["disparity_bias_px"]}
            for p, report in zip(placed, reports, strict=True)
        ],
        "joints": [_joint_facts(cut) for cut in cuts],
        "seconds": seconds,
    }


def _losses(placed: Sequence[PlacedPart], reports: Sequence[dict[str, Any]], cuts: Sequence[Cut]) -> list[dict[str, Any]]:
    """Of each part those among its own frames, and of cuts without a joint."""
    losses = [{"frame": cut.frame, "reason": NO_COMMON_FRAMES} for cut in cuts if cut.joint is None]
    for p, report in zip(placed, reports, strict=True):
        of_drive = [loss | {"frame": loss["frame"] + p.part.first} for loss in report["losses"]]
        losses += [loss for loss in of_drive if p.first <= loss["frame"] < p.stop]
    return sorted(losses, key=lambda loss: int(loss["frame"]))


def _joined_imu(placed: Sequence[PlacedPart], heads: Sequence[OdometryResult]) -> dict[str, Any] | None:
    """What the last part knew of the IMU, its gravity (3,) in the drive's world; when it started in each, since the drive began."""
    last = heads[-1].report["imu"]
    if last is None:
        return None
    begun_ns = [int(head.trajectory.t_ns[0]) for head in heads]
    started = [
        round(1e-9 * (t_ns - begun_ns[0]) + s, 3)
        for t_ns, head in zip(begun_ns, heads, strict=True)
        for s in head.report["imu"]["started_s"]
    ]
    gravity = last["gravity_world_m_s2"]
    turned = None if gravity is None else (placed[-1].T_world_part[:3, :3] @ np.array(gravity)).tolist()
    return {**last, "started_s": started, "gravity_world_m_s2": turned}


def _joint_facts(cut: Cut) -> dict[str, Any]:
    """JSON-ready: where, sigmas of position and rotation (all axes together), scales, frames in common."""
    found = cut.joint
    if found is None:
        return {"frame": cut.frame, "common_frames": 0}
    variance = np.diag(found.covariance)
    return {
        "frame": cut.frame,
        "common_frames": found.frames,
        "sigma_m": math.sqrt(float(variance[:3].sum())),
        "sigma_rad": math.sqrt(float(variance[3:].sum())),
        "scale_ratio": found.scale_ratio if math.isfinite(found.scale_ratio) else None,
    }
