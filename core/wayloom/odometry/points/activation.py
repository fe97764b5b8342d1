"""Activation of points at a new keyframe: immature points that have become sure, static stereo, and candidates that must wait."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayloom.odometry.backend import window
from wayloom.odometry.backend.window import Window
from wayloom.odometry.kernels.arrays import PointColumns, Rig, Robust
from wayloom.odometry.kernels.selection import TAKEN_CELL
from wayloom.odometry.points import immature, selection, stereo
from wayloom.odometry.settings import OdometrySettings
from wayloom.odometry.stopwatch import Stopwatch

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
Image = NDArray[np.uint8]
WITNESSES = 160
"""Points of a keyframe, at most, whose depths by static stereo judge the window's motion later on (`backend.stereo_scale`)."""


@dataclass(frozen=True, slots=True)
class StereoCandidates:
    """Candidate pixels (n, 2) of a left image, and the disparity of each with its sigma (n, 2) px by static stereo, 0 where it has
    no sure match."""

    pixels: IntArray
    disparity: FloatArray

    @property
    def matched(self) -> BoolArray:
        """(n,) those with a match."""
        return np.asarray(self.disparity[:, 0] > 0)


@dataclass(frozen=True, slots=True)
class RectifiedPair:
    """left, right (h, w) uint8 of a keyframe, the right one with its rows on the left's; candidates: those of the whole image,
    where static stereo has been done already (no point is in view yet)."""

    left: Image
    right: Image
    candidates: StereoCandidates | None = None

    @property
    def matches(self) -> int:
        """Candidates with a static match so far."""
        return 0 if self.candidates is None else int(self.candidates.matched.sum())


@dataclass(frozen=True, slots=True)
class ActivationResult:
    """What activating points ends in: the next free number, the cell size px for the next keyframe, the static matches, pixels
    (n, 2) and disparities (n,) px, and at most WITNESSES of them, as points of the newest keyframe."""

    next_id: int
    cell: float
    pixels: IntArray
    disparity: FloatArray
    witnesses: PointColumns


def stereo_candidates(
    left: Image, right: Image, uv_taken: FloatArray, cell: float, settings: OdometrySettings, stopwatch: Stopwatch
) -> StereoCandidates:
    """Candidates away from uv_taken (N, 2) px of a pair (h, w) with aligned rows, matched by static stereo."""
    s = settings
    with stopwatch("select"):
        pixels = selection.select_candidates(left, uv_taken, round(cell), s.block, s.gradient_margin, s.border)
    with stopwatch("stereo"):
        found = stereo.match(left, right, pixels, s.max_disparity, s.uniqueness, s.max_cost, s.slope_cap)
    found[~((found[:, 0] > s.min_disparity) & (found[:, 1] < s.max_sigma))] = 0.0
    return StereoCandidates(pixels, found)


def activate_points(
    now: Window, pair: RectifiedPair, rig: Rig, robust: Robust, cell: float, next_id: int, settings: OdometrySettings,
    stopwatch: Stopwatch,
) -> ActivationResult:  # fmt: skip
    """New live and immature points for the newest keyframe, as many as the view wants, and its right image's brightness.

    Points are numbered from next_id.
    """
    s, newest = settings, len(now) - 1
    uv_live, _ = seen(now, now.points, rig, s.border)
    room = s.points if newest == 0 else max(s.points - len(uv_live), s.min_new_points)
    uv_waiting, waiting = seen(now, now.immature.points, rig, s.border)
    sure = immature.known(now.immature)[waiting]
    uv_waiting, waiting = uv_waiting[sure], waiting[sure]
    candidates = pair.candidates
    if candidates is None:
        uv_taken = np.concatenate([uv_live, uv_waiting])
        candidates = stereo_candidates(pair.left, pair.right, uv_taken, cell, s, stopwatch)
    pixels, matched, disparity = candidates.pixels, candidates.matched, candidates.disparity[:, 0]
    now.frames.gain_right[newest] = stereo.right_gain(pair.left, pair.right, pixels[matched], disparity[matched])
    rho = np.where(matched, np.maximum(disparity - now.disparity_bias[0], 0.1) / (-rig.fx * rig.tx), 0.0)
    unmatched = np.flatnonzero(~matched)
    rows = np.append(np.flatnonzero(matched), unmatched[selection.spread_sample(pixels[unmatched], s.sought_points, s.seed)])
    fresh = immature.of_pixels(now, pixels[rows], rho[rows], next_id, s.gradient_scale, rig, robust)
    ripe = waiting[(now.immature.traced[waiting] > 0) & free(pair.left.shape, uv_live, uv_waiting)]
    ripe = ripe[selection.spread_sample(now.immature.points.uv[ripe].astype(np.int64), int(s.traced_share * room), s.seed)]
    known = np.flatnonzero(immature.known(fresh))
    witnesses = known[selection.spread_sample(fresh.points.uv[known].astype(np.int64), WITNESSES, s.seed)]
    by_stereo = window.chosen(fresh.points, witnesses)
    live = known[selection.spread_sample(fresh.points.uv[known].astype(np.int64), room - len(ripe), s.seed)]
    window.add_points(
        now, window.joined(window.chosen(now.immature.points, ripe), window.chosen(fresh.points, live)),
        np.append(now.immature.id[ripe], fresh.id[live]),
    )  # fmt: skip
    immature.keep(now, ~immature.in_rows(len(now.immature.id), ripe))
    immature.add(now, immature.part(fresh, ~immature.in_rows(len(fresh.id), live)))
    wanted = max(room, s.matched_points)
    next_cell = selection.next_cell(cell, len(known), wanted)
    return ActivationResult(next_id + len(rows), next_cell, pixels[matched], disparity[matched], by_stereo)


def seen(now: Window, points: PointColumns, rig: Rig, border: float) -> tuple[FloatArray, IntArray]:
    """Places (n, 2) px of those points that are in view of the newest keyframe, and their rows (n,)."""
    projected = window.project_into(now, points, len(now) - 1, rig, border)
    rows = np.flatnonzero(~np.isnan(projected[:, 0]))
    return projected[rows, :2], rows


def free(shape: tuple[int, ...], uv_taken: FloatArray, uv: FloatArray) -> BoolArray:
    """(n,) which of the places uv (n, 2) px of an image (h, w) are not where one of uv_taken (N, 2) is."""
    taken = selection.taken_places(shape, uv_taken)
    column, row = (uv / TAKEN_CELL).astype(int).T
    return np.asarray(~taken[row, column])
