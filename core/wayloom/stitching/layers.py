"""Layers of the map: which of its points are published as static, which are parked, move, wait for confirmation, or have gone."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.stitching.fusion import GROUP_OF_CLASS, FusedPoints
from wayloom.stitching.grid import hash_table, lowest, neighbour_steps, pack_cells
from wayloom.stitching.kernels import neighbours
from wayloom.stitching.layer_names import MOVING, PARKED, STATIC, UNCONFIRMED
from wayloom.stitching.points import VEHICLES, MapPoints
from wayloom.stitching.settings import MergeSettings

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
STANDING_CELL_M: Final = 0.5


def layers_of(points: MapPoints, fused: FusedPoints, settings: MergeSettings) -> NDArray[np.int8]:
    """(P,) row of LAYERS.

    A vehicle's point is parked where its drive saw vehicles around it for `standing_s`. A static point is published when it lies
    on a surface, when a point of another drive lies beside it, or when its own sigma is small and no surface refutes it.
    """
    vehicle = np.isin(points.label, VEHICLES)
    out = np.full(len(points), STATIC, np.int8)
    rows = np.flatnonzero(vehicle)
    out[rows] = np.where(_standing_s(points, rows) >= settings.standing_s, PARKED, MOVING)
    lone = np.flatnonzero(~vehicle & (fused.surface < 0) & (fused.refuted | (points.sigma2 > settings.lone_sigma_m**2)))
    out[lone[~_beside_another_drive(points, fused, settings)[lone]]] = UNCONFIRMED
    return out


def by_cells(xyz: FloatArray, cell_m: float) -> tuple[IntArray, IntArray, IntArray, IntArray]:
    """Order (P,) that sorts points by cell, the cells' keys (C,), their start (C + 1,) among the sorted points, and hash table."""
    cells = np.floor(xyz / cell_m).astype(np.int64)
    packed = pack_cells(cells, lowest(cells) - 2)
    order = np.argsort(packed, kind="stable")
    key, first = np.unique(packed[order], return_index=True)
    return order, key, np.append(first, len(xyz)), hash_table(key)


def _standing_s(points: MapPoints, rows: IntArray) -> FloatArray:
    """(R,) seconds between the first and the last of these points that the same drive has in the same cell and those around it."""
    cells = np.floor(points.xyz[rows] / STANDING_CELL_M).astype(np.int64)
    packed = pack_cells(cells, lowest(cells) - 2, points.drive[rows])
    key, place = np.unique(packed, return_inverse=True)
    first, last = np.full(len(key), np.iinfo(np.int64).max), np.full(len(key), np.iinfo(np.int64).min)
    np.minimum.at(first, place, points.seen_ns[rows])
    np.maximum.at(last, place, points.seen_ns[rows])
    earliest, latest = first.copy(), last.copy()
    for step in neighbour_steps()[1:, 0]:
        other = np.minimum(np.searchsorted(key, key + step), max(len(key) - 1, 0))
        there = np.flatnonzero(key[other] == key + step)
        earliest[there] = np.minimum(earliest[there], first[other[there]])
        latest[there] = np.maximum(latest[there], last[other[there]])
    return np.asarray((latest[place] - earliest[place]) / 1e9)


def _beside_another_drive(points: MapPoints, fused: FusedPoints, settings: MergeSettings) -> NDArray[np.bool_]:
    order, key, start, table = by_cells(fused.xyz, settings.confirm_m)
    found = np.zeros(len(points), np.bool_)
    group = np.where(np.isin(points.label, VEHICLES), -1, GROUP_OF_CLASS[points.label])[order]
    radius2 = settings.confirm_m**2
    neighbours.confirmed(fused.xyz[order], points.drive[order], group, key, start, table, neighbour_steps(), radius2, found)
    out = np.empty(len(points), np.bool_)
    out[order] = found
    return out
