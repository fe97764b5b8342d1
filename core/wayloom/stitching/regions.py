"""Regions: the squares of the map frame's grid by which the map is merged, stored and made anew."""

import itertools
from collections.abc import Iterable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import InputError
from wayloom.files.blob import decode_blob, encode_blob
from wayloom.geodesy.map_frame import MapFrame
from wayloom.stitching.merge import merge
from wayloom.stitching.settings import MergeSettings
from wayloom.stitching.voxel_map import VoxelMap, map_of_arrays
from wayloom.submaps.submap import PlacedSubmap

FloatArray = NDArray[np.float64]
RegionKey = tuple[int, int]
"""Column from the west, row from the south."""
REGION_M: Final = 64.0
HALO_M: Final = 2.0
"""How far around a region points bear on what is in it."""
MAGIC: Final = b"WLREGION"
VERSION: Final = 1
DTYPES: Final = {
    "keys": "<i4", "points_enu": "<f8", "votes": "<f4", "label": "|u1", "count": "<u4", "drives": "<u2", "last_seen_ns": "<i8",
}  # fmt: skip


def region_edges(key: RegionKey) -> tuple[FloatArray, FloatArray]:
    """South-western and north-eastern corner (2,), m east and north in the map's frame."""
    low = REGION_M * np.array(key, np.float64)
    return low, low + REGION_M


def regions_within(low_enu: FloatArray, high_enu: FloatArray) -> Iterable[RegionKey]:
    """The regions that points of a box (2,) to (2,), m east and north, may bear on."""
    first = np.floor((low_enu - HALO_M) / REGION_M).astype(int).tolist()
    last = np.floor((high_enu + HALO_M) / REGION_M).astype(int).tolist()
    return itertools.product(range(first[0], last[0] + 1), range(first[1], last[1] + 1))


def fuse_region(key: RegionKey, placed: Iterable[PlacedSubmap], settings: MergeSettings) -> VoxelMap:
    """The voxels of a region, from the submaps that bear on it, in any order."""
    voxels = merge(placed, settings)
    low, high = region_edges(key)
    flat = (voxels.keys[:, :2] + 0.5) * settings.voxel_m
    inside = (flat >= low) & (flat < high)
    return voxels.take(inside[:, 0] & inside[:, 1])


def encode_region(voxels: VoxelMap) -> bytes:
    """The region's bytes: equal voxels give equal bytes."""
    assert voxels.frame is not None
    frame = [voxels.frame.lon_deg, voxels.frame.lat_deg, voxels.frame.height_m]
    header = {"frame": frame, "voxel_m": voxels.voxel_m}
    return encode_blob(MAGIC, VERSION, header, {name: np.asarray(getattr(voxels, name), dtype) for name, dtype in DTYPES.items()})


def decode_region(data: bytes, name: str = "region") -> VoxelMap:
    """The inverse of `encode_region`. Raises InputError for bytes that are none."""
    try:
        header, arrays = decode_blob(data, MAGIC, VERSION, DTYPES)
        return map_of_arrays(MapFrame(*header["frame"]), float(header["voxel_m"]), arrays)
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"is no region or is damaged ({error})", file=name, remedy="have the map stitched anew") from error
