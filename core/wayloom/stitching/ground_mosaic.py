"""Rasters of the ground over the borders of regions."""

from collections.abc import Collection
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from wayloom.ground.ground_map import NO_HEIGHT
from wayloom.stitching.region_grid import REGION_M, RegionKey


class RasterSource(Protocol):
    """The ground of regions."""

    def raster(self, key: RegionKey, name: str) -> NDArray[Any] | None:
        """A raster of `GroundMap`, by its name; None where the region has no ground."""


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
