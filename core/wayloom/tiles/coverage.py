"""Coverage of a map as areas along its streets: everything within a distance of a track, outlined on a grid."""

from collections.abc import Iterable, Iterator
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.tiles.grid import TileAddress, lonlat_from_unit, metres_per_pixel, tile_bounds, unit_from_lonlat

FloatArray = NDArray[np.float64]
Ring = list[list[float]]
"""Closed, longitude and latitude in degrees."""
HALF_WIDTH_M: Final = 10.0
"""How far beside a track is covered: where most points of stereo lie that are surer than a few decimetres."""
CUT_ZOOM: Final = 13
EDGE_PX: Final = 2048
"""Areas are outlined tile by tile of this zoom, on pixels of 1.6 m at 49 degrees."""
SUBPIXEL_BITS: Final = 4
VISIT_ZOOM, COARSEST_VISIT_ZOOM = 20, 13
"""Squares in which visits are counted: 25 m wide at 49 degrees, wider where there would be too many."""
MOST_SQUARES: Final = 10_000


def covered_areas(tracks: Iterable[FloatArray], half_width_m: float = HALF_WIDTH_M) -> Iterator[list[Ring]]:
    """Polygons, each its outline and its holes, of all within half_width_m of tracks (K, 2) in degrees; cut at tiles."""
    lines: dict[TileAddress, list[FloatArray]] = {}
    for track in tracks:
        unit = unit_from_lonlat(track)
        for part in np.split(unit, np.flatnonzero(np.abs(np.diff(unit[:, 0])) > 0.5) + 1):  # not around the world
            for address in _tiles_near(part, half_width_m, float(track[0, 1])):
                lines.setdefault(address, []).append(part)
    for address in sorted(lines):
        yield from _outlined(_drawn(address, lines[address], half_width_m), address)


def visited_squares(
    tracks: Iterable[tuple[str, float, FloatArray]], most: int = MOST_SQUARES
) -> list[tuple[TileAddress, int, float]]:
    """Squares of the tile grid through which tracks lead, each with how many drives they are of and when the last one came.

    tracks : drive, seconds since 1970, (K, 2) longitude and latitude in degrees
    most   : squares; where there would be more they are of a coarser zoom
    """
    seen: dict[tuple[int, int], tuple[frozenset[str], float]] = {}
    for drive, at_s, track in tracks:
        for place in _squares_along(track):
            drives, last_s = seen.get(place, (frozenset(), at_s))
            seen[place] = (drives if drive in drives else drives | {drive}, max(last_s, at_s))
    zoom = VISIT_ZOOM
    while len(seen) > most and zoom > COARSEST_VISIT_ZOOM:
        zoom, finer, seen = zoom - 1, seen, {}
        for (x, y), (some, at_s) in finer.items():
            drives, last_s = seen.get((x // 2, y // 2), (frozenset(), at_s))
            seen[x // 2, y // 2] = (drives | some, max(last_s, at_s))
    return [(TileAddress(zoom, x, y), len(drives), last_s) for (x, y), (drives, last_s) in sorted(seen.items())]


def _squares_along(track: FloatArray) -> set[tuple[int, int]]:
    """Columns and rows of VISIT_ZOOM, every third of a square along the track."""
    world = 1 << VISIT_ZOOM
    unit = unit_from_lonlat(track)
    step = np.diff(unit, axis=0, append=unit[-1:])
    step[:, 0] -= np.rint(step[:, 0])  # the short way around the world
    counts = np.ceil(np.abs(step).max(axis=1) * world * 3.0).astype(int) + 1
    rows = np.repeat(np.arange(len(unit)), counts)
    share = (np.arange(len(rows)) - np.repeat(np.cumsum(counts) - counts, counts)) / counts[rows]
    cells = np.floor((unit[rows] + share[:, None] * step[rows]) * world).astype(int)
    return {(x % world, y) for x, y in np.unique(cells, axis=0).tolist() if 0 <= y < world}


def _tiles_near(unit: FloatArray, half_width_m: float, lat_deg: float) -> set[TileAddress]:
    world = 1 << CUT_ZOOM
    margin = half_width_m / metres_per_pixel(0, lat_deg) / 256 * world
    low, high = np.minimum(unit[:-1], unit[1:]), np.maximum(unit[:-1], unit[1:])
    if len(unit) == 1:
        low = high = unit
    first, last = np.floor(low * world - margin).astype(int), np.floor(high * world + margin).astype(int)
    return {
        TileAddress(CUT_ZOOM, x % world, y)
        for (left, top), (right, bottom) in zip(first.tolist(), last.tolist(), strict=True)
        for x in range(left, right + 1)
        for y in range(max(top, 0), min(bottom, world - 1) + 1)
    }


def _drawn(address: TileAddress, lines: list[FloatArray], half_width_m: float) -> NDArray[np.uint8]:
    """(EDGE_PX, EDGE_PX) 1 where covered."""
    _, south, _, north = tile_bounds(address)
    pixel_m = metres_per_pixel(CUT_ZOOM, 0.5 * (south + north)) * 256 / EDGE_PX
    picture = np.zeros((EDGE_PX, EDGE_PX), np.uint8)
    for unit in lines:
        places = ((unit * (1 << CUT_ZOOM) - (address.x, address.y)) * EDGE_PX - 0.5) * (1 << SUBPIXEL_BITS)
        points = np.rint(places).astype(np.int32).reshape(-1, 1, 2)
        width = max(round(2.0 * half_width_m / pixel_m), 1)
        cv2.polylines(picture, [np.concatenate([points, points[-1:]])], False, 1, width, cv2.LINE_8, SUBPIXEL_BITS)
    return picture


def _outlined(picture: NDArray[np.uint8], address: TileAddress) -> Iterator[list[Ring]]:
    """The polygons of a picture."""
    contours, tree = cv2.findContours(picture, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    rings = [_ring(contour.reshape(-1, 2), address) for contour in contours]
    for row, (_, _, hole, parent) in enumerate([] if tree is None else tree[0].tolist()):
        if parent < 0 and len(rings[row]) > 3:
            holes = []
            while hole >= 0:
                holes += [rings[hole]] if len(rings[hole]) > 3 else []
                hole = int(tree[0][hole][0])
            yield [rings[row], *holes]


def _ring(contour: NDArray[Any], address: TileAddress) -> Ring:
    """Of pixels, simplified by at most one; of an outline that touches the tile's edge, up to it."""
    simple = cv2.approxPolyDP(contour.reshape(-1, 1, 2), 1.0, True).reshape(-1, 2).astype(np.float64)
    simple = np.where(simple == 0, -0.5, np.where(simple == EDGE_PX - 1, EDGE_PX - 0.5, simple)) + 0.5
    unit = (simple / EDGE_PX + (address.x, address.y)) / (1 << CUT_ZOOM)
    found: Ring = lonlat_from_unit(unit).round(7).tolist()
    return [*found, found[0]]
