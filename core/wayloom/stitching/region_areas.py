"""Areas of road, sidewalk and terrain of a region of the map, of the merged ground of the region and of what lies around it.

Like markings they are a function of the rasters of nine regions. Regions beside each other put the same points, at the same
heights, on the edge between them, so their areas join there.
"""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_NAMES
from wayloom.geodesy import wgs84
from wayloom.geodesy.map_frame import MapFrame
from wayloom.ground.areas.find import Area, find_areas
from wayloom.ground.areas.settings import AreaSettings
from wayloom.ground.ground_map import NO_HEIGHT
from wayloom.ground.markings.exports import DEGREES, MILLIMETRES
from wayloom.ground.sheet import CELL_M, GROUND_CLASSES
from wayloom.stitching.ground_mosaic import GroundOfRegions, RasterSource, mosaic, neighbourhood, place_sigma
from wayloom.stitching.marking_files import AROUND_M, encode_features
from wayloom.stitching.region_grid import RegionKey, region_edges

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
KINDS: Final = tuple(CLASS_NAMES[label] for label in GROUND_CLASSES)
"""Of areas, in the order of the votes."""
WINDOWS: Final = (1, 2, 4, 8, 16, 32, 64, 128)
"""Half the edges, in cells, of the squares whose mean height a point gets: of the first that has any."""


def region_areas(key: RegionKey, source: GroundOfRegions, frame: MapFrame, settings: AreaSettings) -> bytes | None:
    """The feature collection of a region's areas, as JSON; None where it has none."""
    if source.raster(key, "height_mm") is None:
        return None
    keys, first, last = _around(key, source)
    heights = _CornerHeights(mosaic(keys, source, "height_mm", first, last, CELL_M), first)
    areas = areas_of(key, source, settings)
    features = [_feature(one, heights, frame, place_sigma(np.vstack(one.rings), key, source)) for one in areas]
    return encode_features(features) if features else None


def areas_of(key: RegionKey, source: RasterSource, settings: AreaSettings) -> list[Area]:
    """The areas of a region, in the map's frame."""
    keys, first, last = _around(key, source)
    return find_areas(mosaic(keys, source, "votes", first, last, CELL_M), first, round(AROUND_M / CELL_M), settings)


def _around(key: RegionKey, source: RasterSource) -> tuple[list[RegionKey], IntArray, IntArray]:
    """Those of a region and the ones beside it that have ground, and (2,) the first cell and the end of what bears on it."""
    low, high = region_edges(key)
    first, last = (np.rint(edge / CELL_M).astype(np.int64) for edge in (low - AROUND_M, high + AROUND_M))
    return [one for one in neighbourhood(key) if source.raster(one, "height_mm") is not None], first, last


class _CornerHeights:
    """Mean heights around the corners of cells, in whole millimetres: whatever raster they are on.

    height_mm : (H, W); first (2,): the column and row of its first cell in the map's grid
    """

    def __init__(self, height_mm: NDArray[np.int32], first: IntArray) -> None:
        known = height_mm != NO_HEIGHT
        self._first, self._high = first, np.array(height_mm.shape[::-1])
        self._counts, self._sums = (
            np.pad(np.cumsum(np.cumsum(one, axis=0, dtype=np.int64), axis=1), ((1, 0), (1, 0)))
            for one in (known, np.where(known, height_mm, 0))
        )

    def at(self, xy: FloatArray) -> FloatArray:
        """(N,) m at corners (N, 2); 0 where no window has any."""
        places = np.rint(xy / CELL_M).astype(np.int64) - self._first
        out, missing = np.zeros(len(xy)), np.ones(len(xy), bool)
        for half in WINDOWS:
            count, total = (self._within(one, places[missing], half) for one in (self._counts, self._sums))
            rows = np.flatnonzero(missing)[count > 0]
            out[rows] = np.rint(total[count > 0] / count[count > 0]) / 1000.0
            missing[rows] = False
        return out

    def _within(self, summed: IntArray, places: IntArray, half: int) -> IntArray:
        (c, r), (c2, r2) = (np.clip(places + step, 0, self._high).T for step in (-half, half))
        return np.asarray(summed[r2, c2] - summed[r, c2] - summed[r2, c] + summed[r, c])


def _feature(area: Area, heights: _CornerHeights, frame: MapFrame, sigma_m: float | None) -> dict[str, Any]:
    rings = []
    for ring in area.rings:
        places = wgs84.lonlatheight_from_enu(np.column_stack([ring, heights.at(ring)]), frame)
        rounded = [[round(lon, DEGREES), round(lat, DEGREES), round(height, MILLIMETRES)] for lon, lat, height in places.tolist()]
        rings.append([*rounded, rounded[0]])
    told: dict[str, Any] = {
        "kind": KINDS[area.column],
        "area_m2": round(area.area_m2, MILLIMETRES),
        "confidence": round(area.confidence, MILLIMETRES),
    }
    placed = {} if sigma_m is None else {"sigma_place_m": round(sigma_m, MILLIMETRES)}
    return {"type": "Feature", "geometry": {"type": "Polygon", "coordinates": rings}, "properties": {**told, **placed}}
