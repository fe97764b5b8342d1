"""Map endpoints: versions, tiles, coverage and submaps."""

from dataclasses import dataclass
from datetime import datetime
from typing import Annotated, Any, Literal

import numpy as np
from fastapi import APIRouter, Depends, Path, Query, Request, Response
from pydantic import AwareDatetime

from wayloom.store import map_versions, maps
from wayloom.store.database import Session
from wayloom.tiles.coverage import HALF_WIDTH_M, covered_areas, visited_squares
from wayloom.tiles.formats import TILE_FORMATS
from wayloom.tiles.grid import TileAddress, tile_bounds
from wayloom_services.context import ServiceDep, require_key
from wayloom_services.drives import PROBLEMS
from wayloom_services.errors import ProtocolError
from wayloom_services.schemas.maps import (
    ChangedTile,
    ChangeList,
    Feature,
    FeatureCollection,
    MapList,
    MapOut,
    SubmapList,
    TileName,
    VersionList,
    VersionOut,
)
from wayloom_services.submap_points import submap_bytes
from wayloom_services.tile_answers import TileAsked, forever, tile_answer
from wayloom_services.views import submap_out, version_out

MapId = Annotated[str, Path(pattern="^[a-z0-9][a-z0-9-]{0,62}$")]
Number = Annotated[int, Path(ge=1, le=2**31 - 1)]
Layer = Annotated[str, Path(pattern="^[a-z0-9][a-z0-9_-]{0,31}$")]
Zoom = Annotated[int, Path(ge=0, le=24)]
Coordinate = Annotated[int, Path(ge=0, lt=2**24)]
Extension = Annotated[str, Path(pattern="^[a-z0-9]{1,8}$")]
BBox = Annotated[
    str | None, Query(description="west,south,east,north in degrees; west > east: across the antimeridian", max_length=120)
]
SINCE = "RFC 3339 time; things that the first drive noticed then or later: that saw through what has gone, that saw what is new"
COVERAGE_ZOOM = 17
COVERAGE_OF = (
    "areas along the streets; squares of the tile grid: of zoom 17, or of the next coarser that has tiles; or squares of 25 m "
    "along the drives, with how many drives came and when the last one did"
)

router = APIRouter(prefix="/v1", tags=["maps"], dependencies=[Depends(require_key)], responses=PROBLEMS)


@router.get("/maps")
async def all_maps(service: ServiceDep) -> MapList:
    """Every map."""
    found = await service.read(maps.all_maps)
    return MapList(maps=[MapOut(id=row.id, version=row.version, created_at=row.created_at) for row in found])


@router.get("/maps/{map_id}")
async def newest(map_id: MapId, service: ServiceDep) -> VersionOut:
    """The newest version; 404 until something is published."""
    return await service.read(lambda session: version_out(session, maps.version(session, map_id)))


@router.get("/maps/{map_id}/versions")
async def versions(map_id: MapId, service: ServiceDep) -> VersionList:
    """The versions that are kept, newest first."""
    return VersionList(
        versions=await service.read(lambda session: [version_out(session, row) for row in maps.versions(session, map_id)])
    )


@router.get("/maps/{map_id}/versions/{number}")
async def version(map_id: MapId, number: Number, service: ServiceDep) -> VersionOut:
    """One version."""
    return await service.read(lambda session: version_out(session, maps.version(session, map_id, number)))


@router.get("/maps/{map_id}/changes")
async def changed_things(
    map_id: MapId,
    service: ServiceDep,
    bbox: BBox = None,
    since: Annotated[AwareDatetime | None, Query(description=SINCE)] = None,
    until: Annotated[AwareDatetime | None, Query(description="likewise; then or earlier")] = None,
) -> FeatureCollection:
    """The things that have gone and those that are new in the newest version, with the drives that are the evidence."""
    box = None if bbox is None else box_of_query(bbox)

    def read(session: Session) -> list[dict[str, Any]]:
        maps.version(session, map_id)
        return map_versions.changed_things(session, map_id)

    found = [Feature(**feature) for feature in await service.read(read)]
    return FeatureCollection(features=[one for one in found if _lies_in(one, box) and _is_within(one, since, until)])


