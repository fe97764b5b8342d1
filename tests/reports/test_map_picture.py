"""The map put together from its tiles."""

import cv2
import numpy as np
import pytest

from wayloom.config.classes import PALETTE
from wayloom.errors import ServiceError
from wayloom.reports.map_picture import LEGEND_PX, MARGIN_PX, PAPER, map_picture
from wayloom.tiles.grid import pixel_from_lonlat

BOUNDS = (11.600, 48.100, 11.601, 48.1005)


def png(colour: list[int], alpha: int) -> bytes:
    rgba = np.full((256, 256, 4), (*colour, alpha), np.uint8)
    return cv2.imencode(".png", cv2.cvtColor(rgba, cv2.COLOR_RGBA2BGRA))[1].tobytes()


def test_opaque_tiles_show_their_own_colour_and_missing_ones_the_paper():
    road = PALETTE[0].tolist()
    full = map_picture(lambda z, x, y: png(road, 255), BOUNDS, max_size_px=400)
    empty = map_picture(lambda z, x, y: None, BOUNDS, max_size_px=400)
    assert (full[60, 60] == road).all()
    assert (empty[60, 60] == PAPER).all()


def test_the_bounds_fit_at_the_finest_zoom_that_keeps_the_size():
    seen: set[int] = set()

    def tile(z: int, x: int, y: int) -> None:
        seen.add(z)

    picture = map_picture(tile, BOUNDS, max_size_px=400)
    (zoom,) = seen
    corners = np.array([[BOUNDS[0], BOUNDS[3]], [BOUNDS[2], BOUNDS[1]]])
    width, height = np.ptp(pixel_from_lonlat(corners, zoom), axis=0)
    assert max(width, height) <= 400 < 2 * max(width, height) + 2
    assert picture.shape[1] == width + 2 * MARGIN_PX + LEGEND_PX


def test_a_track_is_drawn_where_it_ran():
    track = np.array([[11.6002, 48.10025], [11.6008, 48.10025]])
    seen: list[int] = []
    picture = map_picture(lambda z, x, y: seen.append(z), BOUNDS, [("car-1", track)], max_size_px=400)
    left, top = pixel_from_lonlat(np.array([[BOUNDS[0], BOUNDS[3]]]), seen[0])[0] - MARGIN_PX
    (column, row), (end, _) = pixel_from_lonlat(track, seen[0]) - (left, top)
    drawn = np.argwhere((picture[:, : picture.shape[1] - LEGEND_PX] == (214, 40, 40)).all(axis=2))
    assert np.abs(drawn[:, 0] - row).max() <= 1
    assert drawn[:, 1].min() == pytest.approx(column, abs=2)
    assert drawn[:, 1].max() == pytest.approx(end, abs=2)


def test_a_tile_that_is_no_picture_is_reported():
    with pytest.raises(ServiceError, match="no 256x256 PNG"):
        map_picture(lambda z, x, y: b"nonsense", BOUNDS, max_size_px=400)
