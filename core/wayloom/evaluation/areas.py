"""Areas of the ground against those of a simulated city: which class lies where, and how far off the border of two classes is."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from wayloom.ground.areas.find import Area
from wayloom.ground.sheet import CELL_M, GROUND_CLASSES

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Classes = NDArray[np.uint8]
NONE: Final = 255
SAMPLE_M: Final = 0.05
KNOWN_CELLS: Final = 2
"""A place on an outline is judged where the truth is known of all cells so many columns and rows around it."""
FOUND_M: Final = 0.3
"""A true border is found where an outline passes so near."""


@dataclass(frozen=True, slots=True)
class AreaScores:
    """Over the cells whose true class is known, and over borders of a class with others.

    iou      by class id
    covered  share of the cells that areas cover; right: share of these that have their true class, NaN without any
    border_m (B,) m from places on the outlines to the nearest true border
    found    share of the true border that an outline passes within FOUND_M, NaN without a true border
    """

    iou: dict[int, float]
    covered: float
    right: float
    border_m: FloatArray
    found: float


def class_raster(areas: Iterable[Area], corner: IntArray, shape: tuple[int, int]) -> Classes:
    """(H, W) class id of the area in which the middle of each cell of CELL_M lies, NONE without one; corner (2,) column, row."""
    out = np.full(shape, NONE, np.uint8)
    for area in areas:
        places = np.vstack(area.rings) / CELL_M - corner
        box = np.array([np.floor(places.min(axis=0)), np.ceil(places.max(axis=0))]).astype(np.int64).clip(0, shape[::-1])
        (left, low), (right, high) = box
        here = out[low:high, left:right]
        here[_inside(area.rings, corner + box[0], here.shape)] = GROUND_CLASSES[area.column]
    return out


def _inside(rings: Iterable[FloatArray], corner: IntArray, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """(H, W) whether the middle of a cell lies in rings: an odd number of their edges is to the west of it."""
    rows, columns = shape
    flips = np.zeros((rows, columns + 1), np.int64)
    for ring in rings:
        a = ring / CELL_M - corner - 0.5
        b = np.roll(a, -1, axis=0)
        low, high = (np.ceil(one(a[:, 1], b[:, 1])).astype(np.int64).clip(0, rows) for one in (np.minimum, np.maximum))
        edge = np.repeat(np.arange(len(a)), high - low)
        row = np.arange(len(edge)) - np.repeat(np.cumsum(high - low) - (high - low), high - low) + low[edge]
        (x, y), (dx, dy) = a[edge].T, (b - a)[edge].T
        flips_at = np.ceil(x + (row - y) * dx / dy).astype(np.int64).clip(0, columns)
        np.add.at(flips, (row, flips_at), 1)
    return np.asarray(np.cumsum(flips, axis=1)[:, :columns] % 2 == 1)


def score_areas(areas: Sequence[Area], true: Classes, corner: IntArray, first: int, beyond: Sequence[int]) -> AreaScores:
    """Scores of areas by the classes (H, W) of cells, NONE where the truth is not known.

    first, beyond : the border is that of a class id with others
    """
    said = class_raster(areas, corner, true.shape)
    known = true != NONE
    iou = {}
    for class_id in GROUND_CLASSES:
        one, other = known & (said == class_id), true == class_id
        if other.any():
            iou[class_id] = float((one & other).sum() / (one | other).sum())
    both = known & (said != NONE)
    of_cells = _share(both, known), _share(both & (said == true), both)
    border, outline = true_border(true, corner, first, beyond), _between(areas, said, corner, first, beyond)
    outline = outline[_known_around(known, corner, outline)]
    if not len(border) or not len(outline):
        return AreaScores(iou, *of_cells, np.zeros(0), 0.0 if len(border) else np.nan)
    off, _ = cKDTree(border).query(outline)
    back, _ = cKDTree(outline).query(border)
    return AreaScores(iou, *of_cells, np.asarray(off, np.float64), float((back <= FOUND_M).mean()))


def _share(part: NDArray[np.bool_], whole: NDArray[np.bool_]) -> float:
    return float(part.sum() / whole.sum()) if whole.any() else np.nan


def true_border(true: Classes, corner: IntArray, first: int, beyond: Sequence[int]) -> FloatArray:
    """(N, 2) m middles of the edges between cells of a class and of others."""
    parts = []
    for axis in (0, 1):
        a, b = (true[:-1], true[1:]) if axis == 0 else (true[:, :-1], true[:, 1:])
        rows, columns = np.nonzero(((a == first) & np.isin(b, beyond)) | (np.isin(a, beyond) & (b == first)))
        edge = np.column_stack([columns + 0.5, rows + 1.0] if axis == 0 else [columns + 1.0, rows + 0.5])
        parts.append((edge + corner) * CELL_M)
    return np.concatenate(parts)


def _between(areas: Sequence[Area], said: Classes, corner: IntArray, first: int, beyond: Sequence[int]) -> FloatArray:
    """(N, 2) m places on the outlines of areas of a class beyond which an area of another one lies."""
    out = [np.zeros((0, 2))]
    for ring in (ring for area in areas if GROUND_CLASSES[area.column] == first for ring in area.rings):
        closed = np.vstack([ring, ring[:1]])
        step = np.diff(closed, axis=0)
        length = np.linalg.norm(step, axis=1)
        count = np.maximum(np.ceil(length / SAMPLE_M).astype(np.int64), 1)
        share = (np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count) + 0.5) / np.repeat(count, count)
        places = np.repeat(ring, count, axis=0) + share[:, None] * np.repeat(step, count, axis=0)
        normal = np.column_stack([step[:, 1], -step[:, 0]]) / np.maximum(length, 1e-9)[:, None]  # out of a ring as areas have them
        outside = places + CELL_M * np.repeat(normal, count, axis=0)
        out.append(places[np.isin(_class_at(said, corner, outside), beyond)])
    return np.concatenate(out)


def _class_at(classes: Classes, corner: IntArray, places: FloatArray) -> Classes:
    at = np.floor(places / CELL_M).astype(np.int64) - corner
    inside = (at >= 0).all(axis=1) & (at[:, 0] < classes.shape[1]) & (at[:, 1] < classes.shape[0])
    out = np.full(len(places), NONE, np.uint8)
    out[inside] = classes[at[inside, 1], at[inside, 0]]
    return out


def _known_around(known: NDArray[np.bool_], corner: IntArray, places: FloatArray) -> NDArray[np.bool_]:
    """Whether the truth is known KNOWN_CELLS around each of places."""
    size = 2 * KNOWN_CELLS + 1
    around = cv2.erode(known.astype(np.uint8), np.ones((size, size), np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=0)
    return np.asarray(_class_at(np.where(around > 0, 1, NONE).astype(np.uint8), corner, places) == 1)
