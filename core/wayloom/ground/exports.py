"""Ground of one drive as GeoTIFFs: `ground.tif` (orthophoto, RGBA) and `height.tif` (metres), in UTM or the drive's own frame."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.files.geotiff import TILE, GeoGrid, write_cog
from wayloom.geodesy import wgs84
from wayloom.geodesy.antimeridian import median_place
from wayloom.geodesy.map_frame import MapFrame
from wayloom.geometry import se3
from wayloom.ground.files import load_sheet, read_index
from wayloom.ground.kernels import picture_tiles as kernels
from wayloom.ground.sheet import CELL_M, LARGEST_SIGMA_MM, NO_HEIGHT, PIXEL_M, GroundSheet
from wayloom.submaps.submap import PlacedSubmap

FloatArray = NDArray[np.float64]
ORTHOPHOTO_FILE: Final = "ground.tif"
HEIGHT_FILE: Final = "height.tif"
SHEETS_HELD: Final = 6
SIDE_M: Final = 40.0
"""Length of the sides by which the map of a sheet into the coordinate system is taken as affine."""
UNKNOWN_MM: Final = LARGEST_SIGMA_MM + 1
"""More than any sigma."""
SOLID: Final = 0.5
"""Alpha from which a resampled pixel shows."""


@dataclass(frozen=True, slots=True)
class SheetPlace:
    """Where a sheet lies: coordinates (3,) = A (3, 3) p_sheet + b (3,); low, high (2,) of its extent; height_m (its median)."""

    digest: str
    A: FloatArray
    b: FloatArray
    low: FloatArray
    high: FloatArray
    height_m: float


def export_ground(sheets_dir: Path, submaps: Sequence[PlacedSubmap], folder: Path) -> None:
    """Write both files of a drive's sheets, memory bounded; nothing where it has none. Raises InputError for a damaged sheet."""
    T_enu_submap = {item.submap.digest: item.T_enu_submap for item in submaps}
    index = read_index(sheets_dir)
    frame = submaps[0].frame if len(submaps) else None
    epsg = None if frame is None else _epsg(submaps, frame)
    held = lru_cache(maxsize=SHEETS_HELD)(lambda digest: load_sheet(sheets_dir, digest))
    places = [_place(digest, held(digest), T_enu_submap[submap], frame, epsg) for submap, digest in index.items()]
    if not places:
        return
    photo, height = _grid(places, PIXEL_M, epsg), _grid(places, CELL_M, epsg)
    write_cog(
        folder / ORTHOPHOTO_FILE, photo, lambda row, column: _photo_tile(photo, row, column, places, held),
        np.zeros((TILE, TILE, 4), np.uint8), halved_colours,
    )  # fmt: skip
    write_cog(
        folder / HEIGHT_FILE, height, lambda row, column: _height_tile(height, row, column, places, held),
        np.full((TILE, TILE), np.nan, np.float32), halved_heights,
    )  # fmt: skip


def _epsg(submaps: Sequence[PlacedSubmap], frame: MapFrame) -> int:
    places = median_place(wgs84.lonlatheight_from_enu(np.array([item.T_enu_submap[:3, 3] for item in submaps]), frame))
    return wgs84.utm_epsg(places.lon_deg, places.lat_deg)


def _place(digest: str, sheet: GroundSheet, T_enu_submap: FloatArray, frame: MapFrame | None, epsg: int | None) -> SheetPlace:
    """Affine about the sheet's middle: over a sheet UTM and the Earth bend by less than a millimetre."""
    height = sheet.height
    rows, columns = height.shape
    corners = sheet.corner_m + CELL_M * np.array([(x, y) for x in (0, columns) for y in (0, rows)], np.float64)
    level = float(np.nanmedian(height))
    middle = np.array([*corners.mean(axis=0), level])
    at = np.vstack([middle, middle + SIDE_M * np.eye(3)])
    enu = se3.transform(T_enu_submap @ sheet.T_submap_sheet, at)
    told = enu if frame is None or epsg is None else wgs84.utm_from_lonlatheight(wgs84.lonlatheight_from_enu(enu, frame), epsg)
    A = (told[1:] - told[0]).T / SIDE_M
    b = told[0] - A @ middle
    extent = corners @ A[:2, :2].T + A[:2, 2] * level + b[:2]
    return SheetPlace(digest, A, b, extent.min(axis=0), extent.max(axis=0), level)


def _grid(places: list[SheetPlace], pixel_m: float, epsg: int | None) -> GeoGrid:
    low = np.floor(np.min([place.low for place in places], axis=0) / CELL_M) * CELL_M
    high = np.ceil(np.max([place.high for place in places], axis=0) / CELL_M) * CELL_M
    width, height = np.rint((high - low) / pixel_m).astype(int).tolist()
    return GeoGrid(float(low[0]), float(high[1]), pixel_m, width, height, epsg)


def _near(grid: GeoGrid, row: int, column: int, places: list[SheetPlace]) -> list[SheetPlace]:
    """The sheets that reach into a tile."""
    side = TILE * grid.pixel_m
    low = np.array([grid.west + column * side, grid.north - (row + 1) * side])
    return [place for place in places if (place.low < low + side).all() and (place.high > low).all()]


