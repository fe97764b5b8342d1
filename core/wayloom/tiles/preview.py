"""Top-down preview picture of the map, with a scale bar and a north arrow."""

import itertools
from collections.abc import Sequence
from typing import TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import PALETTE_WITH_VOID

FloatArray = NDArray[np.float64]
Blocks: TypeAlias = Sequence[tuple[FloatArray, NDArray[np.uint8]]]
"""Points (n, 3) m and their labels (n,), part by part; they are gone through more than once."""
Picture = NDArray[np.uint8]
PAPER, INK = (250, 250, 248), (40, 40, 40)
TRACK = (220, 30, 30)
MARGIN_PX = 40
FONT = cv2.FONT_HERSHEY_SIMPLEX


def top_down(
    blocks: Blocks,
    resolution_m: float | None = None,
    *,
    tracks_enu: tuple[FloatArray, ...] = (),
    max_size_px: int = 1600,
    dot_px: int = 2,
    north_up: bool = True,
) -> Picture:
    """(h, w, 3) RGB: points in the colours of their classes, the higher over the lower, tracks as lines.

    blocks : points, with NaN left out, and train ids; a block at a time is in memory
    resolution_m : m a pixel; None takes the finest that stays within max_size_px
    tracks_enu : (K, 3) m each
    north_up : whether the frame is geographic: then an arrow says so; the scale bar stands always
    """
    low, high = _extent(blocks, tracks_enu)
    room = max_size_px - 2 * MARGIN_PX
    finest = float((high - low).max()) / room
    resolution = max(resolution_m or max(finest, 0.02), finest)
    size = np.ceil((high - low) / resolution).astype(int) + 1 + 2 * MARGIN_PX
    picture = np.full((int(size[1]), max(int(size[0]), 260), 3), PAPER, np.uint8)

    def pixel(enu: FloatArray) -> NDArray[np.int32]:
        xy = np.rint((enu[:, :2] - low) / resolution).astype(np.int32) + MARGIN_PX
        return np.column_stack([xy[:, 0], size[1] - 1 - xy[:, 1]]).astype(np.int32)

    highest = Foremost(picture.shape[0] * picture.shape[1])
    for points, labels in blocks:
        finite = np.isfinite(points).all(axis=1)
        column, row = pixel(points[finite]).T.astype(np.int64)
        highest.add(row * picture.shape[1] + column, points[finite, 2], labels[finite])
    seen, label = highest.seen()
    pixels = picture.reshape(-1, 3)
    for dy, dx in np.ndindex(dot_px, dot_px):  # within the margin
        pixels[seen + dy * picture.shape[1] + dx] = PALETTE_WITH_VOID[label]
    for track in tracks_enu:
        cv2.polylines(picture, [pixel(track)], False, TRACK, 2, cv2.LINE_AA)
    _draw_scale(picture, resolution)
    if north_up:
        _draw_north(picture)
    return picture


class Foremost:
    """What lies foremost at each of so many pixels, of points that come in blocks."""

    def __init__(self, pixels: int) -> None:
        self._order = np.full(pixels, -np.inf)
        self._label = np.zeros(pixels, np.uint8)
        self._row = np.zeros(pixels, np.int32)

    def add(self, pixel: NDArray[np.int64], order: FloatArray, label: NDArray[np.uint8]) -> None:
        """Points (n,): their pixels, their order, of which the largest lies foremost, of equals the last one, and their labels."""
        rows = np.argsort(order, kind="stable").astype(np.int32)
        self._row[pixel[rows]] = rows  # the last one stays
        won = np.flatnonzero((self._row[pixel] == np.arange(len(pixel))) & (order >= self._order[pixel]))
        self._order[pixel[won]], self._label[pixel[won]] = order[won], label[won]

    def seen(self) -> tuple[NDArray[np.int64], NDArray[np.uint8]]:
        """Pixels with a point, ascending, and their labels."""
        seen = np.flatnonzero(self._order > -np.inf)
        return seen, self._label[seen]


def _extent(blocks: Blocks, tracks: tuple[FloatArray, ...]) -> tuple[FloatArray, FloatArray]:
    """(2,) lowest and highest of all points and tracks in the plane; a point at zero where there is none."""
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for points in itertools.chain((points for points, _ in blocks), tracks):
        plane = points[np.isfinite(points).all(axis=1), :2]
        low, high = np.minimum(low, plane.min(axis=0, initial=np.inf)), np.maximum(high, plane.max(axis=0, initial=-np.inf))
    return (low, high) if np.isfinite(low).all() else (np.zeros(2), np.zeros(2))


def _draw_scale(picture: Picture, resolution_m: float) -> None:
    """A bar of 1, 2 or 5 times a power of ten metres, about 100 pixels long, at the bottom left."""
    length = bar_length_m(100.0 * resolution_m)
    x, y = 14, picture.shape[0] - 14
    end = x + round(length / resolution_m)
    cv2.line(picture, (x, y), (end, y), INK, 2)
    for tick in (x, end):
        cv2.line(picture, (tick, y - 5), (tick, y + 1), INK, 2)
    text = f"{length:g} m" if length < 1000 else f"{length / 1000:g} km"
    cv2.putText(picture, text, (end + 8, y + 2), FONT, 0.5, INK, 1, cv2.LINE_AA)


def bar_length_m(about_m: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that is not over about_m."""
    power = 10.0 ** np.floor(np.log10(about_m))
    return float(max(step * power for step in (1.0, 2.0, 5.0) if step * power <= about_m * (1.0 + 1e-9)))


def _draw_north(picture: Picture) -> None:
    x = picture.shape[1] - 20
    cv2.arrowedLine(picture, (x, 36), (x, 10), INK, 2, cv2.LINE_AA, tipLength=0.4)
    cv2.putText(picture, "N", (x - 6, 52), FONT, 0.5, INK, 1, cv2.LINE_AA)
