"""Web-mercator XYZ tile grid: a unit square, x to the east from the antimeridian, y to the south from 85.05 degrees north.

x = (lon + 180) / 360,   y = 1/2 - asinh(tan lat) / 2 pi;   tile = floor(2^z (x, y)),   pixel = floor(256 2^z (x, y))
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import InputError

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
TILE_PX = 256
MAX_ZOOM = 21
MAX_LATITUDE_DEG = math.degrees(math.atan(math.sinh(math.pi)))
EQUATOR_M = 2.0 * math.pi * 6_378_137.0


class TileAddress(NamedTuple):
    """Zoom, column from the west, row from the north."""

    z: int
    x: int
    y: int


def check_tile(z: int, x: int, y: int) -> TileAddress:
    """The address, or InputError when there is no such tile."""
    if not 0 <= z <= MAX_ZOOM:
        raise InputError(f"zoom {z} does not exist", remedy=f"zooms are 0 to {MAX_ZOOM}")
    if not (0 <= x < 1 << z and 0 <= y < 1 << z):
        raise InputError(f"tile {z}/{x}/{y} does not exist", remedy=f"x and y are 0 to {(1 << z) - 1} at zoom {z}")
    return TileAddress(z, x, y)


def unit_from_lonlat(lon_lat: FloatArray) -> FloatArray:
    """lon_lat (N, 2) degrees to the unit square (N, 2), both in [0, 1). A longitude of 180 is -180.

    Raises InputError for places that web mercator does not show (beyond 85.0511 degrees) and for what is no longitude.
    """
    lon, lat = np.asarray(lon_lat, np.float64).reshape(-1, 2).T
    bad = ~((np.abs(lat) <= MAX_LATITUDE_DEG) & (np.abs(lon) <= 180.0))
    if bad.any():
        i = int(np.argmax(bad))
        remedy = f"tiles show latitudes to {MAX_LATITUDE_DEG:.4f} and longitudes to 180 degrees"
        raise InputError(f"longitude {lon[i]}, latitude {lat[i]} lies on no tile", remedy=remedy)
    x = (lon + 180.0) / 360.0
    y = 0.5 - np.arcsinh(np.tan(np.radians(lat))) / (2.0 * np.pi)
    return np.column_stack([np.where(x >= 1.0, 0.0, x), np.clip(y, 0.0, np.nextafter(1.0, 0.0))])


def lonlat_from_unit(unit: FloatArray) -> FloatArray:
    """The inverse of `unit_from_lonlat`: unit (N, 2) to lon_lat (N, 2) degrees."""
    unit = np.asarray(unit, np.float64).reshape(-1, 2)
    lat = np.degrees(np.arctan(np.sinh(np.pi * (1.0 - 2.0 * unit[:, 1]))))
    return np.column_stack([unit[:, 0] * 360.0 - 180.0, lat])


def pixel_from_lonlat(lon_lat: FloatArray, zoom: int) -> IntArray:
    """lon_lat (N, 2) degrees to the pixel (N, 2) column, row of the whole world's picture at this zoom."""
    return np.floor(unit_from_lonlat(lon_lat) * (TILE_PX << zoom)).astype(np.int64)


def tile_bounds(tile: TileAddress) -> tuple[float, float, float, float]:
    """West, south, east, north in degrees."""
    corners = np.array([[tile.x, tile.y + 1], [tile.x + 1, tile.y]], np.float64) / (1 << tile.z)
    (west, south), (east, north) = lonlat_from_unit(corners).tolist()
    return west, south, east, north


def spans_of_box(box: tuple[float, float, float, float], zoom: int) -> list[tuple[int, int, int, int]]:
    """First and last column, first and last row of the tiles of a zoom that a box of degrees touches: of one that goes over the
    antimeridian (its east is over 180) on both sides of it. What lies beyond web mercator's latitudes is cut off."""
    west, south, east, north = box
    if east - west >= 360.0:
        west, east = -180.0, 180.0
    parts = [(west, min(east, 180.0))] + ([(-180.0, east - 360.0)] if east > 180.0 else [])
    lats = np.clip([north, south], -MAX_LATITUDE_DEG, MAX_LATITUDE_DEG)
    rows = np.floor(unit_from_lonlat(np.column_stack([[0.0, 0.0], lats]))[:, 1] * (1 << zoom)).astype(int).tolist()
    columns = [[min(int((lon + 180.0) / 360.0 * (1 << zoom)), (1 << zoom) - 1) for lon in part] for part in parts]
    return [(first, last, rows[0], rows[1]) for first, last in columns]


def tile_centre(tile: TileAddress) -> tuple[float, float]:
    """Longitude and latitude of the middle of a tile, degrees."""
    centre = np.array([[tile.x + 0.5, tile.y + 0.5]]) / (1 << tile.z)
    lon, lat = lonlat_from_unit(centre)[0].tolist()
    return lon, lat


def metres_per_pixel(zoom: int, lat_deg: float) -> float:
    """Width of a pixel on the ground, m."""
    return EQUATOR_M * math.cos(math.radians(lat_deg)) / (TILE_PX << zoom)


def row_by_row(address: TileAddress) -> tuple[int, int]:
    """The order of tiles of one zoom."""
    return address.y, address.x


def ancestor(address: TileAddress, zoom: int) -> TileAddress:
    """The tile of a zoom, not finer than its own, in which the tile lies."""
    return TileAddress(zoom, address.x >> (address.z - zoom), address.y >> (address.z - zoom))


def children(address: TileAddress) -> list[TileAddress]:
    """The four tiles of the next zoom in it."""
    return [TileAddress(address.z + 1, 2 * address.x + dx, 2 * address.y + dy) for dy in (0, 1) for dx in (0, 1)]
