"""Mosaic of map tiles in one picture, with the drives' tracks, a legend and a scale bar."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_ID, CLASS_NAMES, PALETTE, VOID
from wayloom.errors import ServiceError
from wayloom.tiles.grid import MAX_ZOOM, TILE_PX, lonlat_from_unit, metres_per_pixel, pixel_from_lonlat
from wayloom.tiles.preview import bar_length_m

Picture = NDArray[np.uint8]
FloatArray = NDArray[np.float64]
Window = tuple[int, int, int, int, int]
"""Zoom; left, top, right and bottom in its pixels."""
GROUND = [CLASS_ID[name] for name in ("road", "sidewalk", "terrain")]
GROUND_ALPHA = 0.35
"""Of the ground's classes over its photograph, which shows the same."""
PAPER, INK, FAINT = (240, 241, 238), (35, 38, 44), (120, 124, 130)
TRACKS = ((214, 40, 40), (0, 119, 182), (230, 126, 0), (106, 76, 147))
MARGIN_PX, LEGEND_PX, LINE_PX = 24, 190, 22
FONT = cv2.FONT_HERSHEY_SIMPLEX


@dataclass(frozen=True, slots=True)
class TileLayer:
    """Pictures of a layer of the map.

    tile      : z, x, y to the bytes of a picture, or None where nothing is mapped
    max_zoom  : the finest zoom that it has; beyond, its pictures are enlarged
    edge_px   : of a picture
    """

    tile: Callable[[int, int, int], bytes | None]
    max_zoom: int = MAX_ZOOM
    edge_px: int = TILE_PX

    def zoom_for(self, zoom: int) -> int:
        """The zoom whose pixels are those of tiles of `TILE_PX` at this zoom, or its finest."""
        return max(0, min(zoom - int(np.log2(self.edge_px // TILE_PX)), self.max_zoom))


def map_picture(
    labels: TileLayer,
    bounds: tuple[float, float, float, float],
    tracks: Sequence[tuple[str, FloatArray]] = (),
    photo: TileLayer | None = None,
    *,
    max_size_px: int = 1600,
) -> Picture:
    """(h, w, 3) RGB: the labels, over the photograph of the ground where there is one, at the finest zoom at which all fits.

    bounds : west, south, east, north in degrees: at most so much is shown, and no more than there is
    tracks : name and (K, 2) longitude, latitude of each drive
    """
    labels, photo = _asked_once(labels), None if photo is None else _asked_once(photo)
    window = _window(bounds, labels, photo, max_size_px)
    shown = _shown(window, labels, photo, tracks)
    if shown is not None:
        window = _window(shown, labels, photo, max_size_px)
    zoom, left, top, right, bottom = window
    ground = np.empty((bottom - top, right - left, 3), np.uint8)
    ground[:] = PAPER
    if photo is not None:
        _lay_over(ground, _mosaic(photo, window))
    classes = _mosaic(labels, window)
    present = _classes_of(classes)
    if photo is not None:
        classes[..., 3] = np.where(np.isin(_class_at(classes), GROUND), GROUND_ALPHA * classes[..., 3], classes[..., 3])
    _lay_over(ground, classes)
    for (_, track), colour in zip(tracks, _colours(len(tracks)), strict=True):
        line = pixel_from_lonlat(track[:, :2], zoom) - (left, top)
        cv2.polylines(ground, [line.astype(np.int32)], False, colour, 2, cv2.LINE_AA)
    _draw_scale(ground, metres_per_pixel(zoom, 0.5 * (bounds[1] + bounds[3])))
    return _with_legend(ground, present, [name for name, _ in tracks])


def _asked_once(layer: TileLayer) -> TileLayer:
    """The same layer, which asks for no tile twice: it is looked at once for what it shows and once to be drawn."""
    return replace(layer, tile=cache(layer.tile))


def _window(bounds: tuple[float, float, float, float], labels: TileLayer, photo: TileLayer | None, max_size_px: int) -> Window:
    """The finest zoom at which the bounds fit, and the window of the world's picture around them."""
    west, south, east, north = bounds
    corners = np.array([[west, north], [east, south]])
    finest = max(one.max_zoom + int(np.log2(one.edge_px // TILE_PX)) for one in (labels, photo) if one is not None)
    zooms = range(min(finest, MAX_ZOOM), -1, -1)
    zoom = next(z for z in zooms if z == 0 or np.ptp(pixel_from_lonlat(corners, z), axis=0).max() <= max_size_px)
    (left, top), (right, bottom) = pixel_from_lonlat(corners, zoom).tolist()
    return zoom, left - MARGIN_PX, top - MARGIN_PX, right + MARGIN_PX, bottom + MARGIN_PX


def _shown(
    window: Window, labels: TileLayer, photo: TileLayer | None, tracks: Sequence[tuple[str, FloatArray]]
) -> tuple[float, float, float, float] | None:
    """West, south, east, north of what the layers show in a window, and of the tracks; None where nothing does."""
    zoom, left, top, right, bottom = window
    seen = np.zeros((bottom - top, right - left), np.bool_)
    for layer in (labels, photo):
        if layer is not None:
            seen |= _mosaic(layer, window)[..., 3] > 0
    rows, columns = np.nonzero(seen)
    places = [np.column_stack([columns + left, rows + top]), *(pixel_from_lonlat(track[:, :2], zoom) for _, track in tracks)]
    pixels = np.concatenate(places)
    if len(rows) == 0:
        return None
    low, high = np.maximum(pixels.min(axis=0), (left, top)), np.minimum(pixels.max(axis=0) + 1, (right, bottom))
    (west, north), (east, south) = lonlat_from_unit(np.stack([low, high]) / (TILE_PX << zoom)).tolist()
    return west, south, east, north


def _mosaic(layer: TileLayer, window: Window) -> Picture:
    """(h, w, 4) RGBA: the tiles of a layer under a window; clear where there is none."""
    zoom, left, top, right, bottom = window
    of_tiles = layer.zoom_for(zoom)
    edge = TILE_PX << (zoom - of_tiles)
    picture = np.zeros((bottom - top, right - left, 4), np.uint8)
    for y in range(top // edge, (bottom - 1) // edge + 1):
        for x in range(left // edge, (right - 1) // edge + 1):
            content = layer.tile(of_tiles, x, y)
            if content is not None:
                _put(picture, _decoded(content, layer.edge_px), edge, x * edge - left, y * edge - top)
    return picture


def _decoded(content: bytes, edge_px: int) -> Picture:
    """(edge_px, edge_px, 4) RGBA of a tile. Raises ServiceError where it is none."""
    picture = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    if picture is not None and picture.ndim == 3 and picture.shape[2] == 3:  # a WebP without a clear pixel keeps no transparency
        picture = cv2.cvtColor(picture, cv2.COLOR_BGR2BGRA)
    if picture is None or picture.shape != (edge_px, edge_px, 4):
        raise ServiceError(f"a tile of {len(content)} bytes is no {edge_px}x{edge_px} picture with transparency")
    return np.asarray(picture[..., [2, 1, 0, 3]], np.uint8)


def _put(picture: Picture, tile: Picture, edge: int, x: int, y: int) -> None:
    """Put one tile, enlarged to an edge, with its top left corner at column x, row y, clipped."""
    if tile.shape[0] != edge:
        tile = np.asarray(cv2.resize(tile, (edge, edge), interpolation=cv2.INTER_NEAREST), np.uint8)
    x0, y0 = max(x, 0), max(y, 0)
    x1, y1 = min(x + edge, picture.shape[1]), min(y + edge, picture.shape[0])
    picture[y0:y1, x0:x1] = tile[y0 - y : y1 - y, x0 - x : x1 - x]


def _lay_over(picture: Picture, over: Picture) -> None:
    """Lay RGBA over RGB, in place."""
    alpha = over[..., 3:] / np.float32(255.0)
    picture[:] = np.rint(picture * (1.0 - alpha) + over[..., :3] * alpha).astype(np.uint8)


def _class_at(classes: Picture) -> NDArray[np.uint8]:
    """(h, w) train id that each pixel is drawn in, 255 where none."""
    found = np.full(classes.shape[:2], VOID, np.uint8)
    for number, colour in enumerate(PALETTE):
        found[(classes[..., :3] == colour).all(axis=2) & (classes[..., 3] > 0)] = number
    return found


def _classes_of(classes: Picture) -> list[int]:
    """Train ids that are drawn anywhere."""
    return [number for number in np.unique(_class_at(classes)).tolist() if number != VOID]


def _colours(count: int) -> list[tuple[int, int, int]]:
    return [TRACKS[i % len(TRACKS)] for i in range(count)]


def _draw_scale(picture: Picture, resolution_m: float) -> None:
    length = bar_length_m(120.0 * resolution_m)
    x, y = 16, picture.shape[0] - 16
    end = x + round(length / resolution_m)
    cv2.line(picture, (x, y), (end, y), INK, 2, cv2.LINE_AA)
    cv2.putText(picture, f"{length:g} m", (x, y - 8), FONT, 0.45, INK, 1, cv2.LINE_AA)


def _with_legend(ground: Picture, classes: list[int], names: list[str]) -> Picture:
    """The picture with the classes that it shows and the drives in a column at its right."""
    height = max(ground.shape[0], MARGIN_PX + LINE_PX * (len(classes) + len(names) + 2))
    out = np.empty((height, ground.shape[1] + LEGEND_PX, 3), np.uint8)
    out[:] = PAPER
    out[: ground.shape[0], : ground.shape[1]] = ground
    x, y = ground.shape[1] + 12, MARGIN_PX
    for name, colour in [(CLASS_NAMES[number], PALETTE[number].tolist()) for number in classes]:
        cv2.rectangle(out, (x, y - 10), (x + 14, y + 2), colour, -1)
        cv2.rectangle(out, (x, y - 10), (x + 14, y + 2), FAINT, 1)
        cv2.putText(out, name, (x + 22, y), FONT, 0.42, INK, 1, cv2.LINE_AA)
        y += LINE_PX
    for name, line_colour in zip(names, _colours(len(names)), strict=True):
        cv2.line(out, (x, y - 4), (x + 14, y - 4), line_colour, 2, cv2.LINE_AA)
        cv2.putText(out, name[:20], (x + 22, y), FONT, 0.42, INK, 1, cv2.LINE_AA)
        y += LINE_PX
    return out
