"""Outlines, heights, sigmas and confidence of markings."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.ground.markings.bars import Bar
from wayloom.ground.markings.raster import GroundRaster
from wayloom.ground.markings.settings import MarkingSettings
from wayloom.ground.sheet import PIXEL_M

FloatArray = NDArray[np.float64]
EVIDENCE: Final = (-17.3, 3.5, 2.7, -0.9, 5.7)
"""Log-odds of paint: 1, log(contrast / grain), log(length / width), log(raggedness / width), share filled; fitted on made sheets
(docs/markings.md)."""
ROW_EVIDENCE: Final = 1.5
"""And for each of up to two probable pieces in one line with it."""


def confidence(bar: Bar) -> float:
    """Probability that a straight piece is paint."""
    width = max(bar.width_px, 1.0)
    ratios = (bar.contrast / max(bar.grain, 0.01), max(bar.length_px / width, 0.5), (bar.ragged_px + 0.15) / width)
    odds = EVIDENCE[0] + float(np.dot(EVIDENCE[1:4], np.log(ratios))) + EVIDENCE[4] * bar.filled + ROW_EVIDENCE * bar.rows
    return float(1 / (1 + np.exp(-np.clip(odds, -30.0, 30.0))))


def outline(xy: FloatArray, width: float) -> FloatArray:
    """(2 N + 1, 2) closed, counter-clockwise: the band of that width along a line (N, 2)."""
    step = np.diff(xy, axis=0)
    step = step / np.maximum(np.linalg.norm(step, axis=1, keepdims=True), 1e-9)
    d = np.vstack([step[:1], step[:-1] + step[1:], step[-1:]])
    d = d / np.maximum(np.linalg.norm(d, axis=1, keepdims=True), 1e-9)
    left = np.column_stack([-d[:, 1], d[:, 0]]) * width / 2
    ring = np.vstack([xy - left, (xy + left)[::-1]])
    return np.vstack([ring, ring[:1]])


def band(line: FloatArray, width: float) -> FloatArray:
    """(2 N + 1, 3) the outline of a line (N, 3), at its heights."""
    z = np.concatenate([line[:, 2], line[::-1, 2], line[:1, 2]])
    return np.column_stack([outline(line[:, :2], width), z])


def inside(ring: FloatArray, places: FloatArray) -> NDArray[np.bool_]:
    """(S,) whether places (S, 2) lie in a closed ring (M, 2 or 3): even-odd rule."""
    x, y = places[:, :1], places[:, 1:2]
    x0, y0, x1, y1 = *ring[:-1, :2].T, *ring[1:, :2].T
    crosses = (y0 > y) != (y1 > y)
    at = x0 + (y - y0) * (x1 - x0) / np.where(y1 == y0, 1.0, y1 - y0)
    return np.asarray((crosses & (x < at)).sum(axis=1) % 2 == 1)


def total_sigma(sigma_px: FloatArray, xy: FloatArray, raster: GroundRaster, settings: MarkingSettings) -> FloatArray:
    """(3,) m across, along, of the width: that in the picture, and the picture's own by the heights that it was laid on."""
    known = raster.sigma(xy)
    moved = settings.view_slope * (float(np.nanmedian(known)) if np.isfinite(known).any() else 0.0)
    across, along, width = (np.asarray(sigma_px, np.float64) * PIXEL_M).tolist()
    return np.array([np.hypot(across, moved), np.hypot(along, moved), width])


def lifted(xy: FloatArray, raster: GroundRaster) -> FloatArray:
    """(N, 3) on the surface; where it is not known at the mean of what is."""
    z = raster.z(xy)
    return np.column_stack([xy, np.where(np.isfinite(z), z, np.nanmean(z) if np.isfinite(z).any() else 0.0)])
