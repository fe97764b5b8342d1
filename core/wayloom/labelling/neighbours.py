"""Gaussian smoothing of votes over each point's nearest neighbours in space.

Not in the paper. Label boundaries in an image are uncertain by a few pixels, and most of the odometry's points lie at edges. In the
image a point at an object's edge has as much background as object around it; its neighbours in space are the object's alone.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_COUNT
from wayloom.files.growing_arrays import GrowingArray
from wayloom.labelling.kernels.kd_tree import LEAF, build_kd_tree, nearest_within_radius
from wayloom.labelling.kernels.neighbours import gaussian_weights, smoothed_votes
from wayloom.labelling.kernels.voting import argmax_classes, sparse_votes
from wayloom.labelling.types import SparseVotes
from wayloom.odometry.types import POINTS_AT_ONCE, OdometryResult

FloatArray = NDArray[np.float64]
MAX_NEIGHBOURS: Final = 8
"""Neighbours of a point at most."""
MAX_SIGMAS: Final = 3.0
"""Radius of the search, in sigmas of the Gaussian."""
OWN_WEIGHT: Final = 4.0
"""Weight of a point's own votes, where a neighbour at its place has 1."""


@dataclass(frozen=True, slots=True)
class Neighbours:
    """Of B points: rows (B, K) int32 of each one's neighbours, itself among them; weights (B, K) float32, its own OWN_WEIGHT,
    0: none."""

    rows: NDArray[np.int32]
    weights: NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class _Tree:
    """k-d tree of N places (`build_kd_tree`)."""

    sorted: FloatArray
    order: NDArray[np.int32]
    axes: NDArray[np.int8]
    splits: FloatArray
    levels: int

    def nearest(self, asked: FloatArray, radius: FloatArray, count: int) -> tuple[NDArray[np.int32], FloatArray]:
        """Rows (Q, count) of the points nearest to places (Q, 3), each within its own radius (Q,), nearest first and of equal ones
        the lowest rows first; and their squared distances. -1 and inf where there are no more."""
        rows, distance2 = np.empty((len(asked), count), np.int32), np.empty((len(asked), count))
        nearest_within_radius(self.sorted, self.order, self.axes, self.splits, self.levels, asked, radius, rows, distance2)
        return rows, distance2


def _tree(places: FloatArray) -> _Tree:
    """Of places (N, 3), which it sorts in place."""
    levels = max(0, (len(places) // LEAF).bit_length() - 1)
    inner, order = (1 << levels) - 1, np.arange(len(places), dtype=np.int32)
    tree = _Tree(places, order, np.zeros(inner, np.int8), np.zeros(inner), levels)
    build_kd_tree(tree.sorted, tree.order, tree.axes, tree.splits, levels)
    return tree


class NeighbourSearch:
    """Nearest neighbours of each of a drive's points in its segment, weighted exp(-r^2 / 2 s^2), s = spread times the depth in its
    host. A point without a depth has no neighbour but itself, and none has where spread is 0."""

    def __init__(self, odometry: OdometryResult, spread: float) -> None:
        self.odometry, self.spread, self.segments = odometry, spread, list[tuple[NDArray[np.int64], _Tree]]()
        if not spread > 0.0:
            return
        points, points_world = odometry.points, odometry.points_world()
        with np.errstate(invalid="ignore"):
            has_depth = np.isfinite(points.inverse_depth) & (points.inverse_depth > 0)
        segment = odometry.keyframes.segment[points.host]
        for number in np.unique(segment[has_depth]):
            members = np.flatnonzero(has_depth & (segment == number))
            places = points_world if len(members) == len(points) else points_world[members]  # sorted in place: no copy of all
            self.segments.append((members, _tree(places)))

    def of(self, first: int, stop: int) -> Neighbours:
        """Those of the points from `first` to before `stop`."""
        count = MAX_NEIGHBOURS + 1 if self.segments else 1
        rows = np.repeat(np.arange(first, stop, dtype=np.int32)[:, None], count, axis=1)
        weights = np.zeros(rows.shape, np.float32)
        weights[:, 0] = 1.0
        if not self.segments:
            return Neighbours(rows, weights)
        for members, tree in self.segments:
            low, high = np.searchsorted(members, (first, stop)).tolist()
            here = members[low:high]
            sigma = self.spread / self.odometry.points.inverse_depth[here].astype(np.float64)
            near, r2 = tree.nearest(self.odometry.points_world(here), MAX_SIGMAS * sigma, count)
            gaussian_weights(members, low, near, r2, sigma, OWN_WEIGHT, first, rows, weights)
        return Neighbours(rows, weights)


def nearest(places: FloatArray, radius: FloatArray, count: int) -> tuple[NDArray[np.int32], FloatArray]:
    """Of N places (N, 3) the nearest ones of each, itself among them: as `_Tree.nearest`, radius (N,)."""
    return _tree(np.array(places, np.float64, order="C")).nearest(np.ascontiguousarray(places, np.float64), radius, count)


def smoothed_labels(votes: SparseVotes, search: NeighbourSearch, baseline: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Labels (P,) when every point's votes are the weighted mean of its neighbours'; baseline (P,): of points without votes."""
    labels = baseline.copy()
    for rows, block in _smoothed_blocks(votes, search, len(baseline)):
        labels[rows] = argmax_classes(block, baseline[rows])
    return labels


def smoothed(
    votes: SparseVotes, search: NeighbourSearch, baseline: NDArray[np.uint8], min_share: float
) -> tuple[NDArray[np.uint8], SparseVotes]:
    """`smoothed_labels`, and the votes themselves, each point's with the sum that its own had; those of a long drive lie in a file.

    min_share : classes with less of a point's votes are not kept
    """
    labels, start = baseline.copy(), np.zeros(len(baseline) + 1, np.int64)
    all_classes, all_weights = GrowingArray(np.uint8), GrowingArray(np.float32)
    for rows, block in _smoothed_blocks(votes, search, len(baseline)):
        labels[rows] = argmax_classes(block, baseline[rows])
        start[rows.start + 1 : rows.stop + 1], classes, weights = sparse_votes(block, min_share)
        all_classes.append(classes)
        all_weights.append(weights)
    np.cumsum(start, out=start)
    return labels, SparseVotes(start, all_classes.array(), all_weights.array())


def _smoothed_blocks(votes: SparseVotes, search: NeighbourSearch, count: int) -> Iterator[tuple[slice, FloatArray]]:
    """Of `count` points some at a time: their rows, and their votes (B, 19) as the weighted mean of their neighbours'."""
    for first in range(0, count, POINTS_AT_ONCE):
        rows = slice(first, min(first + POINTS_AT_ONCE, count))
        near = search.of(rows.start, rows.stop)
        yield rows, smoothed_votes(votes.start, votes.classes, votes.weights, near.rows, near.weights, first, CLASS_COUNT)
