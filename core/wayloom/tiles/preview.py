"""Top-down preview picture of the map, with a scale bar and a north arrow."""

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import PALETTE_WITH_VOID

FloatArray = NDArray[np.float64]
Picture = NDArray[np.uint8]
PAPER, INK = (250, 250, 248), (40, 40, 40)
TRACK = (220, 30, 30)
MARGIN_PX = 40
FONT = cv2.FONT_HERSHEY_SIMPLEX
POINTS_AT_ONCE = 1 << 18
"""Of an hour's drive: what is made of them for a moment would take more memory than they do."""


def top_down(
    points_enu: FloatArray,
    labels: NDArray[np.uint8],
    resolution_m: float | None = None,
    *,
    tracks_enu: tuple[FloatArray, ...] = (),
    max_size_px: int = 1600,
    dot_px: int = 2,
    north_up: bool = True,
) -> Picture:
    """(h, w, 3) RGB: points in the colours of their classes, the higher over the lower, tracks as lines.

    points_enu : (N, 3) m, with NaN left out; labels (N,) train ids
    resolution_m : m a pixel; None takes the finest that stays within max_size_px
    tracks_enu : (K, 3) m each
    north_up : whether the frame is geographic: then an arrow says so; the scale bar stands always
    """
    finite = np.isfinite(points_enu).all(axis=1)
    points, labels = (points_enu, labels) if finite.all() else (points_enu[finite], labels[finite])
    everything = [some[:, :2] for some in (points, *tracks_enu) if len(some)] or [np.zeros((1, 2))]
    low, high = np.min([some.min(axis=0) for some in everything], axis=0), np.max([some.max(axis=0) for some in everything], axis=0)
    room = max_size_px - 2 * MARGIN_PX
    finest = float((high - low).max()) / room
    resolution = max(resolution_m or max(finest, 0.02), finest)
    size = np.ceil((high - low) / resolution).astype(int) + 1 + 2 * MARGIN_PX
    picture = np.full((int(size[1]), max(int(size[0]), 260), 3), PAPER, np.uint8)

    def pixel(enu: FloatArray) -> NDArray[np.int32]:
        xy = np.rint((enu[:, :2] - low) / resolution).astype(np.int32) + MARGIN_PX
        return np.column_stack([xy[:, 0], size[1] - 1 - xy[:, 1]]).astype(np.int32)

    upwards = np.argsort(points[:, 2], kind="stable")  # a later dot wins, so lower points are drawn first
    blocks = np.split(upwards, range(POINTS_AT_ONCE, len(upwards), POINTS_AT_ONCE))
    corners = [pixel(points[block]) for block in blocks]
    last = np.array([picture.shape[1] - 1, picture.shape[0] - 1])
    for dy, dx in np.ndindex(dot_px, dot_px):
        for block, corner in zip(blocks, corners, strict=True):
            column, row = np.clip(corner + np.array([dx, dy]), 0, last).T
            picture[row, column] = PALETTE_WITH_VOID[labels[block]]
    for track in tracks_enu:
        cv2.polylines(picture, [pixel(track)], False, TRACK, 2, cv2.LINE_AA)
    _draw_scale(picture, resolution)
    if north_up:
        _draw_north(picture)
    return picture


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
