"""Vector tiles of markings and kerbs: the tiles that changed regions can change, and no others.

Each tile of each zoom is drawn from the markings of the regions around it: there are few of them. So a pyramid that was updated is
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
from wayloom.tiles.formats import KERBS, MARKING_PROPERTIES, MARKINGS, TILE_FORMATS, Tile
from wayloom.tiles.grid import EQUATOR_M, TileAddress, row_by_row, tile_bounds
from wayloom.tiles.ground_tiles import tiles_of_region
from wayloom.tiles.mvt import BUFFER, EXTENT, LonLatTrack, tiles_of_track
from wayloom.tiles.settings import TileSettings

KERB: Final = "kerb"
HELD_REGIONS: Final = 256
Drawn = tuple[str, list[tuple[int, int]], dict[str, protobuf.Value]]
"""Layer, line in tile units, properties."""


class MarkingSource(Protocol):
    """What an update reads of the map's markings, as they are after the change."""

    def features(self, key: RegionKey) -> Sequence[Mapping[str, Any]]:
        """GeoJSON features of a region, always in the same order."""


def touched_markings(
    changed: Collection[RegionKey], frame: MapFrame, settings: TileSettings
) -> dict[tuple[str, int], frozenset[TileAddress]]:
    """The scope: for each zoom the tiles that a change of the markings of these regions may change."""
    return {
        (MARKINGS, zoom): frozenset(itertools.chain(*(tiles_of_region(key, frame, zoom, _around_m(zoom)) for key in changed)))
        for zoom in range(settings.markings_from_zoom, settings.markings_zoom + 1)
    }


def marking_tiles(changed: Collection[RegionKey], source: MarkingSource, frame: MapFrame, settings: TileSettings) -> Iterator[Tile]:
    """Every tile of the scope that shows something; one that does not come has nothing to show any more."""
    drawn = lru_cache(HELD_REGIONS)(lambda key, zoom: _drawn(source.features(key), zoom))
    for (_, zoom), addresses in touched_markings(changed, frame, settings).items():
        for address in sorted(addresses, key=row_by_row):
            near = sorted(regions_of_box(tile_bounds(address), frame, _around_m(zoom)))
            found = [one for key in near for one in drawn(key, zoom).get(address, ())]
            if found:
                yield Tile(MARKINGS, *address, TILE_FORMATS["mvt"].media_type, _encoded(found))


def _around_m(zoom: int) -> float:
    """How far beyond a region tiles may show what is its own, their buffer included."""
    return AROUND_M + EQUATOR_M / (1 << zoom) * BUFFER / EXTENT


def _drawn(features: Sequence[Mapping[str, Any]], zoom: int) -> dict[TileAddress, list[Drawn]]:
    """The lines of features, areas by their outlines, clipped to every tile that they touch."""
    out: dict[TileAddress, list[Drawn]] = {}
    for feature in features:
        told = {name: feature["properties"][name] for name in MARKING_PROPERTIES if name in feature["properties"]}
        layer = KERBS if told["kind"] == KERB else MARKINGS
        for places in lines_of(feature["geometry"]):
            track = LonLatTrack("", np.array(places, np.float64)[:, :2])
            for address, pieces in tiles_of_track(track, zoom).items():
                out.setdefault(address, []).extend((layer, piece, told) for piece in pieces)
    return out


def _encoded(found: Sequence[Drawn]) -> bytes:
    out = b""
    for name in (MARKINGS, KERBS):
        features = [(protobuf.line(line), told) for layer, line, told in found if layer == name]
        out += protobuf.layer(name, EXTENT, protobuf.LINE, features) if features else b""
    return out
