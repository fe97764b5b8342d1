"""Raster tiles of the semantic layer (PNG), seen from above."""

from collections.abc import Mapping

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_COUNT, PALETTE
from wayloom.tiles.grid import TILE_PX
from wayloom.tiles.levels import OCCUPIED, Level

FAINTEST, GAIN = 0.35, 12.0


def encode_png(part: Level, finest_zoom: int) -> bytes:
    """The PNG of one tile: `part` holds the counts of its pixels."""
    return png_bytes(draw(part, finest_zoom))


def draw(part: Level, finest_zoom: int) -> NDArray[np.uint8]:
    """(256, 256, 4) RGBA, clear where nothing is.

    Colour: that of the classes, weighted by the square of their counts (the majority rules, small shares soften edges).
    Opacity: grows with the share of the pixel that is occupied at the finest zoom.
    """
    pixel = (part.row % TILE_PX) * TILE_PX + part.column % TILE_PX
    code, count = part.code, part.count.astype(np.float64)
    classes = code < CLASS_COUNT
    weight = count[classes] ** 2
    total = np.bincount(pixel[classes], weight, TILE_PX**2)
    colour = [np.bincount(pixel[classes], weight * PALETTE[code[classes], c], TILE_PX**2) for c in range(3)]
    occupied = np.bincount(pixel[code == OCCUPIED], count[code == OCCUPIED], TILE_PX**2)
    share = occupied / 4.0 ** (finest_zoom - part.zoom)
    alpha = np.where(total > 0, np.minimum(FAINTEST + GAIN * share, 1.0), 0.0)
    rgba = np.stack([*(c / np.maximum(total, 1e-12) for c in colour), 255.0 * alpha], axis=1)
    return np.rint(rgba).astype(np.uint8).reshape(TILE_PX, TILE_PX, 4)


def joined_png(parts: Mapping[tuple[int, int], bytes]) -> bytes:
    """The PNG of 512 pixels along each edge that four tiles make, by their column and row, 0 or 1; clear where one lacks."""
    rgba = np.zeros((2 * TILE_PX, 2 * TILE_PX, 4), np.uint8)
    for (column, row), data in parts.items():
        bgra = np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED))
        here = slice(row * TILE_PX, (row + 1) * TILE_PX), slice(column * TILE_PX, (column + 1) * TILE_PX)
        rgba[here] = cv2.cvtColor(bgra, cv2.COLOR_BGRA2RGBA)
    return png_bytes(rgba)


def png_bytes(rgba: NDArray[np.uint8]) -> bytes:
    """(h, w, 4) RGBA to PNG bytes."""
    _, data = cv2.imencode(".png", cv2.cvtColor(rgba, cv2.COLOR_RGBA2BGRA), [cv2.IMWRITE_PNG_COMPRESSION, 6])
    return bytes(data.tobytes())
