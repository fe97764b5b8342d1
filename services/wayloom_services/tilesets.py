"""3D Tiles endpoints: the tileset of a version; its contents and the tilesets below are tiles like any other."""

import hashlib
from typing import Any

from fastapi import APIRouter, Depends, Request, Response

from wayloom.geodesy.map_frame import MapFrame
from wayloom.store import maps
from wayloom.store.database import Session
from wayloom.store.tables import MapVersion
from wayloom.tiles.cloud_pyramid import root_of
from wayloom.tiles.formats import TILE_FORMATS
from wayloom_services.context import Service, ServiceDep, require_key
from wayloom_services.drives import PROBLEMS
from wayloom_services.errors import ProtocolError
from wayloom_services.maps import MapId, Number
from wayloom_services.tile_answers import ASK_AGAIN, forever, is_held

TILESET: dict[int | str, dict[str, Any]] = {
    200: {"content": {"application/json": {"schema": {"type": "object"}}}},
    304: {"description": "the tileset is the one that you hold"},
}
router = APIRouter(prefix="/v1", tags=["maps"], dependencies=[Depends(require_key)], responses=PROBLEMS)


@router.get("/maps/{map_id}/3dtiles/tileset.json", response_class=Response, responses=TILESET)
async def tileset(map_id: MapId, request: Request, service: ServiceDep) -> Response:
    """3D Tiles 1.1 of the newest version; what it refers to is of that version, and does not change."""
    return await _tileset(service, request, map_id, None)


@router.get("/maps/{map_id}/versions/{number}/3dtiles/tileset.json", response_class=Response, responses=TILESET)
async def tileset_of_version(map_id: MapId, number: Number, request: Request, service: ServiceDep) -> Response:
    """3D Tiles 1.1 of a version: it never changes."""
    return await _tileset(service, request, map_id, number)


async def _tileset(service: Service, request: Request, map_id: str, number: int | None) -> Response:
    version, tops = await service.read(lambda session: _read(session, map_id, number))
    if not tops:
        raise ProtocolError(404, "not-found", f"version {version.version} of map {map_id!r} has no 3D tiles")
    up = f"../versions/{version.version}/tiles" if number is None else "../tiles"
    tag = hashlib.sha256(repr((up, version.frame, tops)).encode()).hexdigest()
    headers = {"ETag": f'"{tag}"', "Cache-Control": ASK_AGAIN if number is None else forever(service)}
    if is_held(request.headers, tag):
        return Response(status_code=304, headers=headers)

    def made() -> bytes:
        return root_of((service.held.get(digest) for digest in tops), MapFrame(*version.frame), up)

    content = await service.in_thread(lambda: service.held.made(tag, made))
    return Response(content, headers=headers, media_type="application/json")


def _read(session: Session, map_id: str, number: int | None) -> tuple[MapVersion, list[str]]:
    """The version, and the digests of its coarsest tilesets."""
    version, layer = maps.version(session, map_id, number), TILE_FORMATS["tileset"].layer
    held = version.layers.get(layer)
    return version, [] if held is None else maps.digests_of_zoom(session, map_id, version.version, layer, held["min_zoom"])
