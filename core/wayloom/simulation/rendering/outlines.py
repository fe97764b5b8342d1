"""Instance outlines without holes, as human annotators draw them.

Cityscapes' labelling policy: if background is visible through a foreground object (between spokes, pickets or leaves), it counts as
the object. The rasteriser's ground truth is what the ray through each pixel's centre meets; networks are trained on the annotators'
form.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.simulation.rendering.renderer import Truth

U8 = NDArray[np.uint8]
BRIDGED = np.ones((3, 3), np.uint8)
"""A rim is closed where it is broken by no more than this."""


def without_holes(truth: Truth) -> U8:
    """(h, w) uint8 train ids: holes of an instance that show something farther behind are filled with its class."""
    out = truth.class_id.copy()
    numbers, where = np.unique(truth.instance, return_inverse=True)
    rows, columns = np.indices(truth.instance.shape)
    which = where.ravel()
    low_high = [_ranges(which, at.ravel(), len(numbers)) for at in (rows, columns)]
    depth = np.where(truth.depth > 0, truth.depth, np.inf)
    mean_m = np.bincount(which, truth.depth.ravel()) / np.bincount(which)
    for k in np.argsort(-mean_m, kind="stable"):  # the nearest comes last
        if numbers[k]:
            (top, foot), (left, right) = ((low[k], high[k] + 1) for low, high in low_high)
            box = slice(top, foot), slice(left, right)
            _fill(truth.instance[box] == numbers[k], depth[box], truth.class_id[box], out[box])
    return out


def _ranges(which: NDArray[np.integer], at: NDArray[np.integer], count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Smallest and largest `at` of each of `count` groups."""
    low, high = np.full(count, np.iinfo(np.int64).max), np.full(count, -1)
    np.minimum.at(low, which, at)
    np.maximum.at(high, which, at)
    return low, high


def _fill(mine: NDArray[np.bool_], depth: NDArray[np.floating], class_id: U8, out: U8) -> None:
    """Give `out` the class of one thing where its holes show what lies behind it."""
    mask = np.pad(mine.astype(np.uint8), 1)
    contours, _ = cv2.findContours(cv2.morphologyEx(mask, cv2.MORPH_CLOSE, BRIDGED), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    filled = cv2.drawContours(np.zeros_like(mask), contours, -1, 1, cv2.FILLED)[1:-1, 1:-1]
    holes = (filled > 0) & ~mine
    if not holes.any():
        return
    _, nearest = cv2.distanceTransformWithLabels(
        (~mine).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
    )
    of_label = np.zeros(int(nearest.max()) + 1, np.int64)
    of_label[nearest[mine]] = np.nonzero(mine.ravel())[0]
    source = of_label[nearest[holes]]
    behind = depth[holes] > depth.ravel()[source]
    out[holes] = np.where(behind, class_id.ravel()[source], out[holes])
