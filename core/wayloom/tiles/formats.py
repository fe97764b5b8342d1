"""Tile formats, the layers in which they are cut, and a tile as bytes with its address.

The static layer of the map is cut in every format. Each overlay (`OVERLAYS`) has pictures, under its own name, and points, 3D
tiles and counts, under names that begin with it: `parked`, `parked-points`, `parked-cloud`, `parked-tilesets`, `parked-counts`.
The ground has raster layers (`rasters`), features have vector tiles (`feature_layers`).
"""

from dataclasses import dataclass
from typing import Final

from wayloom.stitching.layer_names import LAYERS, OVERLAYS, STATIC
from wayloom.tiles.feature_layers import FEATURE_LAYERS
from wayloom.tiles.grid import TileAddress
from wayloom.tiles.rasters import RASTER_LAYERS


@dataclass(frozen=True, slots=True)
class TileFormat:
    """A tile format.

    layer : the name under which such tiles of the static layer are addressed; media_type for HTTP; suffix for files
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
    "glb": TileFormat("cloud", "model/gltf-binary", ".glb"),
    "tileset": TileFormat("tilesets", "application/json", ".json"),
    "counts": TileFormat("counts", "application/vnd.wayloom.counts", ".wlc", served=False),
}
OVERLAY_FORMATS: Final = ("png", "points", "glb", "tileset", "counts")
"""Those of an overlay: its vector tiles would repeat the tracks."""


def tile_layer(name: str, of: str = LAYERS[STATIC]) -> str:
    """Under which name tiles of a format are addressed that show a layer of the map."""
    form = TILE_FORMATS[name]
    if of == LAYERS[STATIC]:
        return form.layer
    return of if name == "png" else f"{of}-{form.layer}"


STATIC_TILES: Final = tuple(form.layer for form in TILE_FORMATS.values() if form.served)
"""Layers of tiles that clients get of the static layer of the map, and, in `SERVED_LAYERS`, of all."""
SERVED_LAYERS: Final = (
    *STATIC_TILES,
    *(tile_layer(name, of) for of in OVERLAYS for name in OVERLAY_FORMATS if TILE_FORMATS[name].served),
    *RASTER_LAYERS,
    *FEATURE_LAYERS,
)


@dataclass(frozen=True, slots=True)
class Tile:
    """One tile: layer, address, media type and bytes. Equal maps give equal bytes."""

    layer: str
    z: int
    x: int
    y: int
    media_type: str
    data: bytes


def tile_of(name: str, address: TileAddress, data: bytes, of: str = LAYERS[STATIC]) -> Tile:
    """The tile of the format of this name that shows a layer of the map."""
    return Tile(tile_layer(name, of), *address, TILE_FORMATS[name].media_type, data)
