"""Gaussian smoothing of votes over each point's nearest neighbours in space.

Not in the paper. Label boundaries in an image are uncertain by a few pixels, and most of the odometry's points lie at edges. In the
image a point at an object's edge has as much background as object around it; its neighbours in space are the object's alone.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_COUNT
from wayloom.labelling.kernels.kd_tree import LEAF, build_kd_tree, nearest_within_radius
from wayloom.labelling.kernels.neighbours import gaussian_weights, smoothed_votes
from wayloom.labelling.kernels.voting import argmax_classes, sparse_votes
from wayloom.labelling.types import SparseVotes
from wayloom.odometry.types import OdometryResult

FloatArray = NDArray[np.float64]
MAX_NEIGHBOURS: Final = 8
"""Neighbours of a point at most."""
MAX_SIGMAS: Final = 3.0
"""Radius of the search, in sigmas of the Gaussian."""
OWN_WEIGHT: Final = 4.0
"""Weight of a point's own votes, where a neighbour at its place has 1."""
_BLOCK: Final = 65_536
"""Points whose dense vote vectors are in memory at once."""


@dataclass(frozen=True, slots=True)
class Neighbours:
    """rows (P, K) int32 of each point's neighbours, itself among them; weights (P, K) float32, its own OWN_WEIGHT, 0: none."""

    rows: NDArray[np.int32]
    weights: NDArray[np.float32]


def neighbours(odometry: OdometryResult, spread: float) -> Neighbours:
    """Nearest neighbours of each point in its segment, weighted exp(-r^2 / 2 s^2), s = spread times the depth in its host.

    A point without a depth has no neighbour but itself.
    """
    points = odometry.points
    rows = np.repeat(np.arange(len(points), dtype=np.int32)[:, None], MAX_NEIGHBOURS + 1, axis=1)
    weights = np.zeros((len(points), MAX_NEIGHBOURS + 1), np.float32)
    weights[:, 0] = 1.0
    with np.errstate(invalid="ignore"):
        has_depth = np.isfinite(points.inverse_depth) & (points.inverse_depth > 0)
    segment = odometry.keyframes.segment[points.host]
    points_world = odometry.points_world()
    for number in np.unique(segment[has_depth]):
        members = np.flatnonzero(has_depth & (segment == number))
        sigma = spread / points.inverse_depth[members].astype(np.float64)
        near, r2 = nearest(points_world[members], MAX_SIGMAS * sigma, MAX_NEIGHBOURS + 1)
        gaussian_weights(members, near, r2, sigma, OWN_WEIGHT, rows, weights)
    return Neighbours(rows, weights)


def no_neighbours(count: int) -> Neighbours:
    """Each point with itself alone: `smoothed` leaves its votes as they are."""
    return Neighbours(np.arange(count, dtype=np.int32)[:, None], np.ones((count, 1), np.float32))


def nearest(places: FloatArray, radius: FloatArray, count: int) -> tuple[NDArray[np.int32], FloatArray]:
    """Rows (N, count) of the nearest of N places (N, 3), each within its own radius (N,), itself among them, nearest first and of
    equal ones the lowest rows first; and their squared distances. -1 and inf where there are no more."""
    levels = max(0, (len(places) // LEAF).bit_length() - 1)
    sorted_places, order = np.array(places, np.float64, order="C"), np.arange(len(places), dtype=np.int32)
    axes, splits = np.zeros((1 << levels) - 1, np.int8), np.zeros((1 << levels) - 1)
    rows, distance2 = np.empty((len(places), count), np.int32), np.empty((len(places), count))
    build_kd_tree(sorted_places, order, axes, splits, levels)
    nearest_within_radius(sorted_places, order, axes, splits, levels, radius, rows, distance2)
    return rows, distance2


def smoothed(
    votes: SparseVotes, near: Neighbours, baseline: NDArray[np.uint8], min_share: float
) -> tuple[NDArray[np.uint8], SparseVotes]:
    """Labels (P,) and votes when every point's votes are the weighted mean of its neighbours'; the sum of its own votes stays.

    baseline : (P,) the labels of points without votes; min_share : classes with less of a point's votes are not kept
    """
    labels, parts = baseline.copy(), []
    for first in range(0, len(baseline), _BLOCK):
        stop = min(first + _BLOCK, len(baseline))
        block = smoothed_votes(votes.start, votes.classes, votes.weights, near.rows, near.weights, first, stop, CLASS_COUNT)
        labels[first:stop] = argmax_classes(block, baseline[first:stop])
        parts.append(sparse_votes(block, min_share))
    if not parts:
        return labels, votes
    kinds, classes, weights = (np.concatenate(column) for column in zip(*parts, strict=True))
    return labels, SparseVotes(np.concatenate([[0], np.cumsum(kinds)]), classes, weights)