def _warp(grid: GeoGrid, row: int, column: int, place: SheetPlace, sheet: GroundSheet, pixel_m: float) -> FloatArray:
    """(2, 3) that takes a tile's pixels to those of a raster of the sheet: at the sheet's height in the middle of the tile."""
    side = TILE * grid.pixel_m
    inverse = np.linalg.inv(place.A[:2, :2])
    middle = np.array([grid.west + (column + 0.5) * side, grid.north - (row + 0.5) * side])
    z = _height_around(sheet, inverse @ (middle - place.b[:2] - place.A[:2, 2] * place.height_m), side, place.height_m)
    M = inverse @ np.diag([grid.pixel_m, -grid.pixel_m])
    first = np.array([grid.west + (column * TILE + 0.5) * grid.pixel_m, grid.north - (row * TILE + 0.5) * grid.pixel_m])
    origin = inverse @ (first - place.b[:2] - place.A[:2, 2] * z) - sheet.corner_m
    return np.asarray(np.column_stack([M, origin]) / pixel_m - np.array([0.0, 0.0, 0.5]), np.float64)


def _height_around(sheet: GroundSheet, at: FloatArray, side: float, otherwise: float) -> float:
    """Median height of the cells around a place of the sheet."""
    low = np.maximum(np.floor((at - 0.5 * side - sheet.corner_m) / CELL_M).astype(int), 0)
    high = np.maximum(np.floor((at + 0.5 * side - sheet.corner_m) / CELL_M).astype(int), 0)
    part = sheet.height_mm[low[1] : high[1], low[0] : high[0]]
    known = part[part != NO_HEIGHT]
    return float(np.median(known / 1000.0)) if len(known) else otherwise


def _warped(raster: NDArray[Any], M: FloatArray, how: int) -> NDArray[Any]:
    return np.asarray(cv2.warpAffine(raster, M, (TILE, TILE), flags=how | cv2.WARP_INVERSE_MAP, borderValue=0))


def _photo_tile(grid: GeoGrid, row: int, column: int, places: list[SheetPlace], held: Any) -> NDArray[np.uint8] | None:
    """Each pixel from the sheet that has it sharpest."""
    tile, best = np.zeros((TILE, TILE, 4), np.uint8), np.zeros((TILE, TILE), np.uint8)
    for place in _near(grid, row, column, places):
        sheet = held(place.digest)
        M = _warp(grid, row, column, place, sheet, PIXEL_M)
        alpha = _warped((sheet.sharpness > 0).astype(np.float32), M, cv2.INTER_LINEAR)
        colour = _warped(sheet.colour.astype(np.float32), M, cv2.INTER_LINEAR).reshape(TILE, TILE, -1)
        sharpness = _warped(sheet.sharpness, M, cv2.INTER_NEAREST)
        kernels.lay_sharper(colour, alpha, sharpness, np.float32(SOLID), tile, best)
    return tile if best.any() else None


def _height_tile(grid: GeoGrid, row: int, column: int, places: list[SheetPlace], held: Any) -> NDArray[np.float32] | None:
    """Each cell from the sheet that is surest of it; the heights are ellipsoidal, or the frame's own."""
    tile, best = np.full((TILE, TILE), np.nan, np.float32), np.full((TILE, TILE), UNKNOWN_MM)
    v, u = np.mgrid[0:TILE, 0:TILE]
    for place in _near(grid, row, column, places):
        sheet = held(place.digest)
        M = _warp(grid, row, column, place, sheet, CELL_M)
        mm = _warped(sheet.height_mm, M, cv2.INTER_NEAREST)
        xy = np.stack([M[k, 0] * u + M[k, 1] * v + M[k, 2] + 0.5 for k in range(2)], axis=-1) * CELL_M + sheet.corner_m
        stated = _warped(sheet.sigma_mm, M, cv2.INTER_NEAREST).astype(np.int64)
        sigma = np.where((stated > 0) & (mm != NO_HEIGHT), stated, UNKNOWN_MM)
        told = xy @ place.A[2, :2] + place.A[2, 2] * np.where(sigma < UNKNOWN_MM, mm / 1000.0, 0.0) + place.b[2]
        tile, best = np.where(sigma < best, told, tile).astype(np.float32), np.minimum(sigma, best)
    return tile if (best < UNKNOWN_MM).any() else None


def halved_colours(tile: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """RGBA (2h, 2w, 4) at half its size: means of what shows."""
    half = np.empty((tile.shape[0] // 2, tile.shape[1] // 2, 4), np.uint8)
    kernels.halve_colours(tile, half)
    return half


def halved_heights(tile: NDArray[np.float32]) -> NDArray[np.float32]:
    """Heights (2h, 2w) at half their size: means of those that are known."""
    values = tile.astype(np.float64)
    known = np.isfinite(values)
    count, total = _sums_of_four(known.astype(np.uint8)), _sums_of_four(np.where(known, values, 0.0))
    return np.where(count > 0, total / np.maximum(count, 1), np.nan).astype(np.float32)


def _sums_of_four(values: NDArray[Any]) -> NDArray[Any]:
    """(h, w[, C]) of (2h, 2w[, C])."""
    above, below = values[0::2], values[1::2]
    return np.asarray((above[:, 0::2] + above[:, 1::2]) + (below[:, 0::2] + below[:, 1::2]))
