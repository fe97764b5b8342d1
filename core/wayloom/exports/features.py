"""Feature collections of a map: which there are, their columns, and how they are read, one entry a collection."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any, Final, Literal

import numpy as np

from wayloom.config.progress import Progress, silent
from wayloom.errors import InputError
from wayloom.exports.boxes import touches
from wayloom.exports.source import Feature, MapSource
from wayloom.geodesy import wgs84
from wayloom.geodesy.antimeridian import Box, line_geometry

Kind = Literal["text", "real", "whole", "json"]
"""Type of a column: `json` holds lists as their JSON text."""
DEGREES, MILLIMETRES = 9, 3
KERB: Final = "kerb"


@dataclass(frozen=True, slots=True)
class Collection:
    """Features of one kind.

    geometry : type of all of them, each in one piece; "Geometry" where they are of several
    columns : their properties, in order; a feature may lack any
    read    : those of a map, region by region
    """

    about: str
    geometry: Literal["Point", "LineString", "Polygon", "Geometry"]
    columns: Mapping[str, Kind]
    read: Callable[[MapSource, Progress], Iterator[Feature]]


def _of_regions(
    name: str, wanted: Callable[[Feature], bool] = lambda _: True, told: str = ""
) -> Callable[[MapSource, Progress], Iterator[Feature]]:
    """A reader of the features that the source has of its regions under a name; progress tells of them as `told`, else by it."""

    def read(source: MapSource, progress: Progress) -> Iterator[Feature]:
        for number, key in enumerate(source.keys):
            yield from filter(wanted, source.features(name, key))
            progress((number + 1) / len(source.keys), f"{told or name}, region {number + 1} of {len(source.keys)}")

    return read


def _tracks(source: MapSource, _progress: Progress) -> Iterator[Feature]:
    """The ways that the drives' cameras took."""
    if source.frame is None:
        return
    for track in source.tracks():
        places = wgs84.lonlatheight_from_enu(track.points_enu, source.frame).tolist()
        line = [[round(lon, DEGREES), round(lat, DEGREES), round(height, MILLIMETRES)] for lon, lat, height in places]
        if len(line) > 1:
            length_m = float(np.linalg.norm(np.diff(track.points_enu, axis=0), axis=1).sum())
            properties = {"kind": "track", "drive_id": track.drive_id, "length_m": round(length_m, MILLIMETRES)}
            yield {"type": "Feature", "geometry": line_geometry(line), "properties": properties}


def _is_kerb(feature: Feature) -> bool:
    return bool(feature["properties"]["kind"] == KERB)


_MARKING_COLUMNS: Final[dict[str, Kind]] = {
    "kind": "text", "width_m": "real", "length_m": "real", "sigma_m": "real", "sigma_along_m": "real", "sigma_width_m": "real",
    "sigma_place_m": "real", "confidence": "real", "bars": "whole", "period_m": "real", "covariance_m2": "json", "open": "json",
}  # fmt: skip
_KERB_COLUMNS: Final[dict[str, Kind]] = {
    "kind": "text", "length_m": "real", "height_m": "real", "sigma_m": "real", "sigma_height_m": "real", "sigma_place_m": "real",
    "confidence": "real", "heights_m": "json",
}  # fmt: skip
_OBJECT_COLUMNS: Final[dict[str, Kind]] = {
    "id": "text", "kind": "text", "confidence": "real", "bottom_m": "real", "height_m": "real", "width_m": "real",
    "sigma_m": "real", "sigma_up_m": "real", "facing_deg": "real", "facing_sigma_deg": "real", "looks": "whole",
    "first_ns": "whole", "last_ns": "whole", "drives": "json", "covariance_m2": "json",
}  # fmt: skip
_AREA_COLUMNS: Final[dict[str, Kind]] = {"kind": "text", "area_m2": "real", "confidence": "real", "sigma_place_m": "real"}
COLLECTIONS: Final = {
    "areas": Collection("road, sidewalk, terrain", "Polygon", _AREA_COLUMNS, _of_regions("areas")),
    "objects": Collection("poles, signs, lights, trunks", "Point", _OBJECT_COLUMNS, _of_regions("objects")),
    "markings": Collection(
        "lines, crossings, arrows", "Geometry", _MARKING_COLUMNS, _of_regions("markings", lambda one: not _is_kerb(one))
    ),
    "kerbs": Collection("kerbs with their heights", "LineString", _KERB_COLUMNS, _of_regions("markings", _is_kerb, "kerbs")),
    "tracks": Collection("ways of the drives", "LineString", {"kind": "text", "drive_id": "text", "length_m": "real"}, _tracks),
}


def wanted_collections(names: Sequence[str]) -> dict[str, Collection]:
    """Those of these names, all for none. Raises InputError that lists the known ones."""
    for name in names:
        if name not in COLLECTIONS:
            raise InputError(f"{name} is no layer of features", remedy=f"known are {', '.join(COLLECTIONS)}")
    return {name: one for name, one in COLLECTIONS.items() if not names or name in names}


def read_collection(name: str, source: MapSource, box: Box | None, progress: Progress = silent) -> Iterator[Feature]:
    """The features of a collection that touch the box, whole ones."""
    for feature in COLLECTIONS[name].read(source, progress):
        if box is None or touches(places_of(feature["geometry"]), box):
            yield feature


def single_parts(features: Iterable[Feature]) -> Iterator[Feature]:
    """The same with each part of a geometry of many as a feature of its own."""
    for feature in features:
        kind, parts = feature["geometry"]["type"], feature["geometry"]["coordinates"]
        if not kind.startswith("Multi"):
            yield feature
            continue
        for part in parts:
            yield {**feature, "geometry": {"type": kind.removeprefix("Multi"), "coordinates": part}}


def places_of(geometry: Mapping[str, Any]) -> list[Sequence[float]]:
    """All places (longitude, latitude[, height]) of a geometry."""
    parts = geometry["coordinates"]
    if geometry["type"] == "Point":
        return [parts]
    if geometry["type"] in ("LineString", "MultiPoint"):
        return [*parts]
    if geometry["type"] in ("Polygon", "MultiLineString"):
        return [*chain(*parts)]
    return [*chain(*(chain(*polygon) for polygon in parts))]
