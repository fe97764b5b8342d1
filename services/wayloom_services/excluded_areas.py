"""Excluded-area endpoints: places of which the map keeps nothing."""

import json
from typing import Annotated, Any, Final

from fastapi import APIRouter, Depends, Path, Request, Response

from wayloom.config.retention import MAX_AREA_BYTES, MAX_AREAS
from wayloom.exclusion.areas import areas_of_geojson
from wayloom.store import excluded
from wayloom.store.database import Session
from wayloom.store.jobs import JobMessage
from wayloom.store.tables.maps import ExcludedArea
from wayloom_services.context import ServiceDep, require_key
from wayloom_services.drives import PROBLEMS
from wayloom_services.errors import ProtocolError
from wayloom_services.schemas.privacy import ExcludedAreaList, ExcludedAreaOut

AreaId = Annotated[str, Path(pattern="^[0-9a-f]{32}$")]
BODY: Final[dict[str, Any]] = {
    "requestBody": {"required": True, "content": {"application/geo+json": {"schema": {"type": "object"}}}}
}
router = APIRouter(prefix="/v1/excluded-areas", tags=["privacy"], dependencies=[Depends(require_key)], responses=PROBLEMS)


@router.get("")
async def areas(service: ServiceDep) -> ExcludedAreaList:
    """The areas, as a GeoJSON collection of features."""
    rows = await service.read(lambda session: excluded.of_map(session, service.settings.map_id))
    return ExcludedAreaList(features=[_out(row) for row in rows])


@router.post("", status_code=201, openapi_extra=BODY, responses={413: {"model": PROBLEMS[400]["model"]}})
async def add(request: Request, service: ServiceDep) -> ExcludedAreaList:
    """Keep nothing of these areas any more: a polygon or multi-polygon, a feature, or a collection of features with `name`.

    What the service has of drives there is dropped, the next version is made without it, and older ones that show any of it are
    withdrawn with that. It does not come back when the area is removed.
    """
    content = await request.body()
    if len(content) > MAX_AREA_BYTES:
        raise ProtocolError(413, "too-large", f"the areas are {len(content)} bytes long, {MAX_AREA_BYTES} are allowed")
    try:
        found = areas_of_geojson(json.loads(content))
    except (ValueError, RecursionError) as error:
        raise ProtocolError(400, "bad-input", f"the body is no JSON: {error}") from error
    if len(found) > MAX_AREAS:
        raise ProtocolError(
            413, "too-large", f"these are {len(found)} areas, {MAX_AREAS} are allowed: send them in several requests"
        )

    def change(session: Session) -> tuple[list[ExcludedAreaOut], list[JobMessage]]:
        made = [excluded.add(session, service.settings.map_id, name, geometry) for name, geometry in found]
        return [_out(row) for row, _ in made], [message for _, message in made]

    added, messages = await service.write(change)
    await service.notify(*messages[:1])
    return ExcludedAreaList(features=added)


@router.delete("/{area_id}", status_code=204)
async def remove(area_id: AreaId, service: ServiceDep) -> Response:
    """Let the map have the area again, of drives that come from now on or are processed anew."""
    await service.write(lambda session: excluded.remove(session, area_id))
    return Response(status_code=204)


def _out(row: ExcludedArea) -> ExcludedAreaOut:
    about = {"name": row.name, "source": row.source, "created_at": row.created_at, "since_version": row.since}
    return ExcludedAreaOut.model_validate({"id": row.id, "geometry": row.geometry, "properties": about})
