"""Features of the regions of a map version, region by region, from any place on."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import islice
from typing import Any

from wayloom.geodesy.antimeridian import overlap
from wayloom.geodesy.map_frame import MapFrame
from wayloom.stitching.marking_files import AROUND_M, bounds_of
from wayloom.stitching.region_grid import RegionKey, region_box
from wayloom.store import map_versions
from wayloom.store.database import Session
from wayloom.store.maps import Box
from wayloom.store.tables.maps import MapVersion

Place = tuple[RegionKey, int]
"""A region, and how many of its features lie before."""
Content = Sequence[Mapping[str, Any]]
Wanted = Callable[[Mapping[str, Any]], bool]


def regions_in(session: Session, version: MapVersion, of: str, box: Box | None) -> list[tuple[RegionKey, str]]:
    """The regions of a version whose features of a kind may reach into a box, with the digests of these."""
    held = map_versions.regions_with(session, version.map_id, version.version, of)
    return [one for one in held if reaches(one[0], version, box)]


def reaches(key: RegionKey, version: MapVersion, box: Box | None) -> bool:
    """Whether features of a region may lie in a box."""
    return box is None or overlap(region_box(key, MapFrame(*version.frame), AROUND_M), box)


def features_from(
    regions: Sequence[tuple[RegionKey, Callable[[], Content]]], box: Box | None, first: Place | None, wanted: Wanted
) -> Iterator[tuple[Place, Mapping[str, Any]]]:
    """The features of regions, in order, that reach into a box and are wanted, from a place on."""
    for key, read in regions:
        if first is not None and key < first[0]:
            continue
        for count, feature in enumerate(read()):
            place = (key, count)
            if (first is None or place >= first) and wanted(feature) and (box is None or overlap(bounds_of(feature), box)):
                yield place, feature


def page_of(
    found: Iterator[tuple[Place, Mapping[str, Any]]], limit: int
) -> tuple[list[tuple[Place, Mapping[str, Any]]], str | None]:
    """The next `limit` features, and the name of the place where the next page begins: one more is looked for."""
    rows = list(islice(found, limit + 1))
    if len(rows) <= limit:
        return rows, None
    (east, north), count = rows[limit][0]
    return rows[:limit], f"{east},{north},{count}"


def place_of(after: str | None) -> Place | None:
    """The inverse of the names that `page_of` gives."""
    if after is None:
        return None
    east, north, count = (int(part) for part in after.split(","))
    return (east, north), count
