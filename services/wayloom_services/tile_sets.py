"""Endpoints that describe a version's layers of tiles to viewers: TileJSON and WMTS."""

from typing import Any

from fastapi import APIRouter, Depends, Request, Response

from wayloom.store import maps
from wayloom.store.tables import MapVersion
from wayloom.tiles.descriptions import Box, tile_json, wmts_capabilities
from wayloom.tiles.formats import SERVED_LAYERS
from wayloom_services.context import Service, ServiceDep, require_key
from wayloom_services.drives import PROBLEMS
from wayloom_services.errors import ProtocolError
from wayloom_services.maps import ASK_AGAIN, Layer, MapId, Number

XML: dict[int | str, dict[str, Any]] = {200: {"content": {"application/xml": {}}}}
router = APIRouter(prefix="/v1", tags=["maps"], dependencies=[Depends(require_key)], responses=PROBLEMS)


@router.get("/maps/{map_id}/tiles/{layer}/tilejson.json")
async def tile_set(map_id: MapId, layer: Layer, request: Request, service: ServiceDep) -> dict[str, Any]:
    """TileJSON of a layer of the newest version; its tiles are those of that version, which do not change."""
    return await _tile_json(service, request, map_id, None, layer)


@router.get("/maps/{map_id}/versions/{number}/tiles/{layer}/tilejson.json")
async def tile_set_of_version(map_id: MapId, number: Number, layer: Layer, request: Request, service: ServiceDep) -> dict[str, Any]:
    """TileJSON of a layer of a version; 404 where the version has nothing of it."""
    return await _tile_json(service, request, map_id, number, layer)


@router.get("/maps/{map_id}/wmts.xml", response_class=Response, responses=XML)
async def capabilities(map_id: MapId, request: Request, service: ServiceDep) -> Response:
    """WMTS capabilities of the newest version: what QGIS and other viewers open. Its tiles are always those of the newest."""
    return await _capabilities(service, request, map_id, None)


@router.get("/maps/{map_id}/versions/{number}/wmts.xml", response_class=Response, responses=XML)
async def capabilities_of_version(map_id: MapId, number: Number, request: Request, service: ServiceDep) -> Response:
    """WMTS capabilities of a version."""
    return await _capabilities(service, request, map_id, number)


async def _tile_json(service: Service, request: Request, map_id: str, number: int | None, layer: str) -> dict[str, Any]:
    version = await service.read(lambda session: maps.version(session, map_id, number))
    if layer not in SERVED_LAYERS or layer not in version.layers:
        held = ", ".join(sorted(version.layers)) or "none"
        raise ProtocolError(404, "not-found", f"version {version.version} of map {map_id!r} has no layer {layer!r}; it has {held}")
    address = f"{request.base_url}v1/maps/{map_id}/versions/{version.version}/tiles/{layer}/{{z}}/{{x}}/{{y}}"
    return tile_json(layer, version.layers[layer], _bounds(version), address)


async def _capabilities(service: Service, request: Request, map_id: str, number: int | None) -> Response:
    version = await service.read(lambda session: maps.version(session, map_id, number))
    of = "" if number is None else f"/versions/{number}"
    addresses = f"{request.base_url}v1/maps/{map_id}{of}/tiles/{{layer}}/{{z}}/{{x}}/{{y}}"
    text = wmts_capabilities(f"wayloom: {map_id}", version.layers, _bounds(version), addresses)
    return Response(text, media_type="application/xml", headers={"Cache-Control": ASK_AGAIN})


def _bounds(version: MapVersion) -> Box | None:
    return None if version.bounds is None else (version.bounds[0], version.bounds[1], version.bounds[2], version.bounds[3])
