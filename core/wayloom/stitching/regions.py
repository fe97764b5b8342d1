"""Regions of the map: squares of the grid, each a pure function of the set of submaps around it.

What is fused at a place depends on the points within `MergeSettings.halo_m` of it and on nothing else. All sums are of whole
numbers or run in the canonical order of drive, digest and row. So a region has the same bits whatever order its submaps come in,
and the union of all regions is what one region as large as the map gives.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_COUNT, MOVING_CLASSES, SKY
from wayloom.geodesy.map_frame import MapFrame
from wayloom.stitching.change import judge_change
from wayloom.stitching.change_types import Change
from wayloom.stitching.fusion import FusedPoints, fuse
from wayloom.stitching.grid import unpack
from wayloom.stitching.layer_names import GONE, LAYERS, MOVING, PARKED, STATIC, UNCONFIRMED
from wayloom.stitching.layers import layers_of
from wayloom.stitching.placed_looks import PlacedLooks, canonical_looks
from wayloom.stitching.points import VEHICLES, Box, MapPoints, canonical, check_reach, frame_of, map_points
from wayloom.stitching.region_grid import REGION_M, RegionKey, RegionMap, region_edges
from wayloom.stitching.settings import LOOK_HALO_M, THING_HALO_M, MergeSettings
from wayloom.stitching.voxel_map import VoxelMap, joined_maps
from wayloom.stitching.voxels import VOTE_UNIT, pooled, voxels_of
from wayloom.submaps.submap import PlacedSubmap

FloatArray = NDArray[np.float64]
STATIC_CLASSES: Final = np.array([c for c in range(CLASS_COUNT) if c not in MOVING_CLASSES and c != SKY])
CLASSES_OF_LAYER: Final = {
    STATIC: STATIC_CLASSES,
    UNCONFIRMED: STATIC_CLASSES,
    PARKED: np.array(VEHICLES),
    MOVING: np.array(VEHICLES),
    GONE: np.concatenate([STATIC_CLASSES, VEHICLES]),
}


def regions_of(item: PlacedSubmap, settings: MergeSettings = MergeSettings(), edge_m: float = REGION_M) -> set[RegionKey]:
    """The regions that a submap's points may change: those that they, and the halo around them, reach."""
    xyz = item.points_enu()
    check_reach(item, xyz, settings.voxel_m)
    return _around(xyz, settings.halo_m + THING_HALO_M, edge_m)


def regions_seen(looks: PlacedLooks, edge_m: float = REGION_M) -> set[RegionKey]:
    """The regions that the looks of a submap may change."""
    return _around(looks.T_map_cam[:, :3, 3], LOOK_HALO_M, edge_m)


def _around(xyz: FloatArray, halo_m: float, edge_m: float) -> set[RegionKey]:
    """The regions within `halo_m` east or north of any of these places (n, 3) m."""
    low, high = (np.floor((xyz[:, :2] + side * halo_m) / edge_m).astype(np.int64) for side in (-1.0, 1.0))
    corners = np.unique(np.hstack([low, high]), axis=0) if len(xyz) else np.zeros((0, 4), np.int64)
    return {(i, j) for west, south, east, north in corners.tolist() for i in range(west, east + 1) for j in range(south, north + 1)}


def fuse_region(
    key: RegionKey,
    placed: Iterable[PlacedSubmap],
    settings: MergeSettings = MergeSettings(),
    edge_m: float = REGION_M,
    looks: Iterable[PlacedLooks] = (),
) -> RegionMap:
    """The layers of one region of the map, and its changes.

    placed : at least every submap that has points within the region or HALO_M around it, in any order; one that comes twice
             counts once
    looks  : at least those whose cameras lie within the region or LOOK_HALO_M around it, likewise; without any nothing changes
    Raises StageError when the submaps are of different frames, or lie beyond KEY_LIMITS voxels from the frame's origin.
    """
    items = canonical(placed)
    low, high = region_edges(key, edge_m)
    around = Box(low - THING_HALO_M, high + THING_HALO_M, low, high)
    seen = canonical_looks(looks, around.low, around.high, settings.change.see_m)
    wide = settings.halo_m + (THING_HALO_M if seen else 0.0)
    points = map_points(items, replace(around, low=low - wide, high=high + wide), settings)
    fused, layer = fused_points(points, settings)
    changes: list[Change] = []
    if seen:
        layer, changes = judge_change(points, fused, layer, seen, around, settings.change)
    layers = {
        name: _voxel_map(points, fused, np.flatnonzero(layer == number), number, (low, high), frame_of(items), settings)
        for number, name in enumerate(LAYERS)
    }
    return RegionMap(key, layers, tuple(changes))


def fused_points(points: MapPoints, settings: MergeSettings) -> tuple[FusedPoints, NDArray[np.int8]]:
    """Where points lie after the fusion, and the layer (P,) of each."""
    fused = fuse(points, settings)
    return fused, layers_of(points, fused, settings)


def _voxel_map(
    points: MapPoints,
    fused: FusedPoints,
    rows: NDArray[np.int64],
    layer: int,
    edges: tuple[FloatArray, FloatArray],
    frame: MapFrame | None,
    settings: MergeSettings,
) -> VoxelMap:
    voxels = voxels_of(points, fused, rows, settings.voxel_m)
    middle = (unpack(voxels.key)[:, :2] + 0.5) * settings.voxel_m
    inside = ((middle >= edges[0]) & (middle < edges[1])).all(axis=1)
    own = pooled(voxels, np.flatnonzero(inside), fused, len(points.drive_ids), settings)
    classes = CLASSES_OF_LAYER[layer]
    used = np.unique(own.drive)
    return VoxelMap(
        frame,
        settings.voxel_m,
        unpack(own.key).astype(np.int32),
        own.xyz,
        own.grey,
        np.sqrt(own.variance).astype(np.float32),
        (own.votes / VOTE_UNIT).astype(np.float32),
        classes[np.argmax(own.votes[:, classes], axis=1)].astype(np.uint8),
        own.count.astype(np.uint32),
        own.drive_start,
        np.searchsorted(used, own.drive).astype(np.int32),
        own.first_ns,
        own.last_ns,
        tuple(points.drive_ids[row] for row in used.tolist()),
        points.left_out if layer == STATIC else {},
    )


def whole_map(
    regions: Sequence[RegionMap], frame: MapFrame | None, settings: MergeSettings = MergeSettings(), layer: str = "static"
) -> VoxelMap:
    """One layer of all regions."""
    return joined_maps([region.layers[layer] for region in regions], frame, settings.voxel_m)
