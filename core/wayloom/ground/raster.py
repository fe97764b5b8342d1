"""Raster of cells in a sheet's frame."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayloom.ground.sheet import CELL_M

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Raster:
    """corner (2,) int64 column and row of cell [0, 0], whose low corner is at corner * CELL_M; shape: rows and columns."""

    corner: NDArray[np.int64]
    shape: tuple[int, int]

    @property
    def low(self) -> FloatArray:
        """(2,) x and y of the low corner, m."""
        return np.asarray(self.corner * CELL_M, np.float64)

    def window(self, camera_xy: FloatArray, reach_m: float) -> NDArray[np.int64]:
        """(4,) first and last row, first and last column (the last ones not in it) of what is within reach of (2,) x and y."""
        first = np.floor((camera_xy - reach_m) / CELL_M).astype(np.int64) - self.corner
        last = np.ceil((camera_xy + reach_m) / CELL_M).astype(np.int64) - self.corner
        rows, columns = self.shape
        top, bottom = np.clip([first[1], last[1]], 0, rows)
        left, right = np.clip([first[0], last[0]], 0, columns)
        return np.array([top, bottom, left, right], np.int64)


@dataclass(frozen=True, slots=True)
class Cells:
    """What each cell's own samples tell: height (H, W) m, information (H, W) 1/m^2 (0: none), group (H, W) uint8 of `view`."""

    height: FloatArray
    information: FloatArray
    group: NDArray[np.uint8]
