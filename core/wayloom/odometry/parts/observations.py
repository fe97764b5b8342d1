"""Calibration observations of a drive from those of its parts, as few as of a drive in one piece."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from wayloom.logs.types import DriveLog
from wayloom.odometry.parts.plan import DrivePart
from wayloom.odometry.rig.calibration_observations import MOST_GROUPS, CalibrationObservations
from wayloom.odometry.rig.drive_name import drive_name


def join_observations(log: DriveLog, parts: Sequence[tuple[DrivePart, CalibrationObservations]]) -> CalibrationObservations:
    """The groups of all parts in the drive's order, MOST_GROUPS of them at most, evenly chosen. In the overlap of two parts, those
    of the earlier one count up to its middle."""
    edges = [0, *((b.first + a.stop) // 2 for (a, _), (b, _) in pairwise(parts)), len(log)]
    own = [_own_groups(part, seen, edges[k], edges[k + 1]) for k, (part, seen) in enumerate(parts)]
    total = sum(map(len, own))
    chosen = (
        np.unique(np.linspace(0, total - 1, min(total, MOST_GROUPS)).round().astype(np.int64)) if total else np.zeros(0, np.int64)
    )
    columns, first, begun = [], 0, 0
    for (part, seen), rows in zip(parts, own, strict=True):
        groups = rows[chosen[(chosen >= first) & (chosen < first + len(rows))] - first]
        columns.append(_columns(part, seen, groups, begun))
        first, begun = first + len(rows), begun + len(groups)
    return CalibrationObservations(
        drive_name(log), log.rig_id, log.rig, *(np.concatenate(column) for column in zip(*columns, strict=True))
    )


def _own_groups(part: DrivePart, seen: CalibrationObservations, first: int, stop: int) -> NDArray[np.int64]:
    """Rows of the groups whose host is among the drive's frames first to stop - 1."""
    host = seen.host_frame + part.first
    return np.flatnonzero((host >= first) & (host < stop))


def _columns(
    part: DrivePart, seen: CalibrationObservations, groups: NDArray[np.int64], begun: int
) -> tuple[NDArray[np.generic], ...]:
    """The arrays of a part's chosen groups, with the drive's frames, numbered from `begun` on."""
    number = np.full(seen.groups, -1, np.int64)
    number[groups] = np.arange(begun, begun + len(groups))
    points = number[seen.group] >= 0
    target = seen.target_frame[groups]
    return (
        (seen.host_frame[groups] + part.first).astype(np.int32), np.where(target < 0, -1, target + part.first).astype(np.int32),
        seen.T_target_host[groups], number[seen.group][points].astype(np.int32), seen.uv_host[points], seen.uv_right[points],
        seen.uv_left_target[points], seen.uv_right_target[points],
    )  # fmt: skip
