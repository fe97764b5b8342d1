"""Fusion of points with the surfaces that all drives see around them."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_ID
from wayloom.stitching.grid import hash_table, lowest, neighbour_steps, pack_cells
from wayloom.stitching.kernels import surfaces
from wayloom.stitching.points import MapPoints
from wayloom.stitching.settings import FITS, MergeSettings

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
NO_SURFACE, GROUND, UPRIGHT = range(3)
GROUPS: Final = {GROUND: ("road", "sidewalk", "terrain"), UPRIGHT: ("building", "wall", "fence")}
"""Classes whose points lie on planes, by what a network takes for each other."""
GROUP_OF_CLASS: Final = np.zeros(256, np.int64)
for _group, _names in GROUPS.items():
    GROUP_OF_CLASS[[CLASS_ID[name] for name in _names]] = _group


@dataclass(frozen=True, slots=True)
class Planes:
    """C planes of cells, sorted by key.

    cells (C, 3) of the grid; key (C,) packed with the group from `low` (3,) on, in `table`; plane (C, 7) as in
    `wayloom.stitching.kernels.surfaces.fit_planes`
    """

    cells: IntArray
    key: IntArray
    low: IntArray
    table: IntArray
    plane: FloatArray


@dataclass(frozen=True, slots=True)
class FusedPoints:
    """Where the points lie after the fusion.

    xyz       (P, 3) m; variance (P,) m^2, along the normal where there is a surface, else along the worst axis
    surface   (P,) row of the plane that the point lies on, -1: none
    refuted   (P,) whether it lies on none, and its ray crosses one within `reach_m`: surfaces are opaque, and seen where they are
    planes    the surfaces
    """

    xyz: FloatArray
    variance: FloatArray
    surface: IntArray
    refuted: NDArray[np.bool_]
    planes: Planes


def fit(points: MapPoints, settings: MergeSettings) -> Planes:
    """The planes of the cells that hold points of ground or upright classes sure enough."""
    group = GROUP_OF_CLASS[points.label]
    cells = np.floor(points.xyz / settings.surface_cell_m).astype(np.int64)
    low = lowest(cells) - 64  # further than any ray is followed
    sure = np.flatnonzero((group != NO_SURFACE) & (points.sigma2 <= settings.surface_sigma_m**2))
    packed = pack_cells(cells[sure], low, group[sure])
    key, first, row = np.unique(packed, return_index=True, return_inverse=True)
    cell = np.full(len(points), -1)
    cell[sure] = row
    local = points.xyz - cells * settings.surface_cell_m
    table, plane = hash_table(key), np.zeros((len(key), 7))
    steps, floor2 = neighbour_steps(), settings.surface_floor_m**2
    for _ in range(FITS):
        moments = np.zeros((len(key), surfaces.MOMENTS))
        surfaces.add_moments(cell, local, points.sigma2, points.across2, points.ray, points.common, plane, moments)
        surfaces.fit_planes(key, table, steps, moments, settings.surface_cell_m, settings.surface_points, floor2, plane)
    return Planes(cells[sure][first], key, low, table, plane)


def fuse(points: MapPoints, settings: MergeSettings) -> FusedPoints:
    """Each point of a ground or upright class moved onto the surface that it most likely lies on."""
    planes = fit(points, settings)
    fused, surface = points.xyz.copy(), np.full(len(points), -1)
    variance = points.sigma2 + np.trace(points.common, axis1=1, axis2=2) / 3.0
    surfaces.fuse(
        points.xyz,
        GROUP_OF_CLASS[points.label],
        points.sigma2,
        points.across2,
        points.ray,
        points.common,
        planes.key,
        planes.table,
        planes.low,
        neighbour_steps(),
        planes.plane,
        settings.surface_cell_m,
        settings.reach_m,
        settings.gate_sigma**2,
        fused,
        variance,
        surface,
    )
    return FusedPoints(fused, variance, surface, _refuted(points, surface, planes, settings), planes)


def _refuted(points: MapPoints, surface: IntArray, planes: Planes, settings: MergeSettings) -> NDArray[np.bool_]:
    group = GROUP_OF_CLASS[points.label]
    rows = np.flatnonzero((surface < 0) & (group != NO_SURFACE))
    crossed = np.zeros(len(rows), np.bool_)
    surfaces.crossing(
        rows,
        points.xyz,
        group,
        points.ray,
        planes.key,
        planes.table,
        planes.low,
        neighbour_steps(),
        planes.plane,
        settings.surface_cell_m,
        settings.reach_m,
        crossed,
    )
    out = np.zeros(len(points), np.bool_)
    out[rows] = crossed
    return out
