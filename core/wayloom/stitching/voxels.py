"""Voxels of one layer: fixed-point sums of the fused points in each, and the votes of the surface around each."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_COUNT
from wayloom.stitching.fusion import FusedPoints
from wayloom.stitching.grid import neighbour_steps, pack, unpack
from wayloom.stitching.kernels import neighbours
from wayloom.stitching.kernels.accumulate import add_points
from wayloom.stitching.layers import by_cells
from wayloom.stitching.points import VOTE_STEPS, MapPoints
from wayloom.stitching.settings import MergeSettings

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
OFFSET_STEPS: Final = 4096
WEIGHT_STEPS, MAX_WEIGHT = 16.0, 160_000  # of 1/m^2: a sigma of 1 cm
NEVER_NS, EVER_NS = np.iinfo(np.int64).min, np.iinfo(np.int64).max


@dataclass(frozen=True, slots=True)
class Voxels:
    """V voxels of the points of one layer, sorted by key: key (V,) packed, xyz (V, 3) m, variance (V,) m^2, surface (V,) row of its
    surest point's plane or -1, grey (V,) uint8, votes (V, 19) int64, count, first_ns, last_ns (V,), and the ragged drives of its
    own points."""

    key: IntArray
    xyz: FloatArray
    variance: FloatArray
    surface: IntArray
    grey: NDArray[np.uint8]
    votes: IntArray
    count: IntArray
    first_ns: IntArray
    last_ns: IntArray
    drive_start: IntArray
    drive: IntArray

    def __len__(self) -> int:
        return len(self.key)


def voxels_of(points: MapPoints, fused: FusedPoints, rows: IntArray, voxel_m: float) -> Voxels:
    """The voxels of the points of these rows (R,), increasing."""
    in_voxels = fused.xyz[rows] / voxel_m
    keys = np.floor(in_voxels).astype(np.int64)
    key, voxel = np.unique(pack(keys), return_inverse=True)
    n, seen_ns = len(key), points.seen_ns[rows]
    offset = np.minimum(np.floor((in_voxels - keys) * OFFSET_STEPS).astype(np.int64), OFFSET_STEPS - 1)
    weight = np.clip(np.rint(WEIGHT_STEPS / fused.variance[rows]), 1, MAX_WEIGHT).astype(np.int64)
    weight_sum, offset_sum, votes = np.zeros(n, np.int64), np.zeros((n, 3), np.int64), np.zeros((n, CLASS_COUNT), np.int64)
    count, first_ns, last_ns = np.zeros(n, np.int64), np.full(n, EVER_NS), np.full(n, NEVER_NS)
    start, taken = _ragged(points.vote_start, rows)
    add_points(
        voxel, weight, offset, seen_ns, start, points.vote_class[taken], points.vote_weight[taken],
        weight_sum, offset_sum, votes, count, first_ns, last_ns,
    )  # fmt: skip
    # The middle of the step that the offset was floored to.
    within = (offset_sum / np.maximum(weight_sum, 1)[:, None] + 0.5) / OFFSET_STEPS
    surest = np.lexsort((fused.variance[rows], voxel))[np.concatenate([[0], np.cumsum(count)])[:-1]]
    pairs = np.unique(np.column_stack([voxel, points.drive[rows]]), axis=0)
    return Voxels(
        key,
        (unpack(key) + within) * voxel_m,
        fused.variance[rows][surest],
        fused.surface[rows][surest],
        _mean_grey(points.grey[rows], weight, voxel, weight_sum),
        votes,
        count,
        first_ns,
        last_ns,
        np.searchsorted(pairs[:, 0], np.arange(n + 1)),
        pairs[:, 1],
    )


def _mean_grey(grey: NDArray[np.uint8], weight: IntArray, voxel: IntArray, weight_sum: IntArray) -> NDArray[np.uint8]:
    """(V,) of points (R,) in voxels, weighed as their positions are: float64 holds these sums of whole numbers exactly."""
    total = np.bincount(voxel, weight * grey.astype(np.int64), len(weight_sum)).astype(np.int64)
    return np.asarray((2 * total + weight_sum) // (2 * weight_sum), np.uint8)


def _ragged(start: IntArray, rows: IntArray) -> tuple[IntArray, IntArray]:
    length = start[rows + 1] - start[rows]
    new = np.concatenate([[0], np.cumsum(length)])
    return new, np.repeat(start[rows] - new[:-1], length) + np.arange(new[-1])


def pooled(voxels: Voxels, wanted: IntArray, fused: FusedPoints, drives: int, settings: MergeSettings) -> Voxels:
    """The wanted voxels (W,) rows, each with the votes, drives and times of the voxels of its surface around it.

    A voxel's own votes weigh 1, others from 1 / OWN_WEIGHT down to 0 at `vote_reach_m`, all in units of 1 / VOTE_UNIT.
    """
    order, key, start, table = by_cells(voxels.xyz, max(settings.vote_reach_m, settings.lone_vote_reach_m))
    place = np.empty(len(order), np.int64)
    place[order] = np.arange(len(order))
    ragged_start, taken = _ragged(voxels.drive_start, order)
    on_surface = voxels.surface[order] >= 0
    normal = np.zeros((len(order), 3))
    normal[on_surface] = fused.planes.plane[voxels.surface[order][on_surface], :3]
    votes = np.zeros((len(wanted), CLASS_COUNT), np.int64)
    first_ns, last_ns = np.full(len(wanted), EVER_NS), np.full(len(wanted), NEVER_NS)
    drive_start, room = np.zeros(len(wanted) + 1, np.int64), 4 * len(wanted) + 16
    pool: Any = neighbours.pool
    arguments: Any = (
        voxels.xyz[order], normal, on_surface, voxels.votes[order], voxels.first_ns[order], voxels.last_ns[order],
        ragged_start, voxels.drive[taken], place[wanted], key, start, table, neighbour_steps(),
        settings.vote_reach_m**2, settings.lone_vote_reach_m**2, settings.surface_thickness_m, drives,
    )  # fmt: skip
    while True:
        drive = np.zeros(room, np.int64)
        votes[:], first_ns[:], last_ns[:] = 0, EVER_NS, NEVER_NS
        size = pool(*arguments, votes, first_ns, last_ns, drive, drive_start)
        if size >= 0:
            break
        room *= 4
    return Voxels(
        voxels.key[wanted],
        voxels.xyz[wanted],
        voxels.variance[wanted],
        voxels.surface[wanted],
        voxels.grey[wanted],
        votes,
        voxels.count[wanted],
        first_ns,
        last_ns,
        drive_start,
        drive[:size],
    )


VOTE_UNIT: Final = VOTE_STEPS * neighbours.KERNEL_STEPS * neighbours.OWN_WEIGHT
"""Of pooled votes, per 1/m."""
