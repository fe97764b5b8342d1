"""The cloud from the side: right is ahead, up is up, near hides far."""

import cv2
import numpy as np
import pytest

from wayloom.config.classes import CLASS_ID, PALETTE
from wayloom.reports.views import jpeg_bytes, main_direction, png_bytes, shrunk, side_view

TRACK = np.array([[0.0, 0.0, 0.0], [0.0, 100.0, 0.0]])


def rows_and_columns(view, name):
    return np.nonzero((view.image == PALETTE[CLASS_ID[name]]).all(axis=2))


def test_the_main_direction_points_from_start_to_end():
    np.testing.assert_allclose(main_direction(TRACK[:, :2]), [0.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(main_direction(TRACK[::-1, :2]), [0.0, -1.0], atol=1e-12)


def test_ahead_is_to_the_right_and_high_is_above():
    road = np.column_stack([np.zeros(200), np.linspace(0, 50, 200), np.full(200, -1.6)])
    tree = np.column_stack([np.zeros(200), np.linspace(60, 100, 200), np.full(200, 4.0)])
    labels = np.repeat([CLASS_ID["road"], CLASS_ID["vegetation"]], 200).astype(np.uint8)
    view = side_view([(np.vstack([road, tree]), labels)], TRACK)
    road_row, road_column = rows_and_columns(view, "road")
    tree_row, tree_column = rows_and_columns(view, "vegetation")
    assert road_column.max() < tree_column.min()
    assert road_row.min() > tree_row.max()
    assert view.width_m == pytest.approx(99.8, abs=0.5)


def test_a_near_point_hides_a_far_one():
    y = np.linspace(0, 100, 400)
    near = np.column_stack([np.full(400, 5.0), y, np.zeros(400)])  # to the right of the road, where the viewer stands
    far = np.column_stack([np.full(400, -5.0), y, np.zeros(400)])
    labels = np.repeat([CLASS_ID["car"], CLASS_ID["building"]], 400).astype(np.uint8)
    view = side_view([(np.vstack([near, far]), labels)], TRACK)
    assert len(rows_and_columns(view, "car")[0])
    assert not len(rows_and_columns(view, "building")[0])


def test_a_cloud_without_points_is_a_white_picture():
    view = side_view([(np.empty((0, 3)), np.empty(0, np.uint8))], TRACK)
    assert (view.image == 255).all()


def test_a_car_that_stood_still_can_be_drawn():
    points = np.random.default_rng(0).normal(size=(100, 3)) * 5
    view = side_view([(points, np.zeros(100, np.uint8))], np.zeros((1, 3)))
    assert len(rows_and_columns(view, "road")[0])


def test_pictures_keep_their_colours():
    image = np.zeros((20, 30, 3), np.uint8)
    image[:, :, 0] = 200
    decoded = cv2.imdecode(np.frombuffer(png_bytes(image), np.uint8), cv2.IMREAD_COLOR)
    assert (decoded[:, :, 2] == 200).all()
    assert jpeg_bytes(image)[:2] == b"\xff\xd8"


def test_only_large_pictures_shrink():
    assert shrunk(np.zeros((50, 100, 3), np.uint8), 40).shape == (20, 40, 3)
    assert shrunk(np.zeros((50, 100, 3), np.uint8), 400).shape == (50, 100, 3)
