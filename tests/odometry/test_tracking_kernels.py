import math

import numpy as np
import pytest
from made_street import CAMERA, RIG, curve, render

from odometry import naive
from wayloom.geometry import se3
from wayloom.odometry.kernels import tracking, tracking_equations
from wayloom.odometry.kernels.compiler import opened
from wayloom.odometry.tracking import pyramid

pytestmark = pytest.mark.kernels

LEVEL = np.array([CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy])


def made_reference(count: int = 200):
    truth = curve(2, 0.5)
    first, rho = render(truth[0], CAMERA)
    second, _ = render(truth[1], CAMERA)
    rng = np.random.default_rng(0)
    u, v = rng.integers(10, 310, count), rng.integers(10, 190, count)
    reference = np.column_stack([CAMERA.rays(np.column_stack([u, v]).astype(float))[:, :2], rho[v, u], first[v, u]])
    return reference, second.astype(np.float32), se3.inverse(truth[1])


def test_tracking_equations_are_those_of_the_naive_twin() -> None:
    reference, image, T = made_reference(60)
    T = se3.exp(np.array([0.02, 0.01, -0.03, 0.002, 0.001, -0.003])) @ T
    H, g = np.zeros((8, 8)), np.zeros(8)
    energy, count, beyond = opened(tracking_equations.tracking_equations)(
        image, reference, T, 1.02, -1.0, LEVEL, 9.0, 20.0, H, g, *tracking_equations.working_space()
    )
    H_slow, g_slow, energy_slow, count_slow, beyond_slow = naive.tracking_equations(
        image, reference, T, 1.02, -1.0, LEVEL, 9.0, 20.0
    )
    assert (count, beyond) == (count_slow, beyond_slow)
    assert beyond > 0
    assert energy == pytest.approx(energy_slow, rel=1e-5)
    np.testing.assert_allclose(H, H_slow, rtol=1e-4, atol=1e-6 * np.abs(H_slow).max())
    np.testing.assert_allclose(g, g_slow, rtol=1e-4, atol=1e-6 * np.abs(g_slow).max())


def test_alignment_finds_motion_and_brightness() -> None:
    reference, image, T_true = made_reference(800)
    T, brightness, out = T_true @ se3.exp(np.array([0.05, -0.03, 0.05, 0.004, 0.004, -0.004])), np.array([1.0, 0.0]), np.zeros(3)
    tracking.align_level(image * np.float32(0.9) + np.float32(6), reference, T, brightness, LEVEL, 9.0, 20.0, 50, 0.01, out)
    error = se3.log(T @ se3.inverse(T_true))
    assert np.linalg.norm(error[:3]) < 0.005
    assert np.linalg.norm(error[3:]) < 0.0005
    assert brightness[0] * 125 + brightness[1] == pytest.approx(0.9 * 125 + 6, abs=1.0)
    assert out[2] < 0.1 * out[1]


def test_alignment_without_any_point_in_view_changes_nothing() -> None:
    T, brightness, out = np.eye(4), np.array([1.0, 0.0]), np.ones(3)
    tracking.align_level(np.zeros((40, 60), np.float32), np.zeros((0, 4)), T, brightness, LEVEL, 9.0, 20.0, 5, 0.01, out)
    np.testing.assert_array_equal(T, np.eye(4))
    assert out.tolist() == [0.0, 0.0, 0.0]


POOL_LEVEL = np.array([10.0, 11.0, 7.0, 5.0])


def made_pool() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points at level 0, some of them in one pixel of level 1 (12, 15), some beyond it; and that level's image."""
    rng = np.random.default_rng(1)
    uv = np.vstack([rng.uniform(0.0, (34.0, 28.0), (60, 2)), [[8.4, 8.6], [8.0, 8.2], [500.0, 9.0]]])
    return uv, rng.uniform(0.1, 1.0, len(uv)), rng.random((12, 15)).astype(np.float32)


def naive_pool(uv: np.ndarray, rho: np.ndarray, image: np.ndarray, spread: bool) -> np.ndarray:
    depths: dict[tuple[int, int], list[float]] = {}
    for (u, v), depth in zip(uv, rho, strict=True):
        depths.setdefault((int(v + 0.5) // 2, int(u + 0.5) // 2), []).append(depth)
    rows = []
    for y in range(2, 9):
        for x in range(2, 12):
            around = [(y, x - 1), (y, x + 1), (y - 1, x), (y + 1, x)] if spread else []
            found = depths.get((y, x)) or [depth for cell in around for depth in depths.get(cell, [])]
            if found:
                rows.append([(x - 7.0) / 10.0, (y - 5.0) / 11.0, np.mean(found), image[y, x]])
    return np.array(rows)


def test_points_of_one_pixel_are_one_reference_point() -> None:
    uv, rho, image = made_pool()
    found = tracking.pool(uv, rho, 1, image, POOL_LEVEL)
    np.testing.assert_allclose(found, naive_pool(uv, rho, image, False), rtol=1e-6)
    assert len(found) < len(rho) - 1


def test_on_coarse_levels_pixels_beside_a_point_are_reference_points() -> None:
    uv, rho, image = made_pool()
    expected = naive_pool(uv[::4], rho[::4], image, True)
    np.testing.assert_allclose(tracking.pool_spread(uv[::4], rho[::4], 1, image, POOL_LEVEL), expected, rtol=1e-6)
    assert len(expected) > len(tracking.pool(uv[::4], rho[::4], 1, image, POOL_LEVEL))


def test_no_points_are_no_reference() -> None:
    assert tracking.pool(np.zeros((0, 2)), np.zeros(0), 0, np.zeros((12, 15), np.float32), POOL_LEVEL).shape == (0, 4)


def test_mean_flow_is_the_root_mean_square_of_projected_motion() -> None:
    reference, _, T = made_reference(50)
    rays = np.column_stack([reference[:, :2], np.ones(50)])
    moved, shifted = rays @ T[:3, :3].T + reference[:, 2:3] * T[:3, 3], rays + reference[:, 2:3] * T[:3, 3]
    expected = [math.sqrt((((p[:, :2] / p[:, 2:] - rays[:, :2]) * 200.0) ** 2).sum(axis=1).mean()) for p in (moved, shifted)]
    assert tracking.mean_flow(reference, T, LEVEL) == pytest.approx(expected)
    assert tracking.mean_flow(reference[:0], T, LEVEL) == (0.0, 0.0)


def test_projected_points_agree_with_the_camera_and_are_nan_outside() -> None:
    rng = np.random.default_rng(2)
    T = np.array([se3.exp(0.1 * rng.normal(size=6)) for _ in range(2)])
    host, uv, rho = rng.integers(0, 2, 40), rng.uniform((0, 0), (319, 199), (40, 2)), rng.uniform(0.02, 0.5, 40)
    T[1, 2, 3] -= 6.0
    out = np.zeros((40, 3))
    tracking.project_points(host, uv, rho, T, pyramid.rig_numbers(CAMERA, RIG.t_right_left), 200, 320, 6, out)
    for i in range(40):
        p = se3.transform(T[host[i]], CAMERA.rays(uv[i : i + 1]) / rho[i])
        expected = CAMERA.project(p)
        if CAMERA.contains(expected, 6.0)[0]:
            np.testing.assert_allclose(out[i], [*expected[0], 1 / p[0, 2]], rtol=1e-9)
        else:
            assert math.isnan(out[i, 0])
    assert 0 < np.isnan(out[:, 0]).sum() < 40
