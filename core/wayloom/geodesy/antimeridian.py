"""Longitudes around the antimeridian: medians, boxes and GeoJSON lines of places that lie on both sides of it.

Longitudes are circular: 179.9999 and -179.9999 degrees are neighbours. Everything here unrolls them around one of the places, which
holds for places that lie within half the Earth of each other.
"""

import itertools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayloom.geodesy.map_frame import MapFrame

FloatArray = NDArray[np.float64]
Box = tuple[float, float, float, float]


def unrolled(lon_deg: FloatArray, around_deg: float) -> FloatArray:
    """(N,) the same longitudes within 180 degrees of around_deg, so that neighbours are near each other as numbers."""
    return np.asarray(around_deg + (np.asarray(lon_deg) - around_deg + 180.0) % 360.0 - 180.0)


def rolled(lon_deg: float) -> float:
    """The same longitude from -180 to 180."""
    return lon_deg if -180.0 <= lon_deg <= 180.0 else (lon_deg + 180.0) % 360.0 - 180.0


def median_place(lon_lat_height: FloatArray) -> MapFrame:
    """The tangent plane at the median of places (N, 3), N >= 1: no outlier moves it far, and no antimeridian."""
    lon = float(np.median(unrolled(lon_lat_height[:, 0], float(lon_lat_height[0, 0]))))
    lat, height = np.median(lon_lat_height[:, 1:], axis=0).tolist()
    return MapFrame(rolled(lon), lat, height)


def box_of(lon_lat: FloatArray) -> Box:
    """West, south, east, north of places (N, 2), degrees. Across the antimeridian east is over 180, so that west <= east."""
    lon = unrolled(lon_lat[:, 0], float(lon_lat[0, 0]))
    (south, north) = (float(lon_lat[:, 1].min()), float(lon_lat[:, 1].max()))
    west = rolled(float(lon.min()))
    return west, south, west + float(np.ptp(lon)), north


def union_of(boxes: list[Box]) -> Box:
    """The box around boxes of `box_of`, west <= east likewise."""
    middle = unrolled(np.array([0.5 * (west + east) for west, _, east, _ in boxes]), 0.5 * (boxes[0][0] + boxes[0][2]))
    half = np.array([0.5 * (east - west) for west, _, east, _ in boxes])
    west, east = float((middle - half).min()), float((middle + half).max())
    return rolled(west), min(box[1] for box in boxes), rolled(west) + east - west, max(box[3] for box in boxes)


def overlap(one: Box, other: Box) -> bool:
    """Whether two boxes touch, whichever way round the Earth either is written."""
    apart = one[3] < other[1] or one[1] > other[3]
    return not apart and any(one[0] <= other[2] + turn and one[2] >= other[0] + turn for turn in (0.0, 360.0, -360.0))


def line_geometry(lon_lat_height: list[list[float]]) -> dict[str, Any]:
    """GeoJSON of a way: a LineString, or, cut where it crosses the antimeridian, a MultiLineString (RFC 7946, 3.1.9)."""
    lines = [[lon_lat_height[0]]]
    for before, here in itertools.pairwise(lon_lat_height):
        if abs(here[0] - before[0]) > 180.0:
            left, right = _at_antimeridian(before, here)
            lines[-1].append(left)
            lines.append([right])
        lines[-1].append(here)
    if len(lines) == 1:
        return {"type": "LineString", "coordinates": lines[0]}
    return {"type": "MultiLineString", "coordinates": lines}


def _at_antimeridian(before: list[float], here: list[float]) -> tuple[list[float], list[float]]:
    """The end of one part and the beginning of the next, on the straight line between two places."""
    edge = 180.0 if before[0] > 0.0 else -180.0
    step = here[0] + 2.0 * edge - before[0]
    share = (edge - before[0]) / step if step else 0.0
    rest = [round(a + share * (b - a), 9) for a, b in zip(before[1:], here[1:], strict=True)]
    return [edge, *rest], [-edge, *rest]
