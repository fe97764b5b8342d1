"""Height of the ground under a thing, by the sheet of its submap; what stands on the ground hides its own cell."""

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.ground.sheet import CELL_M, NO_HEIGHT, GroundSheet

FloatArray = NDArray[np.float64]
FURTHEST_M = 2.5
"""Ground further away tells nothing of what is under a thing."""


class GroundHeight:
    """Nearest known height of a sheet's ground; in the level frame, which is the sheet's."""

    def __init__(self, sheet: GroundSheet | None) -> None:
        self._sheet = sheet
        if sheet is not None and (sheet.height_mm != NO_HEIGHT).any():
            unknown = (sheet.height_mm == NO_HEIGHT).astype(np.uint8)
            away, label = cv2.distanceTransformWithLabels(unknown, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
            rows, columns = np.nonzero(unknown == 0)
            height = np.zeros(int(label.max()) + 1)
            height[label[rows, columns]] = sheet.height_mm[rows, columns] / 1000.0
            self._height, self._away = height[label], away * CELL_M
        else:
            self._sheet = None

    def at(self, xy: FloatArray) -> float:
        """Height at (2,) m; NaN where no ground is known within FURTHEST_M."""
        if self._sheet is None:
            return np.nan
        column, row = np.floor(xy / CELL_M).astype(np.int64) - self._sheet.corner
        rows, columns = self._height.shape
        r, c = min(max(row, 0), rows - 1), min(max(column, 0), columns - 1)
        away = self._away[r, c] + CELL_M * np.hypot(row - r, column - c)
        return float(self._height[r, c]) if away <= FURTHEST_M else np.nan
