"""Folders of tiles of a map: 3D Tiles 1.1 with a root `tileset.json`, or XYZ tiles as any static server can hand them out."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from wayloom.errors import InputError
from wayloom.exports.boxes import nothing_inside
from wayloom.exports.pyramids import MapPyramid
from wayloom.exports.source import MapSource
from wayloom.files.atomic import new_folder, write_atomically
from wayloom.geodesy.antimeridian import Box
from wayloom.geodesy.map_frame import MapFrame
from wayloom.tiles.cloud_pyramid import root_of, top_zoom
from wayloom.tiles.descriptions import SUFFIXES
from wayloom.tiles.formats import SERVED_LAYERS, TILE_FORMATS, Tile
from wayloom.tiles.settings import TileSettings

ROOT: Final = "tileset.json"
PROVENANCE: Final = "provenance.json"


def write_tileset(folder: Path, source: MapSource, box: Box | None, provenance: Mapping[str, Any]) -> int:
    """Write the static points as 3D Tiles; how many tiles. Raises InputError where nothing lies in the box, OSError."""
    frame, settings, count = _frame_of(source, folder), TileSettings(), 0
    with new_folder(folder) as new:
        tops: list[bytes] = []
        for tile in MapPyramid(source, frame, box, settings).cloud_tiles():
            _put(new, tile)
            count += 1
            if tile.layer == TILE_FORMATS["tileset"].layer and tile.z == top_zoom(settings):
                tops.append(tile.data)
        if not tops:
            raise nothing_inside(folder)
        root = json.loads(root_of(tops, frame))
        root["asset"]["extras"] = {**root["asset"].get("extras", {}), "provenance": dict(provenance)}
        write_atomically(new / ROOT, json.dumps(root, separators=(",", ":")).encode())
    return count


def write_tile_folder(folder: Path, source: MapSource, box: Box | None, provenance: Mapping[str, Any]) -> int:
    """Write all served tiles as <folder>/<layer>/<z>/<x>/<y><suffix>; how many. Raises InputError, OSError."""
    frame, count = _frame_of(source, folder), 0
    with new_folder(folder) as new:
        pyramid = MapPyramid(source, frame, box, TileSettings())
        for tiles in (pyramid.tiles(), pyramid.feature_tiles(), pyramid.ground_tiles()):
            for tile in tiles:
                if tile.layer in SERVED_LAYERS:
                    _put(new, tile)
                    count += 1
        write_atomically(new / PROVENANCE, json.dumps(provenance).encode())
    return count


def _frame_of(source: MapSource, folder: Path) -> MapFrame:
    if source.frame is None:
        raise InputError("is of places on Earth, and this drive has none", file=folder, remedy="process it with --gnss")
    return source.frame


def _put(folder: Path, tile: Tile) -> None:
    write_atomically(folder / tile.layer / str(tile.z) / str(tile.x) / f"{tile.y}{SUFFIXES[tile.layer]}", tile.data)
