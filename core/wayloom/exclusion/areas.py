"""Excluded areas: polygons of GeoJSON, and which places lie in them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import InputError

FloatArray = NDArray[np.float64]
Box = tuple[float, float, float, float]
"""West, south, east, north in degrees; across the antimeridian east is over 180."""
METRES_A_DEGREE: Final = 111_000.0
"""Of latitude, and of longitude at the equator: a little less than anywhere, so that margins are a little wide."""
MOST_CORNERS: Final = 10_000
LONGEST_NAME: Final = 256
FURTHEST_LAT_DEG: Final = 89.0
WIDEST_DEG: Final = 90.0


@dataclass(frozen=True, slots=True)
class Area:
    """An area: rings of polygons, each (N, 2) longitudes and latitudes in degrees, N >= 3 without a closing point.

    What an odd number of rings encloses is inside, so holes are rings as well. Longitudes of all rings lie within 180 degrees of
    the first corner's: they may be over 180.
    """

    rings: tuple[FloatArray, ...]

    @property
    def box(self) -> Box:
        """Around all rings."""
        corners = np.concatenate(self.rings)
        (west, south), (east, north) = corners.min(axis=0).tolist(), corners.max(axis=0).tolist()
        return west, south, east, north

    def contains(self, lon_lat: FloatArray, margin_m: float = 0.0) -> NDArray[np.bool_]:
        """(N,) whether places (N, 2), degrees, lie inside, or nearer to a border than the margin."""
        origin = self.rings[0][0]
        scale = METRES_A_DEGREE * np.array([max(np.cos(np.radians(origin[1])), 1e-3), 1.0])
        places = np.column_stack([_turned(lon_lat[:, 0] - origin[0]), lon_lat[:, 1] - origin[1]]) * scale
        rings = [(ring - origin) * scale for ring in self.rings]
        corners = np.concatenate(rings)
        near = ((places >= corners.min(axis=0) - margin_m) & (places <= corners.max(axis=0) + margin_m)).all(axis=1)
        found = np.zeros(len(places), bool)
        found[near] = _inside(places[near], rings, margin_m)
        return found


def _turned(longitude_deg: FloatArray) -> FloatArray:
    """-180 to 180."""
    return (longitude_deg + 180.0) % 360.0 - 180.0


def _inside(places: FloatArray, rings: Sequence[FloatArray], margin_m: float) -> NDArray[np.bool_]:
    """By the number of edges to the east of each place, and by the distance to the nearest one; metres."""
    odd, near = np.zeros(len(places), bool), np.zeros(len(places), bool)
    x, y = places.T
    for ring in rings:
        for (ax, ay), (bx, by) in zip(ring, np.roll(ring, -1, axis=0), strict=True):
            crosses = (ay > y) != (by > y)
            odd ^= crosses & (x < ax + (y - ay) * (bx - ax) / np.where(crosses, by - ay, 1.0))
            if margin_m > 0.0:
                length2 = (bx - ax) ** 2 + (by - ay) ** 2
                along = np.clip(((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / max(length2, 1e-12), 0.0, 1.0)
                near |= (x - ax - along * (bx - ax)) ** 2 + (y - ay - along * (by - ay)) ** 2 < margin_m**2
    return odd | near


def areas_of_geojson(content: Any) -> list[tuple[str, dict[str, Any]]]:
    """Name and geometry of each area of a geometry, a feature or a collection of features, as stored. Raises InputError."""
    kind = content.get("type") if isinstance(content, Mapping) else None
    if kind == "FeatureCollection":
        features = content.get("features")
        if not isinstance(features, list):
            raise _bad("a collection has a list of features")
        return [area for feature in features for area in areas_of_geojson(feature)]
    if kind == "Feature":
        properties = content.get("properties") or {}
        name = properties.get("name", "") if isinstance(properties, Mapping) else ""
        return [(_name(name), geometry) for _, geometry in areas_of_geojson(content.get("geometry"))]
    area_of_geometry(content)
    return [("", plain_geometry(content))]


def plain_geometry(geometry: Any) -> dict[str, Any]:
    """The Polygon or MultiPolygon in two finite numbers a corner and closed rings, whatever else it has. Raises InputError."""
    polygons = _polygons(geometry)
    rings = [[[*corners.tolist(), corners[0].tolist()] for corners in polygon] for polygon in polygons]
    return {"type": geometry["type"], "coordinates": rings[0] if geometry["type"] == "Polygon" else rings}


def _name(name: Any) -> str:
    """Without what a database takes in no text: NUL, and halves of surrogate pairs."""
    return str(name).replace("\0", "").encode(errors="ignore").decode()[:LONGEST_NAME]


def area_of_geometry(geometry: Any) -> Area:
    """The area of a Polygon or MultiPolygon. Raises InputError that says what is wrong."""
    rings = [ring for polygon in _polygons(geometry) for ring in polygon]
    if not rings:
        raise _bad("it has no ring")
    if sum(map(len, rings)) > MOST_CORNERS:
        raise _bad(f"it has more than {MOST_CORNERS} corners: simplify it")
    first = rings[0][0, 0]
    turned = [np.column_stack([first + _turned(ring[:, 0] - first), ring[:, 1]]) for ring in rings]
    area = Area(tuple(turned))
    west, _, east, _ = area.box
    if east - west > WIDEST_DEG:
        raise _bad(f"it is {east - west:.0f} degrees wide, {WIDEST_DEG:.0f} are allowed")
    return area


def _polygons(geometry: Any) -> list[list[FloatArray]]:
    """For each polygon its rings, without their closing points. Raises InputError."""
    kind = geometry.get("type") if isinstance(geometry, Mapping) else None
    if kind not in ("Polygon", "MultiPolygon"):
        raise _bad(f"the geometry is {kind!r}, no Polygon or MultiPolygon")
    coordinates = geometry.get("coordinates")
    polygons = [coordinates] if kind == "Polygon" else coordinates
    try:
        return [[_ring(ring) for ring in polygon] for polygon in polygons]
    except (TypeError, ValueError, IndexError, KeyError, OverflowError) as error:
        raise _bad(f"its coordinates are not rings of longitude and latitude ({error})") from error


def _ring(ring: Any) -> FloatArray:
    corners = np.array([[float(corner[0]), float(corner[1])] for corner in ring], np.float64)
    if len(corners) > 1 and (corners[0] == corners[-1]).all():
        corners = corners[:-1]
    if len(corners) < 3:
        raise ValueError("a ring has fewer than three corners")
    if not np.isfinite(corners).all() or np.abs(corners[:, 0]).max() > 360.0 or np.abs(corners[:, 1]).max() > FURTHEST_LAT_DEG:
        raise ValueError("a corner is no longitude and latitude in degrees")
    return corners


def _bad(what: str) -> InputError:
    return InputError(f"is no area: {what}", remedy="give GeoJSON polygons in WGS84, longitude before latitude")
