"""Vector tiles of markings, areas and objects: the tiles that changed regions can change, and no others.

Each tile of each zoom is drawn from the features of the regions around it: there are few of them. So a pyramid that was updated is
equal to one built at once, byte for byte.
"""

import itertools
from collections.abc import Collection, Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Any, Final, Protocol

import numpy as np

from wayloom.geodesy.map_frame import MapFrame
from wayloom.stitching.marking_files import AROUND_M, lines_of
from wayloom.stitching.region_grid import RegionKey, regions_of_box
from wayloom.tiles import protobuf
from wayloom.tiles.feature_layers import FEATURE_LAYERS, FeatureLayer
from wayloom.tiles.formats import TILE_FORMATS, Tile
from wayloom.tiles.grid import EQUATOR_M, TileAddress, row_by_row, tile_bounds
from wayloom.tiles.ground_tiles import tiles_of_region
from wayloom.tiles.mvt import BUFFER, EXTENT, LonLatTrack, tiles_of_track
from wayloom.tiles.polygons import tiles_of_point, tiles_of_polygon
from wayloom.tiles.settings import TileSettings

HELD_REGIONS: Final = 256
Drawn = tuple[str, bytes, dict[str, protobuf.Value]]
"""Layer within the tile, geometry, properties."""
Scope = dict[tuple[str, int], frozenset[TileAddress]]
"""For each layer and zoom the tiles that a change may change."""


class FeatureSource(Protocol):
    """What an update reads of the map's features, as they are after the change."""

    def features(self, of: str, key: RegionKey) -> Sequence[Mapping[str, Any]]:
        """GeoJSON features of a layer of FEATURE_LAYERS in a region, always in the same order."""


def touched_features(changed: Mapping[str, Collection[RegionKey]], frame: MapFrame, settings: TileSettings) -> Scope:
    """The scope of a change of the features of these regions, by layer."""
    return {
        (name, zoom): frozenset(itertools.chain(*(tiles_of_region(key, frame, zoom, _around_m(zoom)) for key in changed[name])))
        for name, layer in FEATURE_LAYERS.items()
        for zoom in layer.zooms(settings)
    }


def feature_tiles(
    changed: Mapping[str, Collection[RegionKey]], source: FeatureSource, frame: MapFrame, settings: TileSettings
) -> Iterator[Tile]:
    """Every tile of the scope that shows something; one that does not come has nothing to show any more."""

    @lru_cache(HELD_REGIONS)
    def drawn(name: str, key: RegionKey, zoom: int) -> dict[TileAddress, list[Drawn]]:
        return _drawn(source.features(name, key), FEATURE_LAYERS[name], zoom)

    for (name, zoom), addresses in touched_features(changed, frame, settings).items():
        for address in sorted(addresses, key=row_by_row):
            near = sorted(regions_of_box(tile_bounds(address), frame, _around_m(zoom)))
            found = [one for key in near for one in drawn(name, key, zoom).get(address, ())]
            if found:
                yield Tile(name, *address, TILE_FORMATS["mvt"].media_type, _encoded(found, FEATURE_LAYERS[name]))


def _around_m(zoom: int) -> float:
    """How far beyond a region tiles may show what is its own, their buffer included."""
    return AROUND_M + EQUATOR_M / (1 << zoom) * BUFFER / EXTENT


def _drawn(features: Sequence[Mapping[str, Any]], layer: FeatureLayer, zoom: int) -> dict[TileAddress, list[Drawn]]:
    """The geometries of features, clipped to every tile that they touch."""
    out: dict[TileAddress, list[Drawn]] = {}
    for feature in features:
        told = {name: value for name in layer.properties if (value := feature["properties"].get(name)) is not None}
        part = layer.part(told["kind"])
        for address, geometry in _geometries(feature["geometry"], layer.drawn_as, zoom):
            out.setdefault(address, []).append((part, geometry, told))
    return out


def _geometries(geometry: Mapping[str, Any], drawn_as: int, zoom: int) -> Iterator[tuple[TileAddress, bytes]]:
    """In every tile: areas whole or, where they are drawn as lines, by their outlines."""
    lines = [np.array(places, np.float64)[:, :2] for places in lines_of(geometry)]
    if drawn_as == protobuf.POINT:
        yield from ((address, protobuf.point(*place)) for address, place in tiles_of_point(lines[0], zoom).items())
    elif drawn_as == protobuf.POLYGON:
        yield from ((address, protobuf.polygon(rings)) for address, rings in tiles_of_polygon(lines, zoom).items())
    else:
        for line in lines:
            for address, pieces in tiles_of_track(LonLatTrack("", line), zoom).items():
                yield from ((address, protobuf.line(piece)) for piece in pieces)


def _encoded(found: Sequence[Drawn], layer: FeatureLayer) -> bytes:
    out = b""
    for name in layer.parts:
        features = [(geometry, told) for part, geometry, told in found if part == name]
        out += protobuf.layer(name, EXTENT, layer.drawn_as, features) if features else b""
    return out
