"""Endpoints of a version's regions, whole, and of its drives' tracks: what an export of the map is made from."""

from enum import StrEnum
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Path, Response

from wayloom.geodesy.antimeridian import line_geometry, overlap
from wayloom.geodesy.map_frame import MapFrame
from wayloom.stitching.region_grid import region_box
from wayloom.store import lineage, maps
from wayloom.store.database import Session
from wayloom.store.tables.maps import RegionRow
from wayloom_services.context import ServiceDep, require_key
from wayloom_services.drives import PROBLEMS
from wayloom_services.errors import ProtocolError
from wayloom_services.maps import BBox, MapId, Number, box_of_query
from wayloom_services.schemas.maps import Feature, FeatureCollection, RegionParts, RegionPartsList
from wayloom_services.tile_answers import forever

Step = Annotated[int, Path(ge=-(2**31), lt=2**31)]
OCTETS = "application/octet-stream"

router = APIRouter(prefix="/v1", tags=["maps"], dependencies=[Depends(require_key)], responses=PROBLEMS)


class Part(StrEnum):
    """What there is of a region, each a file of docs/formats.md."""

    VOXELS = "voxels"
    GROUND = "ground"
    MARKINGS = "markings"
    AREAS = "areas"
    OBJECTS = "objects"


@router.get("/maps/{map_id}/versions/{number}/regions")
async def regions_of_version(map_id: MapId, number: Number, service: ServiceDep, bbox: BBox = None) -> RegionPartsList:
    """The regions of a version, or those that touch the box, with the digests of their parts."""
    box = None if bbox is None else box_of_query(bbox)

    def read(session: Session) -> RegionPartsList:
        version = maps.version(session, map_id, number)
        frame = MapFrame(*version.frame)
        every = lineage.regions_of_version(session, version, None)
        rows = [row for row in every if box is None or overlap(region_box((row.east, row.north), frame, 0.0), box)]
        return RegionPartsList(
            frame=version.frame, built_with=version.built_with, regions=[RegionParts(**_parts(row)) for row in rows]
        )

    return await service.read(read)


@router.get(
    "/maps/{map_id}/versions/{number}/regions/{east}/{north}/{part}",
    response_class=Response,
    responses={200: {"content": {OCTETS: {}}}},
)
async def region_part(map_id: MapId, number: Number, east: Step, north: Step, part: Part, service: ServiceDep) -> Response:
    """A region's voxels, ground or features, as docs/formats.md describes them; 404 where it has none."""

    def read(session: Session) -> str:
        version = maps.version(session, map_id, number)
        found = lineage.regions_of_version(session, version, [(east, north)])
        return str(_parts(found[0])[part.value]) if found else ""

    digest = await service.read(read)
    if not digest:
        raise ProtocolError(404, "not-found", f"version {number} of {map_id} has no {part.value} of region {east}, {north}")
    content = await service.in_thread(lambda: service.blobs.get(digest))
    return Response(content, headers={"ETag": f'"{digest}"', "Cache-Control": forever(service)}, media_type=OCTETS)


@router.get("/maps/{map_id}/tracks")
async def tracks(map_id: MapId, service: ServiceDep, bbox: BBox = None) -> FeatureCollection:
    """The ways of the newest version's drives, submap by submap, or those that touch the box: lines of longitude and latitude."""
    box = None if bbox is None else box_of_query(bbox)
    rows = await service.read(lambda session: maps.submaps(session, map_id, box))
    found = sorted((row.drive_id, row.position, row.track) for row in rows if len(row.track) > 1)
    features = [_line(drive_id, position, track) for drive_id, position, track in found]
    return FeatureCollection(features=features)


def _line(drive_id: str, position: int, track: list[Any]) -> Feature:
    return Feature(geometry=line_geometry(track), properties={"drive_id": drive_id, "position": position})


def _parts(row: RegionRow) -> dict[str, Any]:
    """The fields of `RegionParts`."""
    return {
        "east": row.east, "north": row.north, "bytes": row.size, "voxels": row.digest, "ground": row.ground,
        "markings": row.markings, "areas": row.areas, "objects": row.objects,
    }  # fmt: skip
