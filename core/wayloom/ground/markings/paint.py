"""Pixels of paint: what is brighter than the road on both its sides, over the widths of markings and whatever the light."""

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_ID
from wayloom.ground.kernels import lines
from wayloom.ground.markings.raster import GroundRaster
from wayloom.ground.markings.settings import MarkingSettings
from wayloom.ground.sheet import PIXEL_M

FloatArray = NDArray[np.float64]
DIRECTIONS: Final = 8
OFFSETS_M: Final = (0.20, 0.35, 0.50, 0.65)
"""To the road beside a marking: each is beyond the other edge of all markings that are narrower."""
DARK: Final = 8.0
"""Grey levels that keep shares finite in the dark."""
HALF_ALONG_PX: Final = 4
AROUND_M: Final = 1.6
"""The window of the road's own brightness."""
BRIGHTER: Final = 1.04
NEARBY_PX, SHARE_OF_STRONGEST = 11, 0.35
"""What has less than this share of the contrast that is so near is that paint's blur or the road's grain."""
GRAIN_PX, GRAIN_WINDOW_M, MOST_GRAIN = 13, 3.0, 0.2
ROAD_MARGIN_CELLS: Final = 2
MOST_TURN_RAD: Final = np.radians(25.0)
ROAD: Final = CLASS_ID["road"]


@dataclass(frozen=True)
class Paint:
    """Pixels (R, C) of paint.

    contrast  share by which they are brighter than both sides, mean along the line; 0 where there is none
    angle     direction across the line, rad from x towards y, modulo pi
    group     number of connected pixels of like direction, 0 none
    whole     number of connected pixels whatever their direction, 0 none
    facts     (N, 5) of each of these numbers: low column and row, width, height and area, px
    seen      whether the ground is seen sharply enough
    grain     mean deviation of the ground's brightness within some metres, as a share of it
    """

    contrast: NDArray[np.float32]
    angle: NDArray[np.float32]
    group: NDArray[np.int32]
    whole: NDArray[np.int32]
    facts: NDArray[np.int32]
    seen: NDArray[np.bool_]
    grain: NDArray[np.float32]


def find_paint(raster: GroundRaster, settings: MarkingSettings) -> Paint:
    """The pixels of paint on the road and its border."""
    seen = raster.sharpness >= settings.least_sharpness
    smooth = _mean(raster.grey, seen, 3)
    candidate = (_near_road(raster) & seen & (smooth > BRIGHTER * _mean(raster.grey, seen, round(AROUND_M / PIXEL_M) | 1))).astype(
        np.uint8
    )
    shape = raster.grey.shape
    theta = np.arange(DIRECTIONS) * np.pi / DIRECTIONS
    normals = np.column_stack([np.cos(theta), np.sin(theta)])
    by_direction = np.zeros((DIRECTIONS, *shape), np.float32)
    lines.side_contrast(smooth, seen.view(np.uint8), candidate, normals, np.array(OFFSETS_M) / PIXEL_M, DARK, by_direction)
    contrast, angle = np.empty(shape, np.float32), np.empty(shape, np.float32)
    lines.along_mean(by_direction, candidate, normals, HALF_ALONG_PX, contrast, angle)
    strongest = cv2.dilate(contrast, np.ones((NEARBY_PX, NEARBY_PX), np.uint8))
    contrast[contrast < SHARE_OF_STRONGEST * strongest] = 0.0
    group = np.empty(shape, np.int32)
    lines.like_directions(contrast, angle, settings.edge_contrast, MOST_TURN_RAD, group, np.empty(contrast.size, np.int32))
    _, whole, facts, _ = cv2.connectedComponentsWithStats((contrast > settings.edge_contrast).astype(np.uint8), connectivity=8)
    return Paint(contrast, angle, group, whole.astype(np.int32), facts.astype(np.int32), seen, _grain(smooth, raster.grey, seen))


def _grain(smooth: NDArray[np.float32], grey: NDArray[np.float32], seen: NDArray[np.bool_]) -> NDArray[np.float32]:
    """(R, C) mean deviation of the brightness from its surroundings, as a share of it, paint counted as coarse grain."""
    base = _mean(grey, seen, GRAIN_PX)
    share = np.minimum(np.abs(smooth - base) / (base + DARK), MOST_GRAIN).astype(np.float32)
    return _mean(share, seen, round(GRAIN_WINDOW_M / PIXEL_M) | 1)


def _near_road(raster: GroundRaster) -> NDArray[np.bool_]:
    """(2H, 2W) the road and what is within a margin of it."""
    kernel = np.ones((2 * ROAD_MARGIN_CELLS + 1,) * 2, np.uint8)
    road = cv2.dilate((raster.label == ROAD).astype(np.uint8), kernel)
    return np.repeat(np.repeat(road, 2, axis=0), 2, axis=1).astype(bool)


def _mean(grey: NDArray[np.float32], seen: NDArray[np.bool_], edge: int) -> NDArray[np.float32]:
    """Mean over the seen pixels of a square; 0 where there are none."""
    window, around = (edge, edge), cv2.BORDER_CONSTANT
    weight = cv2.boxFilter(seen.astype(np.float32), -1, window, normalize=False, borderType=around)
    total = cv2.boxFilter(np.where(seen, grey, np.float32(0)), -1, window, normalize=False, borderType=around)
    mean = np.asarray(total / np.maximum(weight, np.float32(1)), np.float32)
    mean[weight <= 0.5] = 0
    return mean