@router.get("/maps/{map_id}/versions/{number}/changes")
async def changes(map_id: MapId, number: Number, service: ServiceDep) -> ChangeList:
    """The tiles in which a version differs from the one before: those to fetch anew, and those that show nothing any more; and the
    things that it lists as gone or new and the one before did not, and those that it lists no more."""

    def read(session: Session) -> ChangeList:
        maps.version(session, map_id, number)
        new, gone = map_versions.changes(session, map_id, number)
        changed = [ChangedTile(layer=row.layer, z=row.z, x=row.x, y=row.y, digest=row.digest, bytes=row.size) for row in new]
        names = [TileName(layer=row.layer, z=row.z, x=row.x, y=row.y) for row in gone]
        things, withdrawn = map_versions.things_of_version(session, map_id, number)
        return ChangeList(changed=changed, gone=names, things=_features(things), withdrawn_things=_features(withdrawn))

    return await service.read(read)


@router.get("/maps/{map_id}/coverage")
async def coverage(
    map_id: MapId,
    service: ServiceDep,
    of: Annotated[Literal["streets", "tiles", "visits"], Query(description=COVERAGE_OF)] = "streets",
    version: Annotated[int | None, Query(ge=1, le=2**31 - 1, description="of the map; default the newest")] = None,
) -> FeatureCollection:
    """Where a version is: areas along the streets that its drives took, the squares of its tiles, or how often and when its drives
    came by; ways as they lie today."""
    if of == "visits":
        visits = await service.read(lambda session: maps.visits(session, map_id, version))
        rows = ((drive, at_s, np.array(way, np.float64)) for drive, at_s, way in visits)
        squares = await service.in_thread(lambda: visited_squares(rows))
        return FeatureCollection(features=[_visited(*square) for square in squares])
    if of == "streets":
        ways = await service.read(lambda session: maps.tracks(session, map_id, version))
        areas = await service.in_thread(lambda: list(covered_areas(np.array(way, np.float64) for way in ways)))
        polygons = [{"type": "Polygon", "coordinates": rings} for rings in areas]
        return FeatureCollection(features=[Feature(geometry=one, properties={"beside_m": HALF_WIDTH_M}) for one in polygons])
    zoom, addresses = await service.read(lambda session: maps.coverage(session, map_id, COVERAGE_ZOOM, version))
    return FeatureCollection(
        features=[Feature(geometry=_square(zoom, x, y), properties={"z": zoom, "x": x, "y": y}) for x, y in addresses]
    )


@router.get("/maps/{map_id}/submaps")
async def submaps(
    map_id: MapId,
    service: ServiceDep,
    bbox: BBox = None,
) -> SubmapList:
    """The submaps of the map, or those that touch the box."""
    box = None if bbox is None else box_of_query(bbox)
    return SubmapList(submaps=[submap_out(row) for row in await service.read(lambda session: maps.submaps(session, map_id, box))])


@router.get("/submaps/{digest}", response_class=Response, responses={200: {"content": {"application/octet-stream": {}}}})
async def submap(digest: Annotated[str, Path(pattern="^[0-9a-f]{64}$")], service: ServiceDep) -> Response:
    """A submap's points, in its own frame; the format is in docs/formats.md."""
    content = await submap_bytes(service, digest)
    headers = {"ETag": f'"{digest}"', "Cache-Control": forever(service)}
    return Response(content, headers=headers, media_type="application/octet-stream")


TILE_TYPES = sorted({form.media_type for form in TILE_FORMATS.values() if form.served} | {"image/webp"})
TILE_ANSWERS: dict[int | str, dict[str, Any]] = {
    200: {"content": {name: {} for name in TILE_TYPES}},
    204: {"description": "nothing is mapped there"},
    304: {"description": "the tile is the one that you hold"},
}


