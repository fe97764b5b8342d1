"""Cloud-optimised GeoTIFF of the map's ground: orthophoto or heights in UTM, drawn tile by tile from the merged regions."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.errors import InputError
from wayloom.exports.source import MapSource
from wayloom.files.geotiff import TILE, GeoGrid, write_cog
from wayloom.geodesy import wgs84
from wayloom.geodesy.antimeridian import Box
from wayloom.geodesy.map_frame import MapFrame
from wayloom.ground.exports import SOLID, halved_colours, halved_heights
from wayloom.ground.ground_map import NO_HEIGHT
from wayloom.ground.sheet import CELL_M, PIXEL_M
from wayloom.stitching.ground_mosaic import mosaic
from wayloom.stitching.region_grid import REGION_M, region_edges, regions_within

FloatArray = NDArray[np.float64]
ORTHO, HEIGHT = "ortho", "height"
UNITS_M: Final = {ORTHO: PIXEL_M, HEIGHT: CELL_M}
"""Pixel of each layer."""
STEP_M: Final = 10.0
AROUND: Final = 2
"""Pixels around a tile that its resampling may ask for."""


def write_ground_cog(path: Path, source: MapSource, box: Box | None, layer: str, provenance: Mapping[str, Any]) -> tuple[int, int]:
    """Write the orthophoto (RGBA, 5 cm) or the heights (float32, 10 cm, ellipsoidal); width and height in pixels.

    Raises InputError where the layer is unknown, the map has no ground or no UTM, OSError.
    """
    if layer not in UNITS_M:
        raise InputError(f"{layer} is no layer of the ground", file=path, remedy=f"known are {', '.join(UNITS_M)}")
    if source.frame is None:
        raise InputError("is of places on Earth, and this drive has none", file=path, remedy="process it with --gnss")
    keys = [key for key in source.keys if source.raster(key, "height_mm") is not None]
    if not keys:
        raise InputError("the map has no ground here", file=path, remedy="give a box with streets, or process the drives anew")
    ground = _GroundInUtm(source, source.frame, frozenset(keys))
    grid = ground.grid(UNITS_M[layer], box)
    metadata = json.dumps(provenance)
    if layer == ORTHO:
        empty: NDArray[Any] = np.zeros((TILE, TILE, 4), np.uint8)
        write_cog(path, grid, lambda row, column: ground.photo(grid, row, column), empty, halved_colours, metadata)
    else:
        empty = np.full((TILE, TILE), np.nan, np.float32)
        write_cog(path, grid, lambda row, column: ground.heights(grid, row, column), empty, halved_heights, metadata)
    return grid.width, grid.height


class _GroundInUtm:
    """The merged ground seen from above in the UTM zone of the map's place."""

    def __init__(self, source: MapSource, frame: MapFrame, keys: frozenset[tuple[int, int]]) -> None:
        self._source, self._frame, self._keys = source, frame, keys
        lon, lat, _ = wgs84.lonlatheight_from_enu(source.place[None], frame)[0].tolist()
        self._epsg = wgs84.utm_epsg(lon, lat)

    def _utm(self, points: FloatArray) -> FloatArray:
        return wgs84.utm_from_lonlatheight(wgs84.lonlatheight_from_enu(points, self._frame), self._epsg)

    def grid(self, unit_m: float, box: Box | None) -> GeoGrid:
        """Whole pixels of the coarsest unit around the regions, cut to the box."""
        corners = [np.append(edge, self._source.place[2]) for key in self._keys for edge in _corners(key)]
        places = self._utm(np.array(corners))[:, :2]
        low, high = places.min(axis=0), places.max(axis=0)
        if box is not None:
            west, south, east, north = box
            edges = np.array([[x, y, 0.0] for x in (west, east) for y in (south, north)])
            cut = wgs84.utm_from_lonlatheight(edges, self._epsg)[:, :2]
            low, high = np.maximum(low, cut.min(axis=0)), np.minimum(high, cut.max(axis=0))
        low, high = np.floor(low / CELL_M) * CELL_M, np.ceil(high / CELL_M) * CELL_M
        width, height = np.maximum(np.rint((high - low) / unit_m), 1).astype(int).tolist()
        return GeoGrid(float(low[0]), float(high[1]), unit_m, width, height, self._epsg)

    def photo(self, grid: GeoGrid, row: int, column: int) -> NDArray[np.uint8] | None:
        """RGBA of a tile; None where nothing was seen."""
        found = self._around(grid, row, column, ("colour", "sharpness"))
        if found is None:
            return None
        (colour, sharpness), M = found[0], found[1]
        colour = colour if colour.shape[2] == 3 else colour.repeat(3, axis=2)
        seen = (sharpness > 0).astype(np.float32)
        alpha = _warped(seen, M, cv2.INTER_LINEAR)
        shown = _warped(colour.astype(np.float32) * seen[..., None], M, cv2.INTER_LINEAR) / np.maximum(alpha, SOLID)[..., None]
        tile = np.zeros((TILE, TILE, 4), np.uint8)
        solid = alpha >= SOLID
        tile[solid, :3], tile[solid, 3] = np.rint(shown[solid]).clip(0, 255), 255
        return tile if solid.any() else None

    def heights(self, grid: GeoGrid, row: int, column: int) -> NDArray[np.float32] | None:
        """Ellipsoidal heights of a tile, NaN where there are none; None where nothing was seen."""
        found = self._around(grid, row, column, ("height_mm",))
        if found is None:
            return None
        (height_mm,), M, tilt = found
        own = _warped(np.where(height_mm == NO_HEIGHT, np.nan, height_mm / 1000.0), M, cv2.INTER_NEAREST, np.nan)
        v, u = np.mgrid[0:TILE, 0:TILE]
        tile = (own + tilt[0] + tilt[1] * u + tilt[2] * v).astype(np.float32)
        return tile if np.isfinite(tile).any() else None

    def _around(
        self, grid: GeoGrid, row: int, column: int, names: tuple[str, ...]
    ) -> tuple[list[NDArray[Any]], FloatArray, FloatArray] | None:
        """Rasters around a tile, the (2, 3) that takes its pixels to theirs, and (3,) what is to be added to heights of the frame:
        at pixel (0, 0), a column and a row. Over a tile UTM and the Earth bend by less than a millimetre."""
        side = TILE * grid.pixel_m
        middle_utm = np.array([grid.west + (column + 0.5) * side, grid.north - (row + 0.5) * side])
        at, height_m, J = self._place(middle_utm)
        inverse = np.linalg.inv(J[:2, :2])
        reach = np.abs(inverse) @ np.full(2, 0.5 * side) + AROUND * grid.pixel_m
        low, high = (at[:2] + sign * reach for sign in (-1.0, 1.0))
        keys = [key for key in regions_within(low, high, 0.0) if key in self._keys]
        if not keys:
            return None
        first, last = np.floor(low / grid.pixel_m).astype(np.int64), np.ceil(high / grid.pixel_m).astype(np.int64)
        rasters = [mosaic(keys, self._source, name, first, last, grid.pixel_m) for name in names]
        step = grid.pixel_m * np.array([[1.0, 0.0], [0.0, -1.0]])
        corner = np.array([grid.west + column * side, grid.north - row * side]) + step @ np.array([0.5, 0.5])
        origin = at[:2] + inverse @ (corner - middle_utm)
        M = np.column_stack([inverse @ step, origin]) / grid.pixel_m - np.column_stack([np.zeros((2, 2)), first + 0.5])
        slope = J[2, :2] @ inverse  # of height over UTM, for what is level in the frame
        tilt = np.array([height_m - at[2] + slope @ (corner - middle_utm), *(slope @ step)])
        return rasters, M, tilt

    def _place(self, utm: FloatArray) -> tuple[FloatArray, float, FloatArray]:
        """The place (3,) in the frame under a UTM place (2,), at the height of the map's road; its ellipsoidal height; and (3, 3)
        UTM and height by the frame."""
        at = self._source.place.copy()
        for _ in range(3):
            J = (self._utm(at + STEP_M * np.eye(3)) - self._utm(at - STEP_M * np.eye(3))).T / (2.0 * STEP_M)
            at[:2] += np.linalg.solve(J[:2, :2], utm - self._utm(at[None])[0, :2])
            at[2] = self._height(at)
        return at, float(self._utm(at[None])[0, 2]), J

    def _height(self, at: FloatArray) -> float:
        """Median height of the region's ground at a place, m in the frame; the place's own where there is none."""
        key = (int(at[0] // REGION_M), int(at[1] // REGION_M))
        height_mm = self._source.raster(key, "height_mm") if key in self._keys else None
        known = height_mm[height_mm != NO_HEIGHT] if height_mm is not None else np.zeros(0)
        return float(np.median(known)) / 1000.0 if len(known) else float(at[2])


def _corners(key: tuple[int, int]) -> list[FloatArray]:
    low, high = region_edges(key)
    return [np.array([x, y]) for x in (low[0], high[0]) for y in (low[1], high[1])]


def _warped(raster: NDArray[Any], M: FloatArray, how: int, border: float = 0.0) -> NDArray[Any]:
    found = cv2.warpAffine(raster, M, (TILE, TILE), flags=how | cv2.WARP_INVERSE_MAP, borderValue=(border,) * 4)
    return np.asarray(found)
