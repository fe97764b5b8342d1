"""Lens distortion and rectification, against OpenCV and against a made world."""

import cv2
import numpy as np
import pytest

from wayloom.geometry import se3
from wayloom.geometry.camera import PinholeCamera
from wayloom.geometry.rectification import (
    DistortedCamera,
    distort,
    distortion_jacobian,
    fold_radius,
    project_distorted,
    rectifying_maps,
    undistort,
)

# The colour camera of KITTI's 2011_09_26, at half size.
LENS = DistortedCamera(PinholeCamera(479.9, 478.5, 348.0, 112.1, 696, 256), (-0.369, 0.197, 1.35e-3, 5.7e-4, -0.068))
RECTIFIED = PinholeCamera(360.77, 360.77, 304.5, 86.2, 621, 187)
R_RECT = se3.exp(np.array([0, 0, 0, 0.003, -0.012, 0.015]))[:3, :3]


def test_the_lens_is_that_of_opencv() -> None:
    rays = np.random.default_rng(0).uniform([-0.7, -0.25, 1], [0.7, 0.25, 1], (300, 3))
    expected, _ = cv2.projectPoints(rays[:, None], np.zeros(3), np.zeros(3), LENS.camera.K, np.array(LENS.distortion))
    np.testing.assert_allclose(project_distorted(rays, LENS), expected[:, 0], atol=1e-9)


def test_undistort_undoes_distort() -> None:
    xy = np.random.default_rng(1).uniform([-0.7, -0.25], [0.7, 0.25], (300, 2))
    np.testing.assert_allclose(undistort(distort(xy, LENS.distortion), LENS.distortion), xy, atol=1e-9)


def test_the_jacobian_of_the_lens_is_that_of_finite_differences() -> None:
    xy, step = np.random.default_rng(2).uniform([-1, -0.6], [1, 0.6], (50, 2)), 1e-6
    J = distortion_jacobian(xy, LENS.distortion)
    for i in range(2):
        d = step * np.eye(2)[i]
        numeric = (distort(xy + d, LENS.distortion) - distort(xy - d, LENS.distortion)) / (2 * step)
        np.testing.assert_allclose(J[:, :, i], numeric, atol=1e-8)


def test_where_the_lens_reaches_no_point_undistort_is_nan() -> None:
    assert np.isnan(undistort(np.array([[9.0, 9.0]]), LENS.distortion)).all()


def test_a_ray_that_does_not_point_forward_is_nan() -> None:
    assert np.isnan(project_distorted(np.array([[0.1, 0.1, -1.0], [0.0, 0.0, 0.0]]), LENS)).all()


def test_nothing_is_seen_beyond_the_fold_of_a_lens() -> None:
    barrel = DistortedCamera(LENS.camera, (-0.3, 0.0, 0.0, 0.0, 0.0))
    fold = fold_radius(barrel.distortion)
    assert fold == pytest.approx(1 / np.sqrt(0.9))
    uv = project_distorted(np.array([[0.0, 0.99 * fold, 1.0], [0.0, 1.01 * fold, 1.0]]), barrel)
    assert np.isfinite(uv).all(axis=1).tolist() == [True, False]
    assert fold_radius((0.0, 0.0, 0.0, 0.0, 0.0)) == fold_radius((0.1, 0.1, 0.0, 0.0, 0.0)) == float("inf")


def test_the_maps_are_those_of_opencv() -> None:
    size = (RECTIFIED.width, RECTIFIED.height)
    expected = cv2.initUndistortRectifyMap(LENS.camera.K, np.array(LENS.distortion), R_RECT, RECTIFIED.K, size, cv2.CV_32FC1)
    for ours, theirs in zip(rectifying_maps(LENS, R_RECT, RECTIFIED), expected, strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-3)


def texture(rays: np.ndarray) -> np.ndarray:
    """A smooth picture painted on the directions of the rectified camera, 0 to 255."""
    x, y = rays[..., 0] / rays[..., 2], rays[..., 1] / rays[..., 2]
    return 127.5 + 60 * np.sin(34 * x + 3 * y) + 55 * np.cos(41 * y - 7 * x)


@pytest.mark.parametrize("lens", [LENS, DistortedCamera(LENS.camera, (0.0, 0.0, 0.0, 0.0, 0.0))])
def test_a_distorted_picture_of_a_made_world_comes_out_as_the_ideal_camera_sees_it(lens: DistortedCamera) -> None:
    c = lens.camera
    v, u = np.mgrid[0 : c.height, 0 : c.width].astype(float)
    xy = undistort(np.column_stack([(u.ravel() - c.cx) / c.fx, (v.ravel() - c.cy) / c.fy]), lens.distortion)
    rays_rect = np.column_stack([np.nan_to_num(xy), np.ones(len(xy))]) @ R_RECT.T
    seen = np.round(texture(rays_rect)).astype(np.uint8).reshape(c.height, c.width)
    got = cv2.remap(seen, *rectifying_maps(lens, R_RECT, RECTIFIED), cv2.INTER_LINEAR).astype(float)
    v, u = np.mgrid[0 : RECTIFIED.height, 0 : RECTIFIED.width].astype(float)
    ideal = texture(RECTIFIED.rays(np.column_stack([u.ravel(), v.ravel()]))).reshape(u.shape)
    inside = got[8:-8, 8:-8] > 0
    error = np.abs(got - ideal)[8:-8, 8:-8][inside]
    gradient = np.abs(np.gradient(ideal)[1]).mean()
    assert inside.mean() > 0.8
    assert error.mean() / gradient < 0.15, "mean shift in pixels"
