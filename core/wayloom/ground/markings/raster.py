"""Raster of the ground in the plane: what markings and kerbs are found on, of a drive's sheet or of a merged map."""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.ground.sheet import CELL_M, PIXEL_M, GroundSheet

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class GroundRaster:
    """H x W cells of CELL_M, each of 2 x 2 pixels of PIXEL_M; indexed [row, column] along y and x, cell [0, 0] at the low corner.

    corner_m   (2,) x and y of the low corner of cell [0, 0], in the raster's frame, whose z is up
    height     (H, W) m, NaN where there is no surface
    sigma_m    (H, W) its sigma
    label      (H, W) uint8 train id, 255 without
    grey       (2H, 2W) float32 brightness, 0 to 255
    sharpness  (2H, 2W) uint8 image pixels a metre, 0 where nothing was seen
    """

    corner_m: FloatArray
    height: FloatArray
    sigma_m: FloatArray
    label: NDArray[np.uint8]
    grey: NDArray[np.float32]
    sharpness: NDArray[np.uint8]

    def xy(self, places_px: FloatArray) -> FloatArray:
        """(…, 2) m of places (…, 2) column and row in pixels, pixel centres at whole numbers."""
        return np.asarray(self.corner_m + (places_px + 0.5) * PIXEL_M)

    def z(self, xy: FloatArray) -> FloatArray:
        """(N,) m of the surface at xy (N, 2), bilinear over the cells that have one; NaN where none of the four has."""
        return _weighted(self.height, (xy - self.corner_m) / CELL_M - 0.5)

    def sigma(self, xy: FloatArray) -> FloatArray:
        """(N,) m sigma of the height at xy (N, 2); NaN where there is no surface."""
        return _weighted(self._known_sigma, (xy - self.corner_m) / CELL_M - 0.5)

    @cached_property
    def _known_sigma(self) -> FloatArray:
        return np.where(np.isfinite(self.height), self.sigma_m, np.nan)


def raster_of_sheet(sheet: GroundSheet) -> GroundRaster:
    """A drive's sheet in its own frame."""
    colour = np.ascontiguousarray(sheet.colour)
    grey = colour[..., 0] if colour.shape[2] == 1 else cv2.cvtColor(colour, cv2.COLOR_RGB2GRAY)
    return GroundRaster(
        sheet.corner_m, sheet.height, sheet.sigma_mm / 1000.0, sheet.label, grey.astype(np.float32), sheet.sharpness
    )


def _weighted(raster: FloatArray, places: FloatArray) -> FloatArray:
    """(N,) bilinear mean of the finite neighbours of places (N, 2) column and row."""
    base = np.floor(places).astype(np.int64)
    part = places - base
    total, weight = np.zeros(len(places)), np.zeros(len(places))
    for dx in (0, 1):
        for dy in (0, 1):
            x, y = base[:, 0] + dx, base[:, 1] + dy
            inside = (x >= 0) & (y >= 0) & (x < raster.shape[1]) & (y < raster.shape[0])
            value = np.full(len(places), np.nan)
            value[inside] = raster[y[inside], x[inside]]
            w = np.where(dx, part[:, 0], 1 - part[:, 0]) * np.where(dy, part[:, 1], 1 - part[:, 1])
            w = np.where(np.isfinite(value), np.maximum(w, 1e-9), 0.0)
            total += w * np.nan_to_num(value)
            weight += w
    return np.asarray(np.where(weight > 0, total / np.where(weight > 0, weight, 1.0), np.nan))
