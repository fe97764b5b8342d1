"""Compact 3D point tile: the voxels of one tile in its own tangent plane (`docs/formats.md`, "Point tile")."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_COUNT
from wayloom.errors import InputError
from wayloom.files.blob import decode_blob, encode_blob
from wayloom.geodesy.map_frame import MapFrame
from wayloom.tiles.grid import TileAddress, check_tile, tile_bounds, tile_centre

FloatArray = NDArray[np.float64]
MAGIC: Final = b"WLPOINTS"
VERSION: Final = 1
FINEST_SCALE_M = 0.01
INT16_MAX = 32_767
DTYPES: Final = {"position": "<i2", "voxels": "<u4", "label": "|u1", "confidence": "|u1", "drives": "|u1"}


@dataclass(frozen=True, slots=True)
class PointTile:
    """N points.

    tile        its address
    origin      the tangent plane of the points: at the tile's centre
    position    (N, 3) m east, north, up of the origin
    voxels      (N,) how many voxels of the map each point stands for
    label       (N,) train ids; confidence (N,) uint8, 255 = all votes; drives (N,) distinct drives, 255 = that many or more
    """

    tile: TileAddress
    origin: MapFrame
    position: FloatArray
    voxels: NDArray[np.uint32]
    label: NDArray[np.uint8]
    confidence: NDArray[np.uint8]
    drives: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.position)


def origin_of(tile: TileAddress, height_m: float) -> MapFrame:
    """The tangent plane of a point tile."""
    return MapFrame(*tile_centre(tile), height_m)


def encode_points(points: PointTile, scale_m: float = FINEST_SCALE_M) -> bytes:
    """The tile's bytes. Positions are rounded to scale_m, or to the next power-of-two multiple of it that reaches all points."""
    reach = float(np.abs(points.position).max(initial=0.0))
    while reach / scale_m > INT16_MAX:
        scale_m *= 2.0
    origin = points.origin
    header: dict[str, Any] = {
        "tile": list(points.tile),
        "bounds_wsen_deg": list(tile_bounds(points.tile)),
        "origin_lon_lat_height": [origin.lon_deg, origin.lat_deg, origin.height_m],
        "scale_m": scale_m,
        "points": len(points),
    }
    arrays = {
        "position": np.rint(points.position / scale_m).astype("<i2"),
        "voxels": points.voxels.astype("<u4"),
        "label": points.label.astype(np.uint8),
        "confidence": points.confidence.astype(np.uint8),
        "drives": points.drives.astype(np.uint8),
    }
    return encode_blob(MAGIC, VERSION, header, arrays)


def decode_points(data: bytes, name: str = "point tile") -> PointTile:
    """The inverse of `encode_points`. Raises InputError for bytes that are no point tile."""
    try:
        header, arrays = decode_blob(data, MAGIC, VERSION, DTYPES)
        tile, origin = check_tile(*header["tile"]), MapFrame(*header["origin_lon_lat_height"])
        position = arrays.pop("position") * float(header["scale_m"])
        return PointTile(tile, origin, position, **arrays)
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"is no point tile or is damaged ({error})", file=name, remedy="fetch the tile again") from error


def voxel_downsampled(points: PointTile, limit: int, voxel_m: float) -> PointTile:
    """At most `limit` points: voxels merged in twos, fours, … along each axis, their counts added for each class apart.

    So a class keeps its count exactly, and a point tile says the same of a class as every other tile over the same ground. Where
    classes alone are more than the limit, joining stops at one point for each class.
    """
    size = voxel_m
    while len(points) > max(limit, CLASS_COUNT):
        size *= 2.0
        points = _joined(points, size)
    return points


def _joined(points: PointTile, size_m: float) -> PointTile:
    cell = np.floor(points.position / size_m).astype(np.int64)
    keys, group = np.unique(np.column_stack([cell, points.label]), axis=0, return_inverse=True)
    group = group.reshape(-1)
    weight = points.voxels.astype(np.float64)
    total = np.bincount(group, weight)
    position = np.column_stack([np.bincount(group, weight * points.position[:, axis]) / total for axis in range(3)])
    confidence = np.rint(np.bincount(group, weight * points.confidence) / total).astype(np.uint8)
    drives = np.zeros(len(keys), np.uint8)
    np.maximum.at(drives, group, points.drives)
    return PointTile(points.tile, points.origin, position, total.astype(np.uint32), keys[:, 3].astype(np.uint8), confidence, drives)
