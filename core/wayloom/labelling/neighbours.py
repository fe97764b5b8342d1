"""Points that lie beside each other share their votes: in space, where what stands before a facade is not beside it.

Not in the paper. An image knows where a label ends only to within a few pixels, and most of the odometry's points lie at edges; in
the image a point at an object's edge has as much background as object around it, in space only the object.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_COUNT
from wayloom.labelling.kernels.nearest import LEAF, grow_tree, nearest_within
from wayloom.labelling.kernels.neighbours import votes_around, weigh_nearest
from wayloom.labelling.kernels.voting import sparse_votes, winners
from wayloom.labelling.types import SparseVotes
from wayloom.odometry.types import OdometryResult

FloatArray = NDArray[np.float64]
NEAREST: Final = 8
"""How many neighbours a point has at most."""
FURTHEST: Final = 3.0
"""… and how many sigmas away."""
OWN: Final = 4.0
"""How often a point's own votes count among theirs."""
_BLOCK: Final = 65_536
"""Points whose votes lie side by side in memory, a number for every class."""


@dataclass(frozen=True, slots=True)
class Neighbours:
    """rows (P, K) int32 of each point's neighbours, itself among them; closeness (P, K) float32, its own OWN, 0: is none."""

    rows: NDArray[np.int32]
    closeness: NDArray[np.float32]


def neighbours(odometry: OdometryResult, spread: float) -> Neighbours:
    """Each point's nearest ones of its segment: closeness exp(-r^2 / 2 s^2), where s is this share of its depth in its host.

    A point without a depth has no neighbour but itself.
    """
    points = odometry.points
    rows = np.repeat(np.arange(len(points), dtype=np.int32)[:, None], NEAREST + 1, axis=1)
    closeness = np.zeros((len(points), NEAREST + 1), np.float32)
    closeness[:, 0] = 1.0
    with np.errstate(invalid="ignore"):
        placed = np.isfinite(points.inverse_depth) & (points.inverse_depth > 0)
    segment = odometry.keyframes.segment[points.host]
    everywhere = odometry.points_world()
    for one in np.unique(segment[placed]):
        members = np.flatnonzero(placed & (segment == one))
        sigma = spread / points.inverse_depth[members].astype(np.float64)
        near, r2 = nearest(everywhere[members], FURTHEST * sigma, NEAREST + 1)
        weigh_nearest(members, near, r2, sigma, OWN, rows, closeness)
    return Neighbours(rows, closeness)


def alone(count: int) -> Neighbours:
    """Points that share with no other."""
    return Neighbours(np.arange(count, dtype=np.int32)[:, None], np.ones((count, 1), np.float32))


def nearest(places: FloatArray, radius: FloatArray, count: int) -> tuple[NDArray[np.int32], FloatArray]:
    """Rows (N, count) of the nearest of N places (N, 3), each within its own radius (N,), itself among them, nearest first and of
    equal ones the lowest rows first; and their squared distances. -1 and inf where there are no more."""
    levels = max(0, (len(places) // LEAF).bit_length() - 1)
    sorted_places, order = np.array(places, np.float64, order="C"), np.arange(len(places), dtype=np.int32)
    axes, splits = np.zeros((1 << levels) - 1, np.int8), np.zeros((1 << levels) - 1)
    rows, distance2 = np.empty((len(places), count), np.int32), np.empty((len(places), count))
    grow_tree(sorted_places, order, axes, splits, levels)
    nearest_within(sorted_places, order, axes, splits, levels, radius, rows, distance2)
    return rows, distance2


def shared(
    votes: SparseVotes, near: Neighbours, baseline: NDArray[np.uint8], least_share: float
) -> tuple[NDArray[np.uint8], SparseVotes]:
    """Labels (P,) and votes when every point's votes are the mean of its neighbours'; the sum of its weights stays.

    baseline : (P,) the labels of points without votes; least_share : classes with less of a point's votes are not kept
    """
    labels, parts = baseline.copy(), []
    for first in range(0, len(baseline), _BLOCK):
        stop = min(first + _BLOCK, len(baseline))
        block = votes_around(votes.start, votes.classes, votes.weights, near.rows, near.closeness, first, stop, CLASS_COUNT)
        labels[first:stop] = winners(block, baseline[first:stop])
        parts.append(sparse_votes(block, least_share))
    if not parts:
        return labels, votes
    kinds, classes, weights = (np.concatenate(column) for column in zip(*parts, strict=True))
    return labels, SparseVotes(np.concatenate([[0], np.cumsum(kinds)]), classes, weights)
