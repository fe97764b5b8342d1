"""Polygons and points in tile units, clipped to the tiles that they touch."""

import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from wayloom.tiles.grid import TileAddress, unit_from_lonlat
from wayloom.tiles.mvt import BUFFER, EXTENT

FloatArray = NDArray[np.float64]
Point = tuple[int, int]
MARGIN = BUFFER / EXTENT


def tiles_of_point(lon_lat: FloatArray, zoom: int) -> dict[TileAddress, Point]:
    """The tiles in which a point (1, 2) lies, or whose buffer it touches, so that no symbol is cut; its place in their units."""
    place = unit_from_lonlat(lon_lat)[0] * (1 << zoom)
    return {
        TileAddress(zoom, x, y): (round(float(place[0] - x) * EXTENT), round(float(place[1] - y) * EXTENT))
        for x, y in _touched(place[None], zoom)
    }


def tiles_of_polygon(rings: Sequence[FloatArray], zoom: int) -> dict[TileAddress, list[list[Point]]]:
    """The rings of a polygon, closed (K, 2) degrees each, the outer one first, in every tile that the polygon touches.

    They run clockwise on the screen, holes the other way: GeoJSON has both the other way round. A polygon that spans the
    antimeridian is left out, as are rings that have no area in a tile's units.
    """
    world = 1 << zoom
    places = [unit_from_lonlat(ring[:0:-1]) * world for ring in rings]
    if np.ptp(places[0][:, 0]) > world / 2:
        return {}
    out = {}
    for x, y in _touched(places[0], zoom):
        clipped = [_rounded(clip_ring((place - (x, y)) * EXTENT, -BUFFER, EXTENT + BUFFER)) for place in places]
        if len(clipped[0]) > 2:
            out[TileAddress(zoom, x, y)] = [ring for ring in clipped if len(ring) > 2]
    return out


def clip_ring(ring: FloatArray, low: float, high: float) -> FloatArray:
    """The part of a ring (K, 2) in the square from low to high (Sutherland and Hodgman 1974); (0, 2) where there is none.

    Parts that the square cuts apart stay joined along its sides, beyond what a tile shows.
    """
    for axis, limit, sign in ((0, low, 1.0), (0, high, -1.0), (1, low, 1.0), (1, high, -1.0)):
        inside = (ring[:, axis] - limit) * sign >= 0.0
        if inside.all():
            continue
        if not inside.any():
            return np.zeros((0, 2))
        found = []
        for k, (a, b) in enumerate(zip(np.roll(ring, 1, axis=0), ring, strict=True)):
            if inside[k] != inside[k - 1]:
                found.append(a + (b - a) * (limit - a[axis]) / (b[axis] - a[axis]))
            if inside[k]:
                found.append(b)
        ring = np.array(found)
    return ring


def _touched(places: FloatArray, zoom: int) -> list[tuple[int, int]]:
    """Column and row of the tiles whose buffered squares the box around places (K, 2) touches."""
    last = (1 << zoom) - 1
    low, high = np.floor(places.min(axis=0) - MARGIN).astype(int), np.floor(places.max(axis=0) + MARGIN).astype(int)
    rows = range(max(int(low[1]), 0), min(int(high[1]), last) + 1)
    columns = range(max(int(low[0]), 0), min(int(high[0]), last) + 1)
    return [(x, y) for y in rows for x in columns]


def _rounded(ring: FloatArray) -> list[Point]:
    """In whole units, no point like the one before; none where no area is left."""
    points = [(x, y) for x, y in np.rint(ring).astype(int).tolist()]
    points = [point for before, point in zip([*points[-1:], *points[:-1]], points, strict=True) if point != before]
    doubled = sum(a[0] * b[1] - b[0] * a[1] for a, b in itertools.pairwise([*points, *points[:1]]))
    return points if doubled else []
