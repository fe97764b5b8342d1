"""Drawn rasters of flat ground: asphalt with paint, shadows and kerbs in known places."""

from dataclasses import replace

import cv2
import numpy as np

from wayloom.config.classes import CLASS_ID
from wayloom.ground.markings.raster import GroundRaster
from wayloom.ground.sheet import CELL_M, PIXEL_M

ROAD, SIDEWALK = CLASS_ID["road"], CLASS_ID["sidewalk"]
FINE = 4
ASPHALT, PAINT = 90.0, 190.0


def asphalt(width_m: float = 30.0, height_m: float = 12.0) -> np.ndarray:
    """Grey of bare road at PIXEL_M / FINE."""
    return np.full((round(height_m / PIXEL_M) * FINE, round(width_m / PIXEL_M) * FINE), ASPHALT, np.float32)


def paint(fine: np.ndarray, ring: np.ndarray, grey: float = PAINT) -> None:
    """Fill a polygon (N, 2) m."""
    cv2.fillPoly(fine, [np.rint((np.asarray(ring) / PIXEL_M * FINE - 0.5) * 256).astype(np.int32)], grey, cv2.LINE_8, 8)


def bar(x: float, y: float, length: float, width: float, angle: float = 0.0) -> np.ndarray:
    """Corners of a rectangle about (x, y) m."""
    d, n = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    return np.array([(x, y) + a * d * length / 2 + b * n * width / 2 for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))])


def raster(fine: np.ndarray, blur_px: float = 0.6, noise: float = 1.5, sharpness: int = 30) -> GroundRaster:
    """What the detector is given: pixels, blurred and noisy, all road, flat."""
    rows, columns = np.array(fine.shape) // FINE
    grey = cv2.resize(fine, (int(columns), int(rows)), interpolation=cv2.INTER_AREA)
    grey = cv2.GaussianBlur(grey, (0, 0), blur_px) + np.random.default_rng(0).normal(0, noise, grey.shape).astype(np.float32)
    cells = (int(rows) // 2, int(columns) // 2)
    return GroundRaster(
        np.zeros(2), np.zeros(cells), np.full(cells, 0.005), np.full(cells, ROAD, np.uint8), grey.astype(np.float32),
        np.full(grey.shape, sharpness, np.uint8),
    )  # fmt: skip


def hidden(ground: GroundRaster, low: tuple[float, float], high: tuple[float, float]) -> GroundRaster:
    """The raster with nothing seen in a rectangle, m."""
    sharpness = ground.sharpness.copy()
    (x0, y0), (x1, y1) = (np.round(np.array(p) / PIXEL_M).astype(int) for p in (low, high))
    sharpness[y0:y1, x0:x1] = 0
    return replace(ground, sharpness=sharpness, grey=np.where(sharpness > 0, ground.grey, 0).astype(np.float32))


def kerbed(height_m: float, at_y: float, label_at_y: float, noise_m: float = 0.0, slope: float = 0.02) -> GroundRaster:
    """A road that slopes across, with a sidewalk height_m higher from at_y m on, labelled so from label_at_y on."""
    ground = raster(asphalt())
    y = (np.arange(ground.height.shape[0]) + 0.5) * CELL_M
    height = np.where(y > at_y, height_m, 0.0)[:, None] + slope * y[:, None] + np.zeros(ground.height.shape)
    height += np.random.default_rng(1).normal(0, noise_m, height.shape) if noise_m else 0.0
    label = np.where(y > label_at_y, SIDEWALK, ROAD).astype(np.uint8)[:, None] + np.zeros(height.shape, np.uint8)
    return replace(ground, height=height, label=label)
