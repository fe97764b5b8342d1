"""Collections of a map version for OGC API Features: objects, areas, markings, kerbs, tracks, changes."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from typing import Any, Final

from wayloom.geodesy.antimeridian import line_geometry
from wayloom.stitching.marking_files import read_features
from wayloom.stitching.region_grid import RegionKey
from wayloom.store import map_versions, maps
from wayloom.store.database import Session
from wayloom.store.tables.drives import Drive
from wayloom.store.tables.maps import MapVersion
from wayloom_services.context import Service
from wayloom_services.ogc_queries import Span, Wanted
from wayloom_services.region_features import Content, features_from, page_of, place_of, reaches

Feature = dict[str, Any]
Regions = list[tuple[RegionKey, Callable[[], Content]]]
ALL: Final = (0, 0)
"""The one region of what is not kept by regions."""


@dataclass(frozen=True, slots=True)
class Collection:
    """A collection.

    read  of a version the regions with their features
    span  when a feature was, by its properties; None: it has no time
    has   which of a region's features are its own
    """

    title: str
    description: str
    read: Callable[[Service, Session, MapVersion], Regions]
    span: Callable[[Mapping[str, Any]], Span | None] = lambda _: None
    has: Callable[[Mapping[str, Any]], bool] = lambda _: True

    def page(self, service: Service, version: MapVersion, wanted: Wanted) -> tuple[list[Feature], str | None]:
        """The features that are asked for, and where the next page begins."""
        with service.database.read() as session:
            regions = [one for one in self.read(service, session, version) if self._may_have(one[0], version, wanted)]

        def is_wanted(feature: Mapping[str, Any]) -> bool:
            return self.has(feature) and wanted.has(feature, self.span(feature["properties"]))

        found, following = page_of(features_from(regions, wanted.box, place_of(wanted.after), is_wanted), wanted.limit)
        return [_named(key, count, feature) for (key, count), feature in found], following

    def one(self, service: Service, version: MapVersion, name: str) -> Feature | None:
        """The feature of an id."""
        with service.database.read() as session:
            regions = self.read(service, session, version)
        for key, read in regions:
            if name.startswith(f"{key[0]}.{key[1]}.") or key == ALL:
                for count, feature in enumerate(read()):
                    named = _named(key, count, feature)
                    if named["id"] == name and self.has(feature):
                        return named
        return None

    def _may_have(self, key: RegionKey, version: MapVersion, wanted: Wanted) -> bool:
        return self.read is _tracks or reaches(key, version, wanted.box)


def _named(key: RegionKey, count: int, feature: Mapping[str, Any]) -> Feature:
    """With an id, of its region and its place there where it has none of its own."""
    return {"type": "Feature", "id": feature.get("id", f"{key[0]}.{key[1]}.{count}"), **feature}


def _of_regions(of: str, service: Service, session: Session, version: MapVersion) -> Regions:
    held = map_versions.regions_with(session, version.map_id, version.version, of)
    return [(key, partial(_stored, service, digest)) for key, digest in held]


def _stored(service: Service, digest: str) -> Content:
    return read_features(service.blobs.get(digest), digest)


def _changes(_service: Service, session: Session, version: MapVersion) -> Regions:
    held = map_versions.changes_of_regions(session, version.map_id, version.version)
    return [(key, partial(list, features)) for key, features in held]


def _tracks(_service: Service, session: Session, version: MapVersion) -> Regions:
    """Of the drives that the version holds and that are still there: what each one's own track shows."""
    drives = [session.get(Drive, drive_id) for drive_id in maps.drives_of(session, version.map_id, version.version)]
    there = [one for one in drives if one is not None and one.state != "removing" and one.track]
    features = [_track(one, [row.track_t_ns for row in maps.submaps_of(session, one.id) if row.track_t_ns]) for one in there]
    return [(ALL, lambda: features)]


def _track(drive: Drive, times_ns: Sequence[int]) -> Feature:
    assert drive.track is not None
    properties: dict[str, Any] = {"kind": "track", "name": drive.name, "vehicle_id": drive.vehicle_id, "grade": drive.grade}
    if times_ns:
        properties |= {"first_ns": min(times_ns), "last_ns": max(times_ns)}
    return {"id": drive.id, "type": "Feature", "geometry": line_geometry(drive.track), "properties": properties}


def _seen(properties: Mapping[str, Any]) -> Span | None:
    """From the first image to the last."""
    if "first_ns" not in properties:
        return None
    first, last = (datetime.fromtimestamp(properties[name] / 1e9, UTC) for name in ("first_ns", "last_ns"))
    return first, last


def _noticed(properties: Mapping[str, Any]) -> Span | None:
    when = datetime.fromisoformat(properties["noticed"])
    return when, when


def _is_kerb(feature: Mapping[str, Any]) -> bool:
    return bool(feature["properties"]["kind"] == "kerb")


COLLECTIONS: Final = {
    "objects": Collection(
        "Objects",
        "Poles, traffic signs, traffic lights and trunks, each once, with the drives that saw it; times: first and last look",
        partial(_of_regions, "objects"),
        _seen,
    ),
    "areas": Collection(
        "Areas", "Road, sidewalk and terrain as polygons, cut at the borders of regions", partial(_of_regions, "areas")
    ),
    "markings": Collection(
        "Markings", "What is painted on the road", partial(_of_regions, "markings"), has=lambda feature: not _is_kerb(feature)
    ),
    "kerbs": Collection("Kerbs", "Steps beside the road", partial(_of_regions, "markings"), has=_is_kerb),
    "tracks": Collection("Tracks", "Ways of the drives that the version holds", _tracks, _seen),
    "changes": Collection(
        "Changes", "Things that have gone, and things that are new; times: when it was noticed", _changes, _noticed
    ),
}
"""By their ids."""
