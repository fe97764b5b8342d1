"""Markings and kerbs of a region of the map, found on the merged ground of the region and of what lies around it.

They are a function of the rasters of nine regions, which are functions of the set of sheets: no order of arrival changes a byte.
"""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import VOID
from wayloom.geodesy.map_frame import MapFrame
from wayloom.ground.ground_map import NO_HEIGHT
from wayloom.ground.markings.exports import marking_features
from wayloom.ground.markings.find import find_markings
from wayloom.ground.markings.kerbs import find_kerbs
from wayloom.ground.markings.raster import GroundRaster
from wayloom.ground.markings.settings import KerbSettings, MarkingSettings
from wayloom.ground.markings.squares import kerbs_of_square, markings_of_square
from wayloom.ground.sheet import CELL_M, GROUND_CLASSES, PIXEL_M
from wayloom.stitching.ground_mosaic import GroundOfRegions, RasterSource, mosaic, neighbourhood, place_sigma
from wayloom.stitching.marking_files import AROUND_M, encode_features
from wayloom.stitching.region_grid import REGION_M, RegionKey, region_edges

FloatArray = NDArray[np.float64]


def region_markings(
    key: RegionKey, source: GroundOfRegions, frame: MapFrame, markings: MarkingSettings, kerbs: KerbSettings
) -> bytes | None:
    """The feature collection of a region's own markings and kerbs, as JSON; None where it has none."""
    if source.raster(key, "height_mm") is None:
        return None
    raster, (low, _) = _raster_around(key, source), region_edges(key)
    found = markings_of_square(find_markings(raster, markings), low, REGION_M, AROUND_M)
    steps = kerbs_of_square(find_kerbs(raster, kerbs), low, REGION_M, AROUND_M)
    if not found and not steps:
        return None
    features = marking_features(found, steps, frame, lambda line: place_sigma(line, key, source))
    return encode_features(features)


def _raster_around(key: RegionKey, source: RasterSource) -> GroundRaster:
    """The merged ground of a region and of AROUND_M around it, in the map's frame."""
    keys = [one for one in neighbourhood(key) if source.raster(one, "height_mm") is not None]
    low, high = region_edges(key)
    edges = np.array([low - AROUND_M, high + AROUND_M])

    def raster(name: str, unit_m: float) -> NDArray[Any]:
        first, last = np.rint(edges / unit_m).astype(np.int64)
        return mosaic(keys, source, name, first, last, unit_m)

    height_mm, votes, colour = raster("height_mm", CELL_M), raster("votes", CELL_M), raster("colour", PIXEL_M)
    best = np.asarray(GROUND_CLASSES, np.uint8)[np.argmax(votes, axis=2)]
    grey = colour[..., 0] if colour.shape[2] == 1 else cv2.cvtColor(colour, cv2.COLOR_RGB2GRAY)
    return GroundRaster(
        edges[0],
        np.where(height_mm == NO_HEIGHT, np.nan, height_mm / 1000.0),
        raster("own_sigma_mm", CELL_M) / 1000.0,
        np.where(votes.any(axis=2), best, VOID).astype(np.uint8),
        grey.astype(np.float32),
        raster("sharpness", PIXEL_M),
    )
