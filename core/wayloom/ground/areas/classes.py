"""Classes of a raster of the ground without grain: each cell by the votes around it, small patches given to what surrounds them.

Every step is a function of the cells within `reach_m` of a cell, in whole numbers. So two rasters that both reach that far around a
cell agree on its class.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from wayloom.ground.areas.settings import AreaSettings
from wayloom.ground.sheet import CELL_M

IntArray = NDArray[np.int64]
Classes = NDArray[np.uint8]
WHOLE: Final = 255
"""The share of all votes."""
UNSET: Final = 255
FILL_STEPS: Final = 30
"""How far classes grow into patches that were too small, in cells; beyond, nothing is known."""
PAIRS: Final = (
    ((slice(None, -1), slice(None)), (slice(1, None), slice(None))),
    ((slice(None), slice(None, -1)), (slice(None), slice(1, None))),
)
"""Cells and those beside them, to the north and to the east."""
FOUR: Final = ndimage.generate_binary_structure(2, 1)


def least_cells(settings: AreaSettings) -> int:
    """The cells of the smallest patch."""
    return max(1, round(settings.least_m2 / CELL_M**2))


def reach_m(settings: AreaSettings) -> float:
    """How far away a cell may bear on another's class: a patch that is small is nowhere longer than its cells in one line."""
    return (settings.smooth_cells + least_cells(settings) + FILL_STEPS + 1) * CELL_M


def vote_shares(votes: NDArray[np.uint32]) -> NDArray[np.int64]:
    """(H, W, K) of each class in the votes (H, W, K) of each cell, in WHOLE-ths; 0 of a cell without votes."""
    wide = votes.astype(np.int64)
    return np.asarray(wide * WHOLE // np.maximum(wide.sum(axis=2, keepdims=True), 1))


def area_classes(shares: IntArray, settings: AreaSettings) -> Classes:
    """(H, W) 0 where nothing is known, else 1 + the class (H, W, K) that the cells around vote for, the first of equals."""
    around = _box_sums(shares, settings.smooth_cells)
    classes = np.where(shares.any(axis=2), 1 + np.argmax(around, axis=2), 0).astype(np.uint8)
    numbers, count = patches(classes)
    sizes = np.bincount(numbers.ravel(), minlength=count + 1)
    return _filled(np.where(sizes[numbers] < least_cells(settings), UNSET, classes).astype(np.uint8))


def without_cut_off(classes: Classes, least: int) -> Classes:
    """The classes of a square whose edges have cut off patches of fewer than `least` cells: each takes the class that it borders on
    most, whole, so that classes change along an edge only where they did."""
    numbers, count = patches(classes)
    small = np.bincount(numbers.ravel(), minlength=count + 1) < least
    class_of = np.zeros(count + 1, np.int64)
    class_of[numbers] = classes
    sides = np.concatenate([np.stack([numbers[one].ravel(), numbers[other].ravel()]) for one, other in PAIRS], axis=1)
    sides = np.concatenate([sides, sides[::-1]], axis=1)
    while small.any():
        own, other = sides[:, small[sides[0]] & ~small[sides[1]]]
        shared = np.zeros((count + 1, 4), np.int64)
        np.add.at(shared, (own, class_of[other]), 1)
        taken = shared.any(axis=1)
        if not taken.any():
            class_of[small] = 0
            break
        class_of[taken] = np.argmax(shared[taken], axis=1)
        small &= ~taken
    return class_of[numbers].astype(np.uint8)


def patches(classes: Classes) -> tuple[NDArray[np.int64], int]:
    """Cells of one class, 0 too, that connect by their sides share a number (H, W) from 1 on; and how many numbers there are."""
    numbers, count = np.zeros(classes.shape, np.int64), 0
    for one in np.unique(classes).tolist():
        found, here = ndimage.label(classes == one, FOUR)
        numbers[found > 0] = found[found > 0] + count
        count += here
    return numbers, count


def _box_sums(values: IntArray, half: int) -> IntArray:
    """Sums over the cells (H, W, K) up to `half` around each; nothing lies beyond the raster."""
    for axis in (0, 1):
        padding = [(0, 0)] * 3
        padding[axis] = (half + 1, half)
        summed = np.cumsum(np.pad(values, padding), axis=axis)
        size = values.shape[axis]
        last, first = (np.take(summed, np.arange(size) + shift, axis) for shift in (2 * half + 1, 0))
        values = last - first
    return values


def _filled(classes: Classes) -> Classes:
    """Unset cells take the class that most of their four neighbours have, the first of equals, step by step from outside."""
    for _ in range(FILL_STEPS):
        unset = classes == UNSET
        if not unset.any():
            break
        wide = np.pad(classes, 1, constant_values=UNSET)
        beside = np.stack([wide[:-2, 1:-1], wide[2:, 1:-1], wide[1:-1, :-2], wide[1:-1, 2:]])
        counts = np.stack([(beside == one).sum(axis=0) for one in range(4)])
        taken = unset & (counts.max(axis=0) > 0)
        classes = np.where(taken, np.argmax(counts, axis=0), classes).astype(np.uint8)
    return np.where(classes == UNSET, 0, classes).astype(np.uint8)
