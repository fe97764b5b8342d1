"""Borders between the road and what lies beside it, on rasters of cells: stations with normals."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.ground.sheet import CELL_M

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
STATION_CELLS: Final = 2.5
"""Stations are so far apart along a border."""
SMOOTH_CELLS: Final = 5
"""Half the window over which the border of the cells is smoothed."""
SIDE_M: Final = (0.1, 0.2, 0.3, 0.4)
BREAK_STATIONS: Final = 4


@dataclass(frozen=True, slots=True)
class Border:
    """Stations along a border of the road: places (S, 2) column and row of cells, normals (S, 2) away from the road."""

    places: FloatArray
    normals: FloatArray


def borders_of(road: BoolArray, beside: BoolArray) -> Iterator[Border]:
    """The borders between cells (H, W) that are road and others that lie beside it, with stations STATION_CELLS apart."""
    kernel = np.ones((3, 3), np.uint8)
    closed = cv2.morphologyEx(road.astype(np.uint8), cv2.MORPH_CLOSE, kernel)
    contours, _ = cv2.findContours(cv2.morphologyEx(closed, cv2.MORPH_OPEN, kernel), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    for contour in contours:
        places = contour[:, 0].astype(np.float64)
        if len(places) < 4 * SMOOTH_CELLS:
            continue
        window = np.hanning(2 * SMOOTH_CELLS + 3)[1:-1]
        padded = np.vstack([places[-SMOOTH_CELLS:], places, places[:SMOOTH_CELLS]])
        smooth = np.column_stack([np.convolve(padded[:, k], window / window.sum(), "valid") for k in (0, 1)])
        stations = _spaced(smooth)
        if len(stations) < 8:
            continue
        d = np.roll(stations, -2, axis=0) - np.roll(stations, 2, axis=0)
        normals = np.column_stack([d[:, 1], -d[:, 0]]) / np.maximum(np.linalg.norm(d, axis=1, keepdims=True), 1e-9)
        yield from _beside(road, beside, stations, normals)


def runs(keep: BoolArray, most_gap: int) -> list[tuple[int, int]]:
    """(first, last + 1) of stretches of what is kept; gaps of up to most_gap are bridged."""
    at = np.flatnonzero(keep)
    if not len(at):
        return []
    cuts = np.flatnonzero(np.diff(at) > most_gap + 1)
    return [(int(a[0]), int(a[-1]) + 1) for a in np.split(at, cuts + 1)]


def _spaced(loop: FloatArray) -> FloatArray:
    """(S, 2) places STATION_CELLS apart along a closed loop (N, 2)."""
    closed = np.vstack([loop, loop[:1]])
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    at = np.arange(0.0, s[-1], STATION_CELLS)
    return np.column_stack([np.interp(at, s, closed[:, k]) for k in (0, 1)])


def _beside(road: BoolArray, beside: BoolArray, stations: FloatArray, normals: FloatArray) -> list[Border]:
    """The stretches of a loop with road on one side and what is beside it on the other; normals are turned away from the road."""
    sides = np.array([_near(beside, stations, sign * normals) for sign in (1.0, -1.0)])
    roads = np.array([_near(road, stations, -sign * normals) for sign in (1.0, -1.0)])
    good = sides & roads
    way = np.where(good[0].sum() >= good[1].sum(), 1.0, -1.0)
    keep = good[0] if way > 0 else good[1]
    if keep.all():
        return [Border(stations, way * normals)]
    first = int(np.flatnonzero(~keep)[0])  # a loop is cut where there is no border
    order = np.r_[first : len(keep), 0:first]
    return [Border(stations[order[a:b]], way * normals[order[a:b]]) for a, b in runs(keep[order], BREAK_STATIONS)]


def _near(there: NDArray[Any], stations: FloatArray, normals: FloatArray) -> BoolArray:
    """(S,) whether a cell that is there (H, W) lies a little along the normals."""
    rows, columns = there.shape
    found = np.zeros(len(stations), bool)
    for distance in SIDE_M:
        at = np.rint(stations + normals * distance / CELL_M).astype(np.int64)
        inside = (at[:, 0] >= 0) & (at[:, 1] >= 0) & (at[:, 0] < columns) & (at[:, 1] < rows)
        found[inside] |= there[at[inside, 1], at[inside, 0]]
    return found
