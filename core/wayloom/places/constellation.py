"""Constellation of a place: poles, signs and lights around it as single upright things, and how two of them fit each other.

An upright thing is a cluster of points of these kinds over a small piece of ground; it is seen alike from both directions.
"""

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_COUNT, CLASS_ID
from wayloom.places.birds_eye import ground_height
from wayloom.places.types import PlaceView

FloatArray = NDArray[np.float64]
UPRIGHT: Final = tuple(CLASS_ID[name] for name in ("pole", "traffic light", "traffic sign"))
REACH_M: Final = 32.0
"""Things further away along or across are left out."""
CELL_M: Final = 0.5
"""Points in cells that touch are of one thing."""
LEAST_POINTS: Final = 6
WIDEST_M: Final = 2.5
"""What is wider is no single thing."""
SIGMA_FLOOR_M: Final = 0.1
LEAST_HEIGHT_M: Final = 1.0


@dataclass(frozen=True, slots=True)
class Constellation:
    """Upright things, M of them, in the level frame of their view.

    label     (M,) uint8 train id that most of the points have
    xy        (M, 2) m
    height_m  (M,) of the uppermost point above the ground
    sigma_m   (M,) of the place
    """

    label: NDArray[np.uint8]
    xy: FloatArray
    height_m: FloatArray
    sigma_m: FloatArray

    def __len__(self) -> int:
        return len(self.label)


def constellation(view: PlaceView) -> Constellation:
    """The upright things of a view, in the order of their cells."""
    near = np.isin(view.label, UPRIGHT) & (np.abs(view.xyz[:, :2]) < REACH_M).all(axis=1)
    xyz, label, sigma = view.xyz[near].astype(np.float64), view.label[near], view.sigma_m[near].astype(np.float64)
    cell = np.floor((xyz[:, :2] + REACH_M) / CELL_M).astype(np.int64)
    raster = np.zeros((int(2 * REACH_M / CELL_M),) * 2, np.uint8)
    raster[cell[:, 0], cell[:, 1]] = 1
    of = np.asarray(cv2.connectedComponents(raster, connectivity=8)[1])[cell[:, 0], cell[:, 1]]
    ground, found = ground_height(view), []
    for thing in np.unique(of):
        rows = np.flatnonzero(of == thing)
        height = float(xyz[rows, 2].max() - ground)
        if len(rows) >= LEAST_POINTS and np.ptp(xyz[rows, :2], axis=0).max() <= WIDEST_M and height > LEAST_HEIGHT_M:
            weight = 1.0 / sigma[rows] ** 2
            xy = weight @ xyz[rows, :2] / weight.sum()
            spread = np.sqrt(weight @ ((xyz[rows, :2] - xy) ** 2).sum(axis=1) / weight.sum() / len(rows))
            found.append((np.bincount(label[rows], minlength=CLASS_COUNT).argmax(), *xy, height, np.hypot(SIGMA_FLOOR_M, spread)))
    table = np.array(found, np.float64).reshape(-1, 5)
    return Constellation(table[:, 0].astype(np.uint8), table[:, 1:3], table[:, 3], table[:, 4])
