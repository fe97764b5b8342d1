"""The pinhole camera and the stereo rig."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wayloom.geometry.camera import PinholeCamera, StereoRig

CAMERA = PinholeCamera(700.0, 710.0, 601.5, 180.25, 1241, 376)


@given(st.floats(-100, 1400), st.floats(-100, 500), st.floats(0.1, 200))
def test_a_pixel_comes_back_from_its_ray_at_any_depth(u: float, v: float, depth: float) -> None:
    uv = np.array([[u, v]])
    np.testing.assert_allclose(CAMERA.project(CAMERA.rays(uv) * depth), uv, atol=1e-9)


def test_projection_is_that_of_the_calibration_matrix() -> None:
    p = np.random.default_rng(0).uniform([-5, -2, 1], [5, 2, 50], (100, 3))
    homogeneous = p @ CAMERA.K.T
    np.testing.assert_allclose(CAMERA.project(p), homogeneous[:, :2] / homogeneous[:, 2:], atol=1e-9)


def test_a_point_beside_or_behind_the_camera_is_nan() -> None:
    assert np.isnan(CAMERA.project(np.array([[1.0, 1.0, 0.0], [1.0, 1.0, -3.0]]))).all()


def test_the_inside_of_an_image_reaches_from_the_first_to_the_last_pixel_centre() -> None:
    corners = np.array([[0.0, 0.0], [1240.0, 375.0], [-0.01, 5.0], [1240.01, 5.0], [5.0, 375.01], [np.nan, 5.0]])
    assert CAMERA.contains(corners).tolist() == [True, True, False, False, False, False]
    assert CAMERA.contains(corners[:2], border_px=1.0).tolist() == [False, False]


@pytest.mark.parametrize("level", [1, 2, 3])
def test_a_pyramid_level_sees_a_point_where_the_means_of_pixels_have_it(level: int) -> None:
    """Pixel x of level l is the mean of 2^l pixels, so its centre lies at 2^l x + (2^l - 1) / 2 of level 0."""
    p = np.array([[1.0, -0.5, 9.0], [-3.0, 0.2, 20.0]])
    coarse = CAMERA.at_level(level).project(p)
    s = 2.0**level
    np.testing.assert_allclose(s * coarse + (s - 1) / 2, CAMERA.project(p), atol=1e-9)
    assert (CAMERA.at_level(level).width, CAMERA.at_level(level).height) == (1241 >> level, 376 >> level)


def test_two_levels_are_one_level_of_a_level() -> None:
    twice = CAMERA.at_level(1).at_level(1)
    assert (twice.fx, twice.cx, twice.width) == pytest.approx(
        (CAMERA.at_level(2).fx, CAMERA.at_level(2).cx, CAMERA.at_level(2).width)
    )


def test_disparity_is_baseline_times_focal_length_times_inverse_depth() -> None:
    rig = StereoRig(CAMERA, (-0.54, 0.0, 0.0))
    p_left = np.array([[1.0, 0.3, 12.0]])
    u_left, u_right = CAMERA.project(p_left)[0, 0], CAMERA.project(p_left + np.array(rig.t_right_left))[0, 0]
    assert u_left - u_right == pytest.approx(rig.bf / 12.0)
    assert rig.baseline_m == 0.54
