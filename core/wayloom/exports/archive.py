"""PMTiles of a map: its vector tiles in one archive, or one of its raster layers."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from wayloom.errors import InputError
from wayloom.exports.pyramids import MapPyramid
from wayloom.exports.source import MapSource
from wayloom.files.pmtiles import Address, write_pmtiles
from wayloom.geodesy.antimeridian import Box
from wayloom.tiles.descriptions import tile_json
from wayloom.tiles.feature_layers import FEATURE_LAYERS
from wayloom.tiles.formats import TILE_FORMATS, Tile
from wayloom.tiles.rasters import RASTER_LAYERS
from wayloom.tiles.settings import TileSettings

VECTOR: Final = "vector"
PICTURES: Final = TILE_FORMATS["png"].layer
MEDIA_TYPES: Final = (
    {VECTOR: TILE_FORMATS["mvt"].media_type, PICTURES: TILE_FORMATS["png"].media_type}
    | {name: layer.media_type for name, layer in RASTER_LAYERS.items()}
)  # fmt: skip
"""What an archive can hold, by name."""
WHOLE_WORLD: Final = (-180.0, 180.0)


def write_archive(path: Path, source: MapSource, box: Box | None, layer: str, provenance: Mapping[str, Any]) -> int:
    """Write one archive of the tiles of `MEDIA_TYPES`; how many tiles. Raises InputError, OSError."""
    if layer not in MEDIA_TYPES:
        raise InputError(f"{layer} is no layer of tiles", file=path, remedy=f"known are {', '.join(MEDIA_TYPES)}")
    if source.frame is None:
        raise InputError("is of places on Earth, and this drive has none", file=path, remedy="process it with --gnss")
    usual = TileSettings()
    zooms = {f"{name}_zoom": min(getattr(usual, f"{name}_zoom"), usual.features_max_zoom) for name in FEATURE_LAYERS}
    settings = usual.model_copy(update=zooms)
    pyramid = MapPyramid(source, source.frame, box, settings)
    west, south, east, north = pyramid.bounds()
    west, east = (west, east) if east <= WHOLE_WORLD[1] else WHOLE_WORLD

    def about(min_zoom: int, max_zoom: int) -> Mapping[str, Any]:
        return {**_described(layer, min_zoom, max_zoom), "provenance": dict(provenance)}

    return write_pmtiles(path, _tiles(layer, pyramid), MEDIA_TYPES[layer], (west, south, east, north), about)


def _tiles(layer: str, pyramid: MapPyramid) -> Iterator[tuple[Address, bytes]]:
    """The archive's tiles. Layers of two vector tiles of one address are those of the joined bytes."""
    if layer == VECTOR:
        yield from _of_layer(TILE_FORMATS["mvt"].layer, pyramid.tiles())
        yield from (((tile.z, tile.x, tile.y), tile.data) for tile in pyramid.feature_tiles())
    elif layer == PICTURES:
        yield from _of_layer(layer, pyramid.tiles())
    else:
        yield from _of_layer(layer, pyramid.ground_tiles())


def _of_layer(layer: str, tiles: Iterator[Tile]) -> Iterator[tuple[Address, bytes]]:
    return (((tile.z, tile.x, tile.y), tile.data) for tile in tiles if tile.layer == layer)


def _described(layer: str, min_zoom: int, max_zoom: int) -> dict[str, Any]:
    """Name, layers of vector tiles with their fields, and the encoding of heights, as TileJSON has them."""
    zooms = {"min_zoom": min_zoom, "max_zoom": max_zoom, "media_type": MEDIA_TYPES[layer]}
    names = (TILE_FORMATS["mvt"].layer, *FEATURE_LAYERS) if layer == VECTOR else (layer,)
    told = [tile_json(name, zooms, None, "") for name in names]
    found: dict[str, Any] = {"name": f"wayloom {layer}", "format": "pbf" if layer == VECTOR else told[0]["format"]}
    if layer == VECTOR:
        found["vector_layers"] = [one for description in told for one in description["vector_layers"]]
    return found | {name: told[0][name] for name in ("encoding", "tileSize") if name in told[0]}
