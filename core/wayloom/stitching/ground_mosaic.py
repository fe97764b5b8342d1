"""Rasters of the ground over the borders of regions, and how sure their places are."""

from collections.abc import Collection
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from wayloom.ground.ground_map import LARGEST_SIGMA_MM, NO_HEIGHT
from wayloom.ground.sheet import PIXEL_M
from wayloom.stitching.region_grid import REGION_M, RegionKey, region_edges

FloatArray = NDArray[np.float64]


class RasterSource(Protocol):
    """The ground of regions."""

    def raster(self, key: RegionKey, name: str) -> NDArray[Any] | None:
        """A raster of `GroundMap`, by its name; None where the region has no ground."""


class GroundOfRegions(RasterSource, Protocol):
    """The ground of regions with the sigmas of its places."""

    def place_sigma_mm(self, key: RegionKey) -> NDArray[np.uint16]:
        """(S,) of the sheets of a region, as `GroundMap.place_sigma_mm`."""


def neighbourhood(key: RegionKey) -> list[RegionKey]:
    """The regions that bear on a region's markings and areas: itself and those around it, sorted."""
    return [(key[0] + east, key[1] + north) for east in (-1, 0, 1) for north in (-1, 0, 1)]


def mosaic(
    keys: Collection[RegionKey], source: RasterSource, name: str, low: NDArray[np.int64], high: NDArray[np.int64], unit_m: float
) -> NDArray[Any]:
    """A raster of several regions from low to high (2,), columns and rows of the map's grid of this unit: at least one has it."""
    edge, out = round(REGION_M / unit_m), None
    for key in keys:
        raster = source.raster(key, name)
        if raster is None:
            continue
        if out is None:
            shape = (high[1] - low[1], high[0] - low[0], *raster.shape[2:])
            out = np.full(shape, NO_HEIGHT if name == "height_mm" else 0, raster.dtype)
        if raster.ndim == 3 and raster.shape[2] > out.shape[2]:
            out = np.repeat(out, raster.shape[2], axis=2)
        first = np.array(key) * edge
        start, end = np.maximum(low, first), np.minimum(high, first + edge)
        if (start < end).all():
            (c, r), (c2, r2), (a, b), (a2, b2) = start - first, end - first, start - low, end - low
            out[b:b2, a:a2] = raster[r:r2, c:c2]
    assert out is not None
    return out


def place_sigma(line: FloatArray, key: RegionKey, source: GroundOfRegions) -> float | None:
    """m: the greatest of the sheets that show the line's vertices, or of all of the region's where none does."""
    sigmas, shown = source.place_sigma_mm(key), source.raster(key, "shown")
    assert shown is not None
    at = np.clip(np.floor((line[:, :2] - region_edges(key)[0]) / PIXEL_M).astype(np.int64), 0, len(shown) - 1)
    numbers = shown[at[:, 1], at[:, 0]]
    numbers = numbers[numbers > 0]
    worst = int((sigmas[numbers - 1] if len(numbers) else sigmas).max())
    return None if worst == LARGEST_SIGMA_MM else worst / 1000.0
