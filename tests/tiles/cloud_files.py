"""The 3D tiles of a made map as a folder, and what is in it as a reader of the standards finds it."""

import json
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from made_maps import made_map

from wayloom.stitching.voxel_map import VoxelMap
from wayloom.tiles.cloud_pyramid import cloud_tiles, root_of, top_zoom
from wayloom.tiles.formats import TILE_FORMATS, Tile
from wayloom.tiles.pyramid import WholeMap
from wayloom.tiles.settings import TileSettings

TURN = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
"""From glTF's axes, y up, to those of 3D Tiles, z up."""
SMALL = TileSettings(cloud_points_per_tile=200)


def tiles_of(city: VoxelMap, settings: TileSettings = SMALL) -> list[Tile]:
    """All 3D tiles of a map."""
    assert city.frame is not None
    source = WholeMap(city, city.frame, settings, ())
    return list(cloud_tiles(source.blocks, source, settings))


def write_folder(folder: Path, city: VoxelMap | None = None, settings: TileSettings = SMALL) -> Path:
    """`tileset.json` and all that it refers to."""
    city = city or made_map(20_000)
    assert city.frame is not None
    tops = []
    for tile in tiles_of(city, settings):
        suffix = next(form.suffix for form in TILE_FORMATS.values() if form.layer == tile.layer)
        path = folder / tile.layer / str(tile.z) / str(tile.x) / f"{tile.y}{suffix}"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(tile.data)
        if suffix == ".json" and tile.z == top_zoom(settings):
            tops.append(tile.data)
    root = folder / "tileset.json"
    root.write_bytes(root_of(tops, city.frame))
    return root


def gltf_of(data: bytes) -> tuple[dict[str, Any], bytes]:
    """The JSON and the binary chunk of a GLB file."""
    size = struct.unpack_from("<I", data, 12)[0]
    document = json.loads(data[20 : 20 + size])
    return document, data[28 + size :]


def attribute(data: bytes, name: str) -> np.ndarray:
    """An attribute of the one primitive, by its accessor and view."""
    document, body = gltf_of(data)
    accessor = document["accessors"][document["meshes"][0]["primitives"][0]["attributes"][name]]
    view = document["bufferViews"][accessor["bufferView"]]
    width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor["type"]]
    kind = np.dtype({5121: "<u1", 5126: "<f4"}[accessor["componentType"]])
    start = view["byteOffset"] + accessor["byteOffset"]
    rows = [
        np.frombuffer(body, kind, width, start + row * view["byteStride"]) for row in range(accessor["count"])
    ]  # fmt: skip
    return np.array(rows)


def walk(file: Path) -> Iterator[tuple[dict[str, Any], np.ndarray, Path, dict[str, Any] | None]]:
    """Every tile with GLB content below a tileset, links followed: the tile, its T_ecef_tile, its file, the tile above."""
    yield from _walk(json.loads(file.read_text())["root"], np.eye(4), file.parent, None)


def _walk(
    tile: dict[str, Any], T: np.ndarray, folder: Path, above: dict[str, Any] | None
) -> Iterator[tuple[dict[str, Any], np.ndarray, Path, dict[str, Any] | None]]:
    T = T @ np.array(tile.get("transform", np.eye(4).ravel())).reshape(4, 4).T
    uri = tile.get("content", {}).get("uri", "")
    if uri.endswith(".json"):
        file = (folder / uri).resolve()
        yield from _walk(json.loads(file.read_text())["root"], T, file.parent, above)
        return
    if uri:
        yield tile, T, (folder / uri).resolve(), above
    for child in tile.get("children", ()):
        yield from _walk(child, T, folder, tile if uri else above)
