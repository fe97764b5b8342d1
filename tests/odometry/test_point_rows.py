"""The window's table of points, against what numpy makes of its columns."""

import numpy as np
import pytest
from made_street import CAMERA
from made_window import made_window

from wayloom.odometry.backend import window as windows
from wayloom.odometry.kernels.arrays import PATTERN

pytestmark = pytest.mark.kernels


def test_chosen_and_joined_points_are_those_of_every_column() -> None:
    points = made_window(points=7).points
    points.closed[:] = np.arange(points.closed.size).reshape(points.closed.shape)
    mask = np.arange(len(points.rho)) % 3 > 0
    chosen, none = windows.chosen(points, mask), windows.chosen(points, np.zeros(0, np.int64))
    for column, some, rest, both in zip(points, chosen, none, windows.joined(chosen, points), strict=True):
        np.testing.assert_array_equal(some, column[mask])
        assert rest.shape == (0, *column.shape[1:])
        np.testing.assert_array_equal(both, np.concatenate([column[mask], column]))
        assert both.dtype == column.dtype


def test_new_points_have_their_patches_grey_values_and_weights() -> None:
    window = made_window(points=9)
    rng = np.random.default_rng(3)
    pixels = np.column_stack([rng.integers(4, CAMERA.width - 4, 40), rng.integers(4, CAMERA.height - 4, 40)])
    points = windows.new_points(window, pixels, rng.uniform(0.1, 1.0, 40), 50.0)
    image = window.images.left[window.frames.slot[-1]].astype(np.float32)
    x, y = pixels[:, :1] + PATTERN[:, 0], pixels[:, 1:] + PATTERN[:, 1]
    gx, gy = 0.5 * (image[y, x + 1] - image[y, x - 1]), 0.5 * (image[y + 1, x] - image[y - 1, x])
    np.testing.assert_array_equal(points.colour, image[y, x])
    np.testing.assert_allclose(points.weight, 2500.0 / (2500.0 + gx**2 + gy**2), rtol=1e-6)
    assert (points.host == len(window) - 1).all()


def test_frames_behind_one_that_leaves_move_up() -> None:
    window = made_window(keyframes=4, points=6)
    rng = np.random.default_rng(5)
    window.points.closed[:, :4] = rng.integers(0, 2, (len(window.points.rho), 4))
    windows.keep_points(window, window.points.host != 1)
    host, closed, slots = window.points.host.copy(), window.points.closed.copy(), window.frames.slot.copy()
    windows.remove_keyframe(window, 1)
    np.testing.assert_array_equal(window.points.host, host - (host > 1))
    np.testing.assert_array_equal(window.points.closed[:, :3], closed[:, [0, 2, 3]])
    assert not window.points.closed[:, 3:].any()
    np.testing.assert_array_equal(window.frames.slot, slots[[0, 2, 3]])
