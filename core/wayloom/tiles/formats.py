"""Tile formats, and a tile as bytes with its address."""

from dataclasses import dataclass
from typing import Final

from wayloom.tiles.grid import TileAddress


@dataclass(frozen=True, slots=True)
class TileFormat:
    """A tile format.

    layer : the name under which such tiles are addressed; media_type for HTTP; suffix for files
    served : whether clients get such tiles; the others are what the next update of the pyramid starts from
    """

    layer: str
    media_type: str
    suffix: str
    served: bool = True


TILE_FORMATS: Final = {
    "png": TileFormat("semantic", "image/png", ".png"),
    "mvt": TileFormat("features", "application/vnd.mapbox-vector-tile", ".mvt"),
    "points": TileFormat("points", "application/vnd.wayloom.points", ".wlp"),
    "counts": TileFormat("counts", "application/vnd.wayloom.counts", ".wlc", served=False),
}
SERVED_LAYERS: Final = tuple(form.layer for form in TILE_FORMATS.values() if form.served)


@dataclass(frozen=True, slots=True)
class Tile:
    """One tile: layer, address, media type and bytes. Equal maps give equal bytes."""

    layer: str
    z: int
    x: int
    y: int
    media_type: str
    data: bytes


def tile_of(name: str, address: TileAddress, data: bytes) -> Tile:
    """The tile of the format of this name."""
    form = TILE_FORMATS[name]
    return Tile(form.layer, *address, form.media_type, data)
