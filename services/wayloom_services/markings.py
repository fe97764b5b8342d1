"""Endpoint of markings and kerbs: a version's, in a box, page by page."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import islice
from typing import Annotated, Any, Final

import numpy as np
from fastapi import APIRouter, Depends, Query

from wayloom.geodesy.antimeridian import box_of, overlap
from wayloom.geodesy.map_frame import MapFrame
from wayloom.stitching.marking_files import AROUND_M, lines_of, read_features
from wayloom.stitching.region_grid import RegionKey, region_box
from wayloom.store import map_versions, maps
from wayloom.store.blobs import BlobStore
from wayloom.store.database import Session
from wayloom.store.maps import Box
from wayloom_services.context import Service, ServiceDep, require_key
from wayloom_services.drives import PROBLEMS
from wayloom_services.maps import BBox, MapId, Number, box_of_query
from wayloom_services.schemas import Feature, MarkingPage

MOST: Final = 5000
AFTER: Final = "`next` of the page before: column and row of a region, and how many of its features were given"
Limit = Annotated[int, Query(ge=1, le=MOST, description="how many features a page has at most")]
After = Annotated[str | None, Query(pattern=r"^-?\d{1,9},-?\d{1,9},\d{1,9}$", description=AFTER)]
Place = tuple[RegionKey, int]
"""A region, and how many of its features lie before."""

router = APIRouter(prefix="/v1", tags=["maps"], dependencies=[Depends(require_key)], responses=PROBLEMS)


@router.get("/maps/{map_id}/versions/{number}/markings")
async def markings_of_version(
    map_id: MapId, number: Number, service: ServiceDep, bbox: BBox = None, limit: Limit = 1000, after: After = None
) -> MarkingPage:
    """Markings and kerbs of a version, those that reach into the box. `next` is `after` of the next page; null: there is none."""
    box = None if bbox is None else box_of_query(bbox)

    def read(session: Session) -> list[tuple[RegionKey, str]]:
        frame = MapFrame(*maps.version(session, map_id, number).frame)
        held = map_versions.marked_regions(session, map_id, number)
        return [one for one in held if box is None or overlap(region_box(one[0], frame, AROUND_M), box)]

    regions = await service.read(read)
    return await service.in_thread(lambda: _page(service, regions, box, limit, _place(after)))


def _page(
    service: Service, regions: Sequence[tuple[RegionKey, str]], box: Box | None, limit: int, first: Place | None
) -> MarkingPage:
    """The features from a place on; one more than the page has is looked for, to know whether there is a next."""
    found = list(islice(_features(service.blobs, regions, box, first), limit + 1))
    following = None if len(found) <= limit else found[limit][0]
    text = None if following is None else f"{following[0][0]},{following[0][1]},{following[1]}"
    return MarkingPage(features=[Feature(**feature) for _, feature in found[:limit]], next=text)


def _features(
    blobs: BlobStore, regions: Sequence[tuple[RegionKey, str]], box: Box | None, first: Place | None
) -> Iterator[tuple[Place, dict[str, Any]]]:
    for key, digest in regions:
        if first is not None and key < first[0]:
            continue
        for count, feature in enumerate(read_features(blobs.get(digest), digest)):
            place = (key, count)
            if (first is None or place >= first) and (box is None or overlap(_bounds(feature["geometry"]), box)):
                yield place, feature


def _bounds(geometry: Mapping[str, Any]) -> Box:
    return box_of(np.array([place[:2] for line in lines_of(geometry) for place in line], np.float64))


def _place(after: str | None) -> Place | None:
    if after is None:
        return None
    east, north, count = (int(part) for part in after.split(","))
    return (east, north), count