@dataclass(frozen=True, slots=True)
class TilePath:
    """Address of a tile in a request's path: layer, zoom, column, row, file extension."""

    layer: Layer
    z: Zoom
    x: Coordinate
    y: Coordinate
    ext: Extension


TilePathDep = Annotated[TilePath, Depends()]


@router.get("/maps/{map_id}/tiles/{layer}/{z}/{x}/{y}@2x.{ext}", response_class=Response, responses=TILE_ANSWERS)
async def large_tile(map_id: MapId, path: TilePathDep, request: Request, service: ServiceDep) -> Response:
    """A picture of 512 pixels of a layer whose tiles have 256, of the newest version: the four tiles of the next finer zoom."""
    return await tile_answer(service, request.headers, _asked(map_id, None, path, large=True))


@router.get("/maps/{map_id}/versions/{number}/tiles/{layer}/{z}/{x}/{y}@2x.{ext}", response_class=Response, responses=TILE_ANSWERS)
async def large_tile_of_version(
    map_id: MapId, number: Number, path: TilePathDep, request: Request, service: ServiceDep
) -> Response:
    """A picture of 512 pixels of a layer whose tiles have 256, of a given version: it never changes."""
    return await tile_answer(service, request.headers, _asked(map_id, number, path, large=True))


@router.get("/maps/{map_id}/tiles/{layer}/{z}/{x}/{y}.{ext}", response_class=Response, responses=TILE_ANSWERS)
async def tile(map_id: MapId, path: TilePathDep, request: Request, service: ServiceDep) -> Response:
    """A tile of the newest version. Its ETag is its content's hash: ask again with If-None-Match."""
    return await tile_answer(service, request.headers, _asked(map_id, None, path))


@router.get("/maps/{map_id}/versions/{number}/tiles/{layer}/{z}/{x}/{y}.{ext}", response_class=Response, responses=TILE_ANSWERS)
async def tile_of_version(map_id: MapId, number: Number, path: TilePathDep, request: Request, service: ServiceDep) -> Response:
    """A tile of a given version: it never changes."""
    return await tile_answer(service, request.headers, _asked(map_id, number, path))


def _asked(map_id: str, number: int | None, path: TilePath, large: bool = False) -> TileAsked:
    return TileAsked(map_id, number, path.layer, path.z, path.x, path.y, large)


def box_of_query(text: str) -> maps.Box:
    """West, south, east, north; across the antimeridian east is over 180. Raises ProtocolError."""
    try:
        west, south, east, north = (float(part) for part in text.split(","))
    except ValueError:
        raise ProtocolError(400, "bad-request", "bbox is west,south,east,north in degrees") from None
    if not (abs(west) <= 180 and abs(east) <= 180 and -90 <= south <= north <= 90):
        raise ProtocolError(400, "bad-request", "bbox: west and east within 180 degrees, south <= north within 90")
    return west, south, east if west <= east else east + 360.0, north


def _features(found: list[dict[str, Any]]) -> FeatureCollection:
    return FeatureCollection(features=[Feature(**feature) for feature in found])


def _lies_in(feature: Feature, box: maps.Box | None) -> bool:
    if box is None or feature.geometry is None:
        return box is None
    west, south, east, north = box
    lon, lat = feature.geometry["coordinates"][:2]
    return bool(south <= lat <= north and (west <= lon <= east or west <= lon + 360.0 <= east))


def _is_within(feature: Feature, since: AwareDatetime | None, until: AwareDatetime | None) -> bool:
    noticed = datetime.fromisoformat(feature.properties["noticed"])
    return (since is None or noticed >= since) and (until is None or noticed <= until)


def _visited(square: TileAddress, drives: int, last_s: float) -> Feature:
    return Feature(geometry=_square(*square), properties={"drives": drives, "last_seen": last_s})


def _square(z: int, x: int, y: int) -> dict[str, object]:
    """The outline of a web-mercator tile in degrees."""
    west, south, east, north = tile_bounds(TileAddress(z, x, y))
    return {"type": "Polygon", "coordinates": [[[west, south], [east, south], [east, north], [west, north], [west, south]]]}
