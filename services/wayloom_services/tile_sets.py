"""Endpoints that describe a version's layers of tiles to viewers: TileJSON and WMTS."""

from typing import Annotated, Any

from fastapi import APIRouter, Depends, Query, Request, Response

from wayloom.store import maps
from wayloom.store.tables.maps import MapVersion
from wayloom.tiles.descriptions import LARGE_LAYERS, Box, tile_json, wmts_capabilities
from wayloom.tiles.formats import SERVED_LAYERS
from wayloom.tiles.style import map_style
from wayloom_services.context import Service, ServiceDep, require_key
from wayloom_services.drives import PROBLEMS
from wayloom_services.errors import ProtocolError
from wayloom_services.maps import Layer, MapId, Number
from wayloom_services.tile_answers import ASK_AGAIN

XML: dict[int | str, dict[str, Any]] = {200: {"content": {"application/xml": {}}}}
Large = Annotated[bool, Query(description="tiles of 512 pixels, of a layer of pictures of 256")]
router = APIRouter(prefix="/v1", tags=["maps"], dependencies=[Depends(require_key)], responses=PROBLEMS)


@router.get("/maps/{map_id}/tiles/{layer}/tilejson.json")
async def tile_set(map_id: MapId, layer: Layer, request: Request, service: ServiceDep, large: Large = False) -> dict[str, Any]:
    """TileJSON of a layer of the newest version; its tiles are those of that version, which do not change."""
    return await _tile_json(service, request, map_id, None, layer, large)


@router.get("/maps/{map_id}/versions/{number}/tiles/{layer}/tilejson.json")
async def tile_set_of_version(
    map_id: MapId, number: Number, layer: Layer, request: Request, service: ServiceDep, large: Large = False
) -> dict[str, Any]:
    """TileJSON of a layer of a version; 404 where the version has nothing of it."""
    return await _tile_json(service, request, map_id, number, layer, large)


@router.get("/maps/{map_id}/wmts.xml", response_class=Response, responses=XML)
async def capabilities(map_id: MapId, request: Request, service: ServiceDep) -> Response:
    """WMTS capabilities of the newest version: what QGIS and other viewers open. Its tiles are always those of the newest."""
    return await _capabilities(service, request, map_id, None)


@router.get("/maps/{map_id}/versions/{number}/wmts.xml", response_class=Response, responses=XML)
async def capabilities_of_version(map_id: MapId, number: Number, request: Request, service: ServiceDep) -> Response:
    """WMTS capabilities of a version."""
    return await _capabilities(service, request, map_id, number)


@router.get("/maps/{map_id}/style.json")
async def style(map_id: MapId, request: Request, service: ServiceDep) -> dict[str, Any]:
    """A MapLibre style of the newest version's layers, without sprites and glyphs; its tiles do not change."""
    return await _style(service, request, map_id, None)


@router.get("/maps/{map_id}/versions/{number}/style.json")
async def style_of_version(map_id: MapId, number: Number, request: Request, service: ServiceDep) -> dict[str, Any]:
    """A MapLibre style of a version's layers."""
    return await _style(service, request, map_id, number)


async def _style(service: Service, request: Request, map_id: str, number: int | None) -> dict[str, Any]:
    version = await service.read(lambda session: maps.version(session, map_id, number))
    served = {name: layer for name, layer in version.layers.items() if name in SERVED_LAYERS}
    return map_style(f"wayloom: {map_id}", served, _bounds(version), _addresses(request, version))


def _addresses(request: Request, version: MapVersion) -> str:
    """Of the tiles of all layers of a version."""
    return f"{request.base_url}v1/maps/{version.map_id}/versions/{version.version}/tiles/{{layer}}/{{z}}/{{x}}/{{y}}"


async def _tile_json(
    service: Service, request: Request, map_id: str, number: int | None, layer: str, large: bool
) -> dict[str, Any]:
    version = await service.read(lambda session: maps.version(session, map_id, number))
    if layer not in SERVED_LAYERS or layer not in version.layers:
        held = ", ".join(sorted(version.layers)) or "none"
        raise ProtocolError(404, "not-found", f"version {version.version} of map {map_id!r} has no layer {layer!r}; it has {held}")
    if large and layer not in LARGE_LAYERS:
        raise ProtocolError(404, "not-found", f"layer {layer!r} has no tiles @2x; {', '.join(LARGE_LAYERS)} have")
    return tile_json(layer, version.layers[layer], _bounds(version), _addresses(request, version).replace("{layer}", layer), large)


async def _capabilities(service: Service, request: Request, map_id: str, number: int | None) -> Response:
    version = await service.read(lambda session: maps.version(session, map_id, number))
    of = "" if number is None else f"/versions/{number}"
    addresses = f"{request.base_url}v1/maps/{map_id}{of}/tiles/{{layer}}/{{z}}/{{x}}/{{y}}"
    text = wmts_capabilities(f"wayloom: {map_id}", version.layers, _bounds(version), addresses)
    return Response(text, media_type="application/xml", headers={"Cache-Control": ASK_AGAIN})


def _bounds(version: MapVersion) -> Box | None:
    return None if version.bounds is None else (version.bounds[0], version.bounds[1], version.bounds[2], version.bounds[3])
