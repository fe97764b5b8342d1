"""Selection of candidate points: pixels of high gradient, spread over the image, where no point is yet."""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.odometry.kernels.images import block_medians, gradient_size
from wayloom.odometry.kernels.selection import TAKEN_CELL, select_pixels

CAPACITY = 20000


def gradient_thresholds(size: NDArray[np.float32], block: int, margin: float) -> NDArray[np.float32]:
    """One threshold a block of gradient size (h, w): its median + margin, averaged over the 3x3 blocks around it."""
    raw = block_medians(size, block) + np.float32(margin)
    total, count = (cv2.boxFilter(a, -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT) for a in (raw, np.ones_like(raw)))
    return np.asarray(total / count, np.float32)


def taken_places(shape: tuple[int, ...], uv: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which 8x8 px of an image (h, w) hold one of the points uv (N, 2) px."""
    taken = np.zeros((shape[0] // TAKEN_CELL + 1, shape[1] // TAKEN_CELL + 1), np.bool_)
    column, row = (uv / TAKEN_CELL).astype(int).T
    taken[row, column] = True
    return taken


def first_cell(shape: tuple[int, ...], candidates: int) -> float:
    """Cell size in px that gives about `candidates` pixels in a well textured image (h, w)."""
    return math.sqrt(shape[0] * shape[1] / candidates)


def select_candidates(
    image: NDArray[np.uint8], uv_taken: NDArray[np.float64], cell: int, block: int, margin: float, border: int
) -> NDArray[np.int64]:
    """Candidate pixels (n, 2) of an image (h, w), in row order of cells; none where uv_taken (N, 2) px already are."""
    size = gradient_size(image)
    points = np.empty((CAPACITY, 2), np.int64)
    taken = taken_places(image.shape, uv_taken)
    return points[: select_pixels(size, gradient_thresholds(size, block, margin), block, cell, border, taken, points)]


def spread_sample(pixels: NDArray[np.int64], count: int, seed: int = 0) -> NDArray[np.int64]:
    """Indices of at most `count` of the pixels (n, 2), spread at random but always the same way for a seed, increasing."""
    if len(pixels) <= count:
        return np.arange(len(pixels))
    u, v = pixels.astype(np.uint64).T
    salt = np.uint64(0x165667B19E3779F9 * seed & 2**64 - 1)
    mixed = (u * np.uint64(0x9E3779B97F4A7C15)) ^ (v * np.uint64(0xC2B2AE3D27D4EB4F)) ^ salt
    mixed = (mixed ^ (mixed >> np.uint64(29))) * np.uint64(0xBF58476D1CE4E5B9)
    mixed ^= mixed >> np.uint64(32)
    first = np.flatnonzero(mixed <= np.partition(mixed, count - 1)[count - 1]) if count else np.zeros(0, np.int64)
    return first if len(first) == count else np.sort(np.argsort(mixed, kind="stable")[:count])


def next_cell(cell: float, matched: int, wanted: int) -> float:
    """Cell size in px for the next keyframe, so that about 1.3 times the wanted points are matched; changes slowly, 3 to 40 px."""
    return float(np.clip(cell * np.clip(math.sqrt(matched / (1.3 * wanted)), 0.8, 1.25), 3.0, 40.0))
