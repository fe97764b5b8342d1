"""MapLibre style of a map version: every layer of tiles that viewers draw, without sprites and glyphs."""

from collections.abc import Mapping
from typing import Any, Final

from wayloom.config.classes import CLASS_NAMES, PALETTE
from wayloom.stitching.layer_names import OVERLAYS
from wayloom.tiles.descriptions import Box, tile_json
from wayloom.tiles.feature_layers import AREAS, KERBS, MARKINGS, OBJECTS
from wayloom.tiles.formats import TILE_FORMATS
from wayloom.tiles.mvt import CELLS_LAYER, TRACKS_LAYER
from wayloom.tiles.rasters import HEIGHT, ORTHO, SURFACE

SEMANTIC, FEATURES = TILE_FORMATS["png"].layer, TILE_FORMATS["mvt"].layer
PAPER: Final = "#f4f3ef"
TRACK, KERB, MARKING = "#1264a3", "#ffd23f", "#1fd1ff"
PICTURES: Final = {ORTHO: "visible", SURFACE: "none", SEMANTIC: "visible"} | dict.fromkeys(OVERLAYS, "none")
"""Layers of pictures from the lowest to the highest, and whether they are shown at first."""


def map_style(name: str, layers: Mapping[str, Mapping[str, Any]], bounds: Box | None, addresses: str) -> dict[str, Any]:
    """The style of a version; sources and layers are named after the layers of tiles.

    layers    : of `MapVersion.layers`; bounds of the version, None without a place
    addresses : of the tiles of all layers, without the ending, with {layer}, {z}, {x} and {y}
    """
    described = {one: tile_json(one, layers[one], bounds, addresses.replace("{layer}", one)) for one in layers}
    drawn: list[dict[str, Any]] = [{"id": "paper", "type": "background", "paint": {"background-color": PAPER}}]
    drawn += [_picture(one, shown) for one, shown in PICTURES.items() if one in layers]
    drawn += [_relief()] if HEIGHT in layers else []
    drawn += [*_features()] if FEATURES in layers else []
    drawn += (
        [_line(KERBS, MARKINGS, KERBS, KERB, 2.0), _line(MARKINGS, MARKINGS, MARKINGS, MARKING, 2.0)] if MARKINGS in layers else []
    )
    drawn += [_areas()] if AREAS in layers else []
    drawn += [_objects()] if OBJECTS in layers else []
    sources = {str(one["source"]): _source(described[str(one["source"])]) for one in drawn if "source" in one}
    found: dict[str, Any] = {"version": 8, "name": name, "sources": sources, "layers": drawn}
    if bounds is not None:
        west, south, east, north = bounds
        found |= {"center": [0.5 * (west + east), 0.5 * (south + north)], "zoom": 15}
    return found


def _source(described: Mapping[str, Any]) -> dict[str, Any]:
    kind = "vector" if "vector_layers" in described else "raster-dem" if "encoding" in described else "raster"
    names = ("tiles", "tileSize", "minzoom", "maxzoom", "bounds", "encoding")
    return {"type": kind} | {one: described[one] for one in names if one in described}


def _picture(layer: str, visibility: str) -> dict[str, Any]:
    return {"id": layer, "type": "raster", "source": layer, "layout": {"visibility": visibility}}


def _relief() -> dict[str, Any]:
    return {"id": HEIGHT, "type": "hillshade", "source": HEIGHT, "layout": {"visibility": "none"}}


def _features() -> list[dict[str, Any]]:
    """Cells in the colour of their class, hidden below the pictures that show the same, and the tracks of the drives."""
    fill = {"fill-color": ["match", ["get", "class"], *_colours(), "#000000"], "fill-opacity": 0.8}
    cells = {"id": "cells", "type": "fill", "source": FEATURES, "source-layer": CELLS_LAYER, "layout": {"visibility": "none"}}
    return [cells | {"paint": fill}, _line("coverage", FEATURES, TRACKS_LAYER, TRACK, 1.5)]


def _colours() -> list[str]:
    """Name and colour of each class, in turn."""
    return [part for name, rgb in zip(CLASS_NAMES, PALETTE, strict=True) for part in (name, f"#{rgb.tobytes().hex()}")]


def _areas() -> dict[str, Any]:
    """Hidden below the photograph of the same ground."""
    paint = {"fill-color": ["match", ["get", "kind"], *_colours(), "#000000"], "fill-opacity": 0.5}
    return {"id": AREAS, "type": "fill", "source": AREAS, "source-layer": AREAS, "layout": {"visibility": "none"}, "paint": paint}


def _objects() -> dict[str, Any]:
    kinds = {"pole": "pole", "traffic_sign": "traffic sign", "traffic_light": "traffic light", "trunk": "vegetation"}
    colours = dict(zip(_colours()[::2], _colours()[1::2], strict=True))
    colour = ["match", ["get", "kind"], *(part for kind, name in kinds.items() for part in (kind, colours[name])), "#000000"]
    paint = {"circle-color": colour, "circle-radius": 3.5, "circle-stroke-color": "#ffffff", "circle-stroke-width": 1}
    return {"id": OBJECTS, "type": "circle", "source": OBJECTS, "source-layer": OBJECTS, "paint": paint}


def _line(name: str, source: str, layer: str, colour: str, width: float) -> dict[str, Any]:
    layout = {"line-cap": "round", "line-join": "round"}
    return {
        "id": name, "type": "line", "source": source, "source-layer": layer, "layout": layout,
        "paint": {"line-color": colour, "line-width": width},
    }  # fmt: skip
