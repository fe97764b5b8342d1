"""Endpoint of markings and kerbs: a version's, in a box, page by page."""

from collections.abc import Sequence
from functools import partial
from typing import Annotated, Any, Final

from fastapi import APIRouter, Depends, Query

from wayloom.stitching.marking_files import read_features
from wayloom.stitching.region_grid import RegionKey
from wayloom.store import maps
from wayloom.store.database import Session
from wayloom.store.maps import Box
from wayloom_services.context import Service, ServiceDep, require_key
from wayloom_services.drives import PROBLEMS
from wayloom_services.maps import BBox, MapId, Number, box_of_query
from wayloom_services.region_features import Place, features_from, page_of, place_of, regions_in
from wayloom_services.schemas.maps import Feature, MarkingPage

MOST: Final = 5000
AFTER: Final = "`next` of the page before: column and row of a region, and how many of its features were given"
Limit = Annotated[int, Query(ge=1, le=MOST, description="how many features a page has at most")]
After = Annotated[str | None, Query(pattern=r"^-?\d{1,9},-?\d{1,9},\d{1,9}$", description=AFTER)]

router = APIRouter(prefix="/v1", tags=["maps"], dependencies=[Depends(require_key)], responses=PROBLEMS)


@router.get("/maps/{map_id}/versions/{number}/markings")
async def markings_of_version(
    map_id: MapId, number: Number, service: ServiceDep, bbox: BBox = None, limit: Limit = 1000, after: After = None
) -> MarkingPage:
    """Markings and kerbs of a version, those that reach into the box. `next` is `after` of the next page; null: there is none."""
    box = None if bbox is None else box_of_query(bbox)

    def read(session: Session) -> list[tuple[RegionKey, str]]:
        return regions_in(session, maps.version(session, map_id, number), "markings", box)

    regions = await service.read(read)
    return await service.in_thread(lambda: _page(service, regions, box, limit, place_of(after)))


def _page(
    service: Service, regions: Sequence[tuple[RegionKey, str]], box: Box | None, limit: int, first: Place | None
) -> MarkingPage:
    """The features from a place on."""
    contents = [(key, partial(_read, service, digest)) for key, digest in regions]
    found, following = page_of(features_from(contents, box, first, lambda _: True), limit)
    return MarkingPage(features=[Feature(**feature) for _, feature in found], next=following)


def _read(service: Service, digest: str) -> list[dict[str, Any]]:
    return read_features(service.blobs.get(digest), digest)
