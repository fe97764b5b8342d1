"""Raster of looks of a drive: how far the view of each keyframe is free, by columns of its image."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import SKY
from wayloom.objects.kernels.looked import mark_looked
from wayloom.objects.types import CELL_M
from wayloom.objects.view import NEAREST_M, ObjectView

FloatArray = NDArray[np.float64]
COLUMN_PX, HEIGHT_PX = 12, 10
ROWS: Final = (0.05, -0.03, -0.1)
"""Under the horizon, in focal lengths: at 15 m, a camera 1.65 m high sees 0.9 to 3.2 m over the ground there."""


class LookedRaster:
    """Counts of keyframes by cell, in the level frame."""

    def __init__(self, cameras_xy: FloatArray, reach_m: float) -> None:
        low = np.floor((cameras_xy.min(axis=0) - reach_m) / CELL_M).astype(np.int64)
        high = np.ceil((cameras_xy.max(axis=0) + reach_m) / CELL_M).astype(np.int64)
        self.corner, self.reach_m = low, reach_m
        self.looked = np.zeros((int(high[1] - low[1]), int(high[0] - low[0])), np.uint8)
        self._mark = np.full(self.looked.shape, -1, np.int32)

    def add(self, view: ObjectView, number: int) -> None:
        """Count the cells that the view went through; `number` is its own."""
        columns = np.arange(0, view.label.shape[1] - COLUMN_PX + 1, COLUMN_PX)
        depth = np.sort([self._free(view, columns, row) for row in ROWS], axis=0)[1]
        rays = view.rays(columns + 0.5 * (COLUMN_PX - 1), np.full(len(columns), view.rig.camera.cy))
        xy = np.ascontiguousarray((rays @ view.T_level_cam[:3, :3].T)[:, :2])
        camera = np.ascontiguousarray(view.T_level_cam[:2, 3])
        mark_looked(camera, xy, depth, NEAREST_M, CELL_M, self.corner, self.looked, self._mark, number)

    def _free(self, view: ObjectView, columns: NDArray[np.int64], row: float) -> FloatArray:
        """(n,) m to which patches of a row of patches are free; 0 where it is not known."""
        v0 = round(view.rig.camera.cy + row * view.rig.camera.fy - 0.5 * HEIGHT_PX)
        v0 = min(max(v0, 0), view.label.shape[0] - HEIGHT_PX)
        n = len(columns)
        d, _ = view.match(np.column_stack([columns, np.full(n, v0), columns + COLUMN_PX, np.full(n, v0 + HEIGHT_PX)]))
        sky = view.label[v0 + HEIGHT_PX // 2, columns + COLUMN_PX // 2] == SKY
        least = view.rig.bf / self.reach_m
        depth = np.where(np.isnan(d), 0.0, view.rig.bf / np.maximum(np.nan_to_num(d), least))
        return np.where(sky, self.reach_m, depth)
