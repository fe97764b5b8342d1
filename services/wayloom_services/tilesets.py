"""3D Tiles endpoints: the tileset of a version; its contents and the tilesets below are tiles like any other."""

import hashlib
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Path, Request, Response

from wayloom.geodesy.map_frame import MapFrame
from wayloom.stitching.layer_names import LAYERS, OVERLAYS, STATIC
from wayloom.store import maps
from wayloom.store.database import Session
from wayloom.store.tables.maps import MapVersion
from wayloom.tiles.cloud_pyramid import root_of
from wayloom.tiles.formats import tile_layer
from wayloom_services.context import Service, ServiceDep, require_key
from wayloom_services.drives import PROBLEMS
from wayloom_services.errors import ProtocolError
from wayloom_services.maps import MapId, Number
from wayloom_services.tile_answers import ASK_AGAIN, forever, is_held

TILESET: dict[int | str, dict[str, Any]] = {
    200: {"content": {"application/json": {"schema": {"type": "object"}}}},
    304: {"description": "the tileset is the one that you hold"},
}
Overlay = Annotated[str, Path(pattern=f"^({'|'.join(OVERLAYS)})$")]
router = APIRouter(prefix="/v1", tags=["maps"], dependencies=[Depends(require_key)], responses=PROBLEMS)


@router.get("/maps/{map_id}/3dtiles/tileset.json", response_class=Response, responses=TILESET)
async def tileset(map_id: MapId, request: Request, service: ServiceDep) -> Response:
    """3D Tiles 1.1 of the newest version; what it refers to is of that version, and does not change."""
    return await _tileset(service, request, map_id, None)


@router.get("/maps/{map_id}/versions/{number}/3dtiles/tileset.json", response_class=Response, responses=TILESET)
async def tileset_of_version(map_id: MapId, number: Number, request: Request, service: ServiceDep) -> Response:
    """3D Tiles 1.1 of a version: it never changes."""
    return await _tileset(service, request, map_id, number)


@router.get("/maps/{map_id}/3dtiles/{overlay}/tileset.json", response_class=Response, responses=TILESET)
async def tileset_of_overlay(map_id: MapId, overlay: Overlay, request: Request, service: ServiceDep) -> Response:
    """3D Tiles 1.1 of an overlay of the newest version: of what is parked, or of what is not confirmed yet."""
    return await _tileset(service, request, map_id, None, overlay)


@router.get("/maps/{map_id}/versions/{number}/3dtiles/{overlay}/tileset.json", response_class=Response, responses=TILESET)
async def tileset_of_overlay_of_version(
    map_id: MapId, number: Number, overlay: Overlay, request: Request, service: ServiceDep
) -> Response:
    """3D Tiles 1.1 of an overlay of a version: it never changes."""
    return await _tileset(service, request, map_id, number, overlay)


async def _tileset(service: Service, request: Request, map_id: str, number: int | None, of: str = LAYERS[STATIC]) -> Response:
    """The tileset of a layer of the map."""
    version, tops = await service.read(lambda session: _read(session, map_id, number, of))
    if not tops:
        raise ProtocolError(404, "not-found", f"version {version.version} of map {map_id!r} has no 3D tiles of {of!r}")
    up = f"../versions/{version.version}/tiles" if number is None else "../tiles"
    up = up if of == LAYERS[STATIC] else f"../{up}"
    tag = hashlib.sha256(repr((up, of, version.frame, tops)).encode()).hexdigest()
    headers = {"ETag": f'"{tag}"', "Cache-Control": ASK_AGAIN if number is None else forever(service)}
    if is_held(request.headers, tag):
        return Response(status_code=304, headers=headers)

    def made() -> bytes:
        return root_of((service.held.get(digest) for digest in tops), MapFrame(*version.frame), up, of)

    content = await service.in_thread(lambda: service.held.made(tag, made))
    return Response(content, headers=headers, media_type="application/json")


def _read(session: Session, map_id: str, number: int | None, of: str) -> tuple[MapVersion, list[str]]:
    """The version, and the digests of the coarsest tilesets of a layer of the map."""
    version, layer = maps.version(session, map_id, number), tile_layer("tileset", of)
    held = version.layers.get(layer)
    return version, [] if held is None else maps.digests_of_zoom(session, map_id, version.version, layer, held["min_zoom"])
