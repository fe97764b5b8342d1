"""Cuts between neighbouring parts: the frame from which on the later part counts, and how its frame of reference is joined on."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.odometry.parts.joint import LEAST_FRAMES, Joint, joint
from wayloom.odometry.parts.plan import DrivePart
from wayloom.odometry.types import Trajectory

IntArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Cut:
    """frame : of the drive, the first that is the later part's; T_before_after (4, 4) from the later part's world to the earlier's;
    joint : how it was found, None where too few frames were tracked by both: then a new segment begins there."""

    frame: int
    T_before_after: NDArray[np.float64]
    joint: Joint | None


def cut_between(before: tuple[DrivePart, Trajectory], after: tuple[DrivePart, Trajectory]) -> Cut:
    """Where and how two neighbours are joined.

    The cut is in the middle of the longest run of frames that both tracked, each within one segment. Where no run has
    LEAST_FRAMES, the later part starts anew at the place that the earlier one has or guesses for the cut, as after any loss.
    """
    (earlier, of_earlier), (later, of_later) = before, after
    shared = np.arange(later.first, earlier.stop)
    rows = shared - earlier.first, shared - later.first
    first, stop = _longest_run(of_earlier, of_later, rows)
    if stop - first >= LEAST_FRAMES:
        run = slice(first, stop)
        found = joint(of_earlier.T_world_cam[rows[0][run]], of_later.T_world_cam[rows[1][run]])
        return Cut(int(shared[first] + (stop - first) // 2), found.T_before_after, found)
    frame = _where_lost(of_earlier, of_later, rows)
    T = of_earlier.T_world_cam[rows[0][frame]] @ se3.inverse(of_later.T_world_cam[rows[1][frame]])
    return Cut(int(shared[frame]), T, None)


def _longest_run(before: Trajectory, after: Trajectory, rows: tuple[IntArray, IntArray]) -> tuple[int, int]:
    """First and stop of the longest run of rows that both tracked without a loss in between; the first of several."""
    good = before.tracked[rows[0]] & after.tracked[rows[1]]
    label = np.stack([before.segment[rows[0]], after.segment[rows[1]]])
    breaks = np.flatnonzero((np.diff(label, axis=1) != 0).any(axis=0) | ~good[1:] | ~good[:-1]) + 1
    edges = np.concatenate([[0], breaks, [len(good)]])
    length = np.where(good[np.minimum(edges[:-1], len(good) - 1)], np.diff(edges), 0)
    longest = int(np.argmax(length))
    return int(edges[longest]), int(edges[longest] + length[longest])


def _where_lost(before: Trajectory, after: Trajectory, rows: tuple[IntArray, IntArray]) -> int:
    """The row that leaves the most tracked frames: those of the earlier part before it, those of the later from it on."""
    kept = np.concatenate([[0], np.cumsum(before.tracked[rows[0]][:-1])]) + np.cumsum(after.tracked[rows[1]][::-1])[::-1]
    best = np.flatnonzero(kept == kept.max())
    return int(best[np.argmin(np.abs(best - len(kept) // 2))])
