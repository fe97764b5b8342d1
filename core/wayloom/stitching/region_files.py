"""Region as bytes: equal regions give equal bytes (`docs/formats.md`, "Region")."""

from dataclasses import asdict
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import InputError
from wayloom.files.blob import decode_blob, encode_blob
from wayloom.geodesy.map_frame import MapFrame
from wayloom.stitching.change_types import Change
from wayloom.stitching.layer_names import LAYERS
from wayloom.stitching.region_grid import RegionMap
from wayloom.stitching.voxel_map import VoxelMap

MAGIC: Final = b"WLREGION"
VERSION: Final = 3
DTYPES_OF_LAYER: Final = {
    "keys": "<i4", "points_enu": "<f8", "grey": "|u1", "sigma_m": "<f4", "votes": "<f4", "label": "|u1", "count": "<u4",
    "drive_start": "<i8", "drive": "<i4", "first_seen_ns": "<i8", "last_seen_ns": "<i8",
}  # fmt: skip
DTYPES: Final = {f"{layer}.{name}": dtype for layer in LAYERS for name, dtype in DTYPES_OF_LAYER.items()}


def encode_region(region: RegionMap, frame: MapFrame) -> bytes:
    """The region's bytes."""
    header = {
        "key": list(region.key),
        "frame": [frame.lon_deg, frame.lat_deg, frame.height_m],
        "voxel_m": region.layers[LAYERS[0]].voxel_m,
        "drive_ids": {name: list(layer.drive_ids) for name, layer in region.layers.items()},
        "left_out": {name: layer.left_out for name, layer in region.layers.items()},
        "changes": [asdict(one) for one in region.changes],
    }
    arrays: dict[str, NDArray[Any]] = {}
    for layer in LAYERS:
        for name, dtype in DTYPES_OF_LAYER.items():
            arrays[f"{layer}.{name}"] = np.asarray(getattr(region.layers[layer], name), dtype)
    return encode_blob(MAGIC, VERSION, header, arrays)


def decode_region(data: bytes, name: str = "region") -> RegionMap:
    """The inverse of `encode_region`. Raises InputError for bytes that are none."""
    try:
        header, arrays = decode_blob(data, MAGIC, VERSION, DTYPES)
        layers = {layer: _layer(layer, header, arrays) for layer in LAYERS}
        east, north = header["key"]
        return RegionMap((int(east), int(north)), layers, tuple(_change(one) for one in header["changes"]))
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"is no region or is damaged ({error})", file=name, remedy="have the map stitched anew") from error


def _change(fields: dict[str, Any]) -> Change:
    values: dict[str, Any] = {name: tuple(value) if isinstance(value, list) else value for name, value in fields.items()}
    return Change(**values)


def _layer(layer: str, header: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> VoxelMap:
    held: dict[str, Any] = {name: arrays[f"{layer}.{name}"] for name in DTYPES_OF_LAYER}
    return VoxelMap(
        MapFrame(*header["frame"]),
        float(header["voxel_m"]),
        **held,
        drive_ids=tuple(header["drive_ids"][layer]),
        left_out=header["left_out"][layer],
    )
