"""Descriptions of a map version's layers of tiles: TileJSON 3.0.0, and the capabilities of a WMTS 1.0.0 (OGC 07-057r7)."""

from collections.abc import Mapping
from typing import Any, Final
from xml.sax.saxutils import escape, quoteattr

from wayloom.stitching.layer_names import OVERLAYS
from wayloom.tiles.feature_layers import FEATURE_LAYERS
from wayloom.tiles.formats import OVERLAY_FORMATS, TILE_FORMATS, tile_layer
from wayloom.tiles.grid import EQUATOR_M, MAX_LATITUDE_DEG, MAX_ZOOM, TILE_PX
from wayloom.tiles.mvt import CELLS_LAYER, TRACKS_LAYER
from wayloom.tiles.rasters import HEIGHT, RASTER_LAYERS, RASTER_PX

Box = tuple[float, float, float, float]
WORLD: Final = (-180.0, -MAX_LATITUDE_DEG, 180.0, MAX_LATITUDE_DEG)
WMTS_PIXEL_M: Final = 0.00028
"""Of the standard's scale denominators."""
SUFFIXES: Final = (
    {form.layer: form.suffix for form in TILE_FORMATS.values() if form.served}
    | {tile_layer(name, of): TILE_FORMATS[name].suffix for of in OVERLAYS for name in OVERLAY_FORMATS}
    | {layer.name: layer.suffix for layer in RASTER_LAYERS.values()}
    | dict.fromkeys(FEATURE_LAYERS, TILE_FORMATS["mvt"].suffix)
)
"""The file ending of each layer."""
HEAD: Final = (
    '<?xml version="1.0" encoding="UTF-8"?>\n<Capabilities xmlns="http://www.opengis.net/wmts/1.0" '
    'xmlns:ows="http://www.opengis.net/ows/1.1" xmlns:xlink="http://www.w3.org/1999/xlink" version="1.0.0">'
)


LARGE_LAYERS: Final = tuple(name for name, suffix in SUFFIXES.items() if suffix == ".png" and name not in RASTER_LAYERS)
"""Layers of pictures of 256 pixels, which also have tiles of 512: `@2x`."""


def edge_px(layer: str) -> int:
    """Pixels along the edge of a layer's tiles."""
    return RASTER_PX if layer in RASTER_LAYERS else TILE_PX


def tile_json(name: str, layer: Mapping[str, Any], bounds: Box | None, address: str, large: bool = False) -> dict[str, Any]:
    """TileJSON of a layer.

    layer   : of `MapVersion.layers`; bounds of the version, None without a place
    address : of its tiles, without the ending, with {z}, {x} and {y}
    large   : of its tiles of 512 pixels; the layer is one of LARGE_LAYERS
    Beside the standard's: `tileSize` in pixels, and `encoding` of heights, as MapLibre names them.
    """
    west, south, east, north = bounds or WORLD
    found: dict[str, Any] = {
        "tilejson": "3.0.0",
        "name": name,
        "scheme": "xyz",
        "tiles": [address + ("@2x" if large else "") + SUFFIXES[name]],
        "minzoom": max(layer["min_zoom"] - large, 0),
        "maxzoom": max(layer["max_zoom"] - large, 0),
        "bounds": [*((west, south, east, north) if west <= east else (WORLD[0], south, WORLD[2], north))],
    }
    if layer["media_type"].startswith("image/"):
        found |= {"tileSize": edge_px(name) << large, "format": layer["media_type"].removeprefix("image/")}
    if name == HEIGHT:
        found["encoding"] = "terrarium"
    if name == TILE_FORMATS["mvt"].layer:
        found["vector_layers"] = [{"id": one, "fields": {}} for one in (CELLS_LAYER, TRACKS_LAYER)]
    if name in FEATURE_LAYERS:
        found["vector_layers"] = FEATURE_LAYERS[name].vector_layers()
    return found


