"""Regions of the map: squares of the grid, each a pure function of the set of submaps around it.

What is fused at a place depends on the points within `MergeSettings.halo_m` of it and on nothing else. All sums are of whole
numbers or run in the canonical order of drive, digest and row. So a region has the same bits whatever order its submaps come in,
and the union of all regions is what one region as large as the map gives.
"""

import hashlib
import itertools
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_COUNT, MOVING_CLASSES, SKY
from wayloom.geodesy.map_frame import MapFrame
from wayloom.stitching.fusion import FusedPoints, fuse
from wayloom.stitching.grid import unpack
from wayloom.stitching.layers import LAYERS, MOVING, PARKED, STATIC, UNCONFIRMED, layers_of
from wayloom.stitching.points import VEHICLES, Box, MapPoints, canonical, check_reach, frame_of, map_points
from wayloom.stitching.settings import HALO_M, MergeSettings
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
}


RegionKey = tuple[int, int]
"""Column from the west, row from the south."""
REGION_M: Final = 64.0


@dataclass(frozen=True, slots=True)
class RegionMap:
    """The layers of one region by their names in LAYERS. Parked and moving things, and what waits for another drive to confirm it,
    are kept apart: only `static` is published."""

    key: RegionKey
    layers: dict[str, VoxelMap]


def region_edges(key: RegionKey, edge_m: float = REGION_M) -> tuple[FloatArray, FloatArray]:
    """South-western and north-eastern corner (2,), m east and north in the map's frame."""
    return edge_m * np.array(key, np.float64), edge_m * (np.array(key, np.float64) + 1.0)


def regions_within(low_enu: FloatArray, high_enu: FloatArray) -> Iterable[RegionKey]:
    """The regions that points of a box (2,) to (2,), m east and north, may bear on."""
    first = np.floor((low_enu - HALO_M) / REGION_M).astype(int).tolist()
    last = np.floor((high_enu + HALO_M) / REGION_M).astype(int).tolist()
    return itertools.product(range(first[0], last[0] + 1), range(first[1], last[1] + 1))


def regions_of(item: PlacedSubmap, settings: MergeSettings = MergeSettings(), edge_m: float = REGION_M) -> set[RegionKey]:
    """The regions that a submap may change: those that its points, and the halo around them, reach."""
    xyz = item.points_enu()
    check_reach(item, xyz, settings.voxel_m)
    low, high = (np.floor((xyz[:, :2] + side * settings.halo_m) / edge_m).astype(np.int64) for side in (-1.0, 1.0))
    corners = np.unique(np.hstack([low, high]), axis=0) if len(xyz) else np.zeros((0, 4), np.int64)
    return {(i, j) for west, south, east, north in corners.tolist() for i in range(west, east + 1) for j in range(south, north + 1)}


def region_inputs_digest(
    key: RegionKey, placed: Iterable[PlacedSubmap], settings: MergeSettings = MergeSettings(), edge_m: float = REGION_M
) -> str:
    """SHA-256 of all that a region is made from: submaps that reach it, poses, covariances, settings, frame."""
    inputs = [
        [item.drive_id, item.submap.digest, item.T_enu_submap.tolist(), np.nan_to_num(item.covariance).tolist()]
        for item in canonical(placed)
        if key in regions_of(item, settings, edge_m)
    ]
    frame = next((item.frame for item in canonical(placed)), None)
    content = [
        list(key),
        edge_m,
        settings.model_dump(),
        None if frame is None else [frame.lon_deg, frame.lat_deg, frame.height_m],
        inputs,
    ]
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()


def fuse_region(
    key: RegionKey, placed: Iterable[PlacedSubmap], settings: MergeSettings = MergeSettings(), edge_m: float = REGION_M
) -> RegionMap:
    """The layers of one region of the map.

    placed : at least every submap that `regions_of` says to reach it, in any order; one that comes twice counts once
    Raises StageError when the submaps are of different frames, or lie beyond KEY_LIMITS voxels from the frame's origin.
    """
    items = canonical(placed)
    low, high = region_edges(key, edge_m)
    points = map_points(items, Box(low - settings.halo_m, high + settings.halo_m, low, high), settings)
    fused, layer = fused_points(points, settings)
    layers = {
        name: _voxel_map(points, fused, np.flatnonzero(layer == number), number, (low, high), frame_of(items), settings)
        for number, name in enumerate(LAYERS)
    }
    return RegionMap(key, layers)


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
