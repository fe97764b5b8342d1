"""The map put together from its tiles."""

import cv2
import numpy as np
import pytest

from wayloom.config.classes import PALETTE
from wayloom.errors import ServiceError
from wayloom.reports.map_picture import GROUND_ALPHA, LEGEND_PX, MARGIN_PX, PAPER, TileLayer, map_picture
from wayloom.tiles.grid import pixel_from_lonlat

BOUNDS = (11.600, 48.100, 11.601, 48.1005)


def png(colour: list[int], alpha: int) -> bytes:
    rgba = np.full((256, 256, 4), (*colour, alpha), np.uint8)
    return cv2.imencode(".png", cv2.cvtColor(rgba, cv2.COLOR_RGBA2BGRA))[1].tobytes()


def test_opaque_tiles_show_their_own_colour_and_missing_ones_the_paper():
    road = PALETTE[0].tolist()
    full = map_picture(TileLayer(lambda z, x, y: png(road, 255)), BOUNDS, max_size_px=400)
    empty = map_picture(TileLayer(lambda z, x, y: None), BOUNDS, max_size_px=400)
    assert (full[60, 60] == road).all()
    assert (empty[60, 60] == PAPER).all()


def test_the_bounds_fit_at_the_finest_zoom_that_keeps_the_size():
    seen: set[int] = set()

    def tile(z: int, x: int, y: int) -> None:
        seen.add(z)

    picture = map_picture(TileLayer(tile), BOUNDS, max_size_px=400)
    (zoom,) = seen
    corners = np.array([[BOUNDS[0], BOUNDS[3]], [BOUNDS[2], BOUNDS[1]]])
    width, height = np.ptp(pixel_from_lonlat(corners, zoom), axis=0)
    assert max(width, height) <= 400 < 2 * max(width, height) + 2
    assert picture.shape[1] == width + 2 * MARGIN_PX + LEGEND_PX


def test_no_tile_is_asked_for_twice():
    asked: list[tuple[int, int, int]] = []

    def tile(z: int, x: int, y: int) -> bytes:
        asked.append((z, x, y))
        return png(PALETTE[0].tolist(), 255)

    map_picture(TileLayer(tile), BOUNDS, max_size_px=400)
    assert len(asked) == len(set(asked)) > 1


def test_a_track_is_drawn_where_it_ran():
    track = np.array([[11.6002, 48.10025], [11.6008, 48.10025]])
    seen: list[int] = []
    picture = map_picture(TileLayer(lambda z, x, y: seen.append(z)), BOUNDS, [("car-1", track)], max_size_px=400)
    left, top = pixel_from_lonlat(np.array([[BOUNDS[0], BOUNDS[3]]]), seen[0])[0] - MARGIN_PX
    (column, row), (end, _) = pixel_from_lonlat(track, seen[0]) - (left, top)
    drawn = np.argwhere((picture[:, : picture.shape[1] - LEGEND_PX] == (214, 40, 40)).all(axis=2))
    assert np.abs(drawn[:, 0] - row).max() <= 1
    assert drawn[:, 1].min() == pytest.approx(column, abs=2)
    assert drawn[:, 1].max() == pytest.approx(end, abs=2)


def test_a_tile_that_is_no_picture_is_reported():
    with pytest.raises(ServiceError, match="no 256x256 picture"):
        map_picture(TileLayer(lambda z, x, y: b"nonsense"), BOUNDS, max_size_px=400)


def test_the_ground_is_a_photograph_under_the_labels_and_its_own_classes_are_faint():
    road, building = PALETTE[0].tolist(), PALETTE[2].tolist()
    grey = cv2.imencode(".webp", np.full((512, 512, 4), (90, 100, 110, 255), np.uint8), [cv2.IMWRITE_WEBP_QUALITY, 101])[
        1
    ].tobytes()
    zooms: set[int] = set()

    def photo(z: int, x: int, y: int) -> bytes:
        zooms.add(z)
        return grey

    labels = TileLayer(lambda z, x, y: png(road if x % 2 else building, 255), max_zoom=18)
    picture = map_picture(labels, BOUNDS, photo=TileLayer(photo, 18, 512), max_size_px=1600)
    ground = picture[MARGIN_PX:-MARGIN_PX, MARGIN_PX : -MARGIN_PX - LEGEND_PX].reshape(-1, 3)
    assert zooms == {18}  # of 512 pixels: the labels' own finest, enlarged to its double
    faint = (1 - GROUND_ALPHA) * np.array([110, 100, 90]) + GROUND_ALPHA * np.array(road)
    assert (ground == building).all(axis=1).mean() > 0.2
    assert (np.abs(ground - faint) <= 1.0).all(axis=1).mean() > 0.2


def test_only_what_is_mapped_is_shown_and_only_its_classes_are_in_the_legend():
    west = pixel_from_lonlat(np.array([[BOUNDS[0], BOUNDS[1]]]), 20)[0, 0] // 256

    def tile(z: int, x: int, y: int) -> bytes | None:
        return png(PALETTE[2].tolist(), 255) if x >> (z - 19) == west >> 1 else None

    picture = map_picture(TileLayer(tile), BOUNDS, max_size_px=2000)
    whole = map_picture(TileLayer(lambda z, x, y: png(PALETTE[2].tolist(), 255)), BOUNDS, max_size_px=2000)
    assert picture.shape[1] < whole.shape[1] or picture.shape[0] < whole.shape[0]
    legend = picture[:, -LEGEND_PX:].reshape(-1, 3)
    assert (legend == PALETTE[2]).all(axis=1).any()
    assert not (legend == PALETTE[0]).all(axis=1).any()