def wmts_capabilities(title: str, layers: Mapping[str, Mapping[str, Any]], bounds: Box | None, addresses: str) -> str:
    """The capabilities document of a version's layers of pictures, for its RESTful addresses.

    addresses : of the tiles of all layers, without the ending, with {layer}, {z}, {x} and {y}
    """
    pictures = {name: layer for name, layer in layers.items() if layer["media_type"].startswith("image/")}
    said = "".join(_wmts_layer(name, layer, bounds, addresses) for name, layer in sorted(pictures.items()))
    matrices = "".join(_matrix_set(edge) for edge in sorted({edge_px(name) for name in pictures}))
    service = "<ows:ServiceType>OGC WMTS</ows:ServiceType><ows:ServiceTypeVersion>1.0.0</ows:ServiceTypeVersion>"
    about = f"<ows:ServiceIdentification><ows:Title>{escape(title)}</ows:Title>{service}</ows:ServiceIdentification>"
    return f"{HEAD}{about}<Contents>{said}{matrices}</Contents></Capabilities>\n"


def _wmts_layer(name: str, layer: Mapping[str, Any], bounds: Box | None, addresses: str) -> str:
    west, south, east, north = bounds or WORLD
    west, east = (west, east) if west <= east else (WORLD[0], WORLD[2])
    template = (addresses + SUFFIXES[name]).format(layer=name, z="{TileMatrix}", x="{TileCol}", y="{TileRow}")
    media = escape(layer["media_type"])
    return (
        f"<Layer><ows:Title>{escape(name)}</ows:Title><ows:WGS84BoundingBox><ows:LowerCorner>{west} {south}</ows:LowerCorner>"
        f"<ows:UpperCorner>{east} {north}</ows:UpperCorner></ows:WGS84BoundingBox><ows:Identifier>{escape(name)}</ows:Identifier>"
        '<Style isDefault="true"><ows:Identifier>default</ows:Identifier></Style>'
        f"<Format>{media}</Format><TileMatrixSetLink><TileMatrixSet>{_set_name(edge_px(name))}</TileMatrixSet>"
        f"<TileMatrixSetLimits>{_limits(layer)}</TileMatrixSetLimits></TileMatrixSetLink>"
        f'<ResourceURL format="{media}" resourceType="tile" template={quoteattr(template)}/></Layer>'
    )


def _limits(layer: Mapping[str, Any]) -> str:
    """The zooms that the layer has; rows and columns are left whole."""
    return "".join(
        f"<TileMatrixLimits><TileMatrix>{z}</TileMatrix><MinTileRow>0</MinTileRow><MaxTileRow>{(1 << z) - 1}</MaxTileRow>"
        f"<MinTileCol>0</MinTileCol><MaxTileCol>{(1 << z) - 1}</MaxTileCol></TileMatrixLimits>"
        for z in range(layer["min_zoom"], layer["max_zoom"] + 1)
    )


def _set_name(edge: int) -> str:
    return f"WebMercator{edge}"


def _matrix_set(edge: int) -> str:
    half = EQUATOR_M / 2.0
    matrices = "".join(
        f"<TileMatrix><ows:Identifier>{z}</ows:Identifier><ScaleDenominator>{EQUATOR_M / (edge << z) / WMTS_PIXEL_M!r}"
        f"</ScaleDenominator><TopLeftCorner>{-half!r} {half!r}</TopLeftCorner><TileWidth>{edge}</TileWidth>"
        f"<TileHeight>{edge}</TileHeight><MatrixWidth>{1 << z}</MatrixWidth><MatrixHeight>{1 << z}</MatrixHeight></TileMatrix>"
        for z in range(MAX_ZOOM + 1)
    )
    crs = "<ows:SupportedCRS>urn:ogc:def:crs:EPSG::3857</ows:SupportedCRS>"
    return f"<TileMatrixSet><ows:Identifier>{_set_name(edge)}</ows:Identifier>{crs}{matrices}</TileMatrixSet>"
