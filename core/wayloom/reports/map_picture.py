"""Mosaic of map tiles in one picture, with the drives' tracks, a legend and a scale bar."""

from collections.abc import Callable, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_NAMES, PALETTE
from wayloom.errors import ServiceError
from wayloom.tiles.grid import MAX_ZOOM, TILE_PX, metres_per_pixel, pixel_from_lonlat
from wayloom.tiles.preview import bar_length_m

Picture = NDArray[np.uint8]
FloatArray = NDArray[np.float64]
PAPER, INK, FAINT = (240, 241, 238), (35, 38, 44), (120, 124, 130)
TRACKS = ((214, 40, 40), (0, 119, 182), (230, 126, 0), (106, 76, 147))
MARGIN_PX, LEGEND_PX, LINE_PX = 24, 190, 22
FONT = cv2.FONT_HERSHEY_SIMPLEX


def map_picture(
    tile: Callable[[int, int, int], bytes | None],
    bounds: tuple[float, float, float, float],
    tracks: Sequence[tuple[str, FloatArray]] = (),
    *,
    max_zoom: int = MAX_ZOOM,
    max_size_px: int = 1600,
) -> Picture:
    """(h, w, 3) RGB: the finest zoom at which the bounds fit, one pixel a pixel of the tiles.

    tile : z, x, y to the PNG of the preview layer, or None where nothing is mapped
    bounds : west, south, east, north in degrees
    tracks : name and (K, 2) longitude, latitude of each drive
    """
    west, south, east, north = bounds
    corners = np.array([[west, north], [east, south]])
    zoom = next(z for z in range(max_zoom, -1, -1) if z == 0 or np.ptp(pixel_from_lonlat(corners, z), axis=0).max() <= max_size_px)
    (left, top), (right, bottom) = pixel_from_lonlat(corners, zoom).tolist()
    ground = _mosaic(tile, zoom, left - MARGIN_PX, top - MARGIN_PX, right + MARGIN_PX, bottom + MARGIN_PX)
    for (_, track), colour in zip(tracks, _colours(len(tracks)), strict=True):
        line = pixel_from_lonlat(track[:, :2], zoom) - (left - MARGIN_PX, top - MARGIN_PX)
        cv2.polylines(ground, [line.astype(np.int32)], False, colour, 2, cv2.LINE_AA)
    _draw_scale(ground, metres_per_pixel(zoom, 0.5 * (south + north)))
    return _with_legend(ground, [name for name, _ in tracks])


def _mosaic(tile: Callable[[int, int, int], bytes | None], zoom: int, left: int, top: int, right: int, bottom: int) -> Picture:
    """The tiles under a window of the world's picture, laid over the paper by their alpha."""
    picture = np.empty((bottom - top, right - left, 3), np.uint8)
    picture[:] = PAPER
    for y in range(top // TILE_PX, (bottom - 1) // TILE_PX + 1):
        for x in range(left // TILE_PX, (right - 1) // TILE_PX + 1):
            content = tile(zoom, x, y)
            if content is not None:
                _lay(picture, content, x * TILE_PX - left, y * TILE_PX - top)
    return picture


def _lay(picture: Picture, png: bytes, x: int, y: int) -> None:
    """Draw one tile with its top left corner at column x, row y, clipped."""
    bgra = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_UNCHANGED)
    if bgra is None or bgra.shape != (TILE_PX, TILE_PX, 4):
        raise ServiceError(f"a preview tile of {len(png)} bytes is no {TILE_PX}x{TILE_PX} PNG with transparency")
    x0, y0 = max(x, 0), max(y, 0)
    x1, y1 = min(x + TILE_PX, picture.shape[1]), min(y + TILE_PX, picture.shape[0])
    part = bgra[y0 - y : y1 - y, x0 - x : x1 - x].astype(np.float32)
    alpha = part[..., 3:] / np.float32(255.0)
    under = picture[y0:y1, x0:x1]
    picture[y0:y1, x0:x1] = np.rint(under * (1.0 - alpha) + part[..., 2::-1] * alpha).astype(np.uint8)


def _colours(count: int) -> list[tuple[int, int, int]]:
    return [TRACKS[i % len(TRACKS)] for i in range(count)]


def _draw_scale(picture: Picture, resolution_m: float) -> None:
    length = bar_length_m(120.0 * resolution_m)
    x, y = 16, picture.shape[0] - 16
    end = x + round(length / resolution_m)
    cv2.line(picture, (x, y), (end, y), INK, 2, cv2.LINE_AA)
    cv2.putText(picture, f"{length:g} m", (x, y - 8), FONT, 0.45, INK, 1, cv2.LINE_AA)


def _with_legend(ground: Picture, names: list[str]) -> Picture:
    """The picture with the classes and the drives in a column at its right."""
    height = max(ground.shape[0], MARGIN_PX + LINE_PX * (len(CLASS_NAMES) + len(names) + 2))
    out = np.empty((height, ground.shape[1] + LEGEND_PX, 3), np.uint8)
    out[:] = PAPER
    out[: ground.shape[0], : ground.shape[1]] = ground
    x, y = ground.shape[1] + 12, MARGIN_PX
    for name, colour in [*zip(CLASS_NAMES, PALETTE.tolist(), strict=True)]:
        cv2.rectangle(out, (x, y - 10), (x + 14, y + 2), colour, -1)
        cv2.rectangle(out, (x, y - 10), (x + 14, y + 2), FAINT, 1)
        cv2.putText(out, name, (x + 22, y), FONT, 0.42, INK, 1, cv2.LINE_AA)
        y += LINE_PX
    for name, line_colour in zip(names, _colours(len(names)), strict=True):
        cv2.line(out, (x, y - 4), (x + 14, y - 4), line_colour, 2, cv2.LINE_AA)
        cv2.putText(out, name[:20], (x + 22, y), FONT, 0.42, INK, 1, cv2.LINE_AA)
        y += LINE_PX
    return out
