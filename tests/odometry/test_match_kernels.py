"""The kernels that find patches for calibration, against slow twins and images that are warped in a known way."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from wayloom.odometry.kernels import matches
from wayloom.odometry.kernels.compiler import opened
from wayloom.odometry.kernels.matches import HALF, SEARCH_HALF, match_patches

pytestmark = pytest.mark.kernels

bilinear, stays_inside = opened(matches.bilinear), opened(matches.stays_inside)
right_side, search = opened(matches.right_side), opened(matches.search)
fetch_sixteen, add_cubics = opened(matches.fetch_sixteen), opened(matches.add_cubics)
template_equations = opened(matches.template_equations)
SIZE = (90, 140)


def waves(x: np.ndarray, y: np.ndarray, seed: int = 0) -> np.ndarray:
    """A smooth texture that can be evaluated anywhere: sums of waves of 8 to 40 px."""
    rng = np.random.default_rng(seed)
    out = np.full(np.broadcast(x, y).shape, 120.0)
    for _ in range(40):
        angle, length = rng.uniform(0, 2 * np.pi), rng.uniform(8, 40)
        k = 2 * np.pi / length * np.array([np.cos(angle), np.sin(angle)])
        out += 8.0 * np.sin(k[0] * x + k[1] * y + rng.uniform(0, 2 * np.pi))
    return out


def image(warp: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """(90, 140) float32: the texture where warp says that its pixels look."""
    v, u = np.mgrid[0 : SIZE[0], 0 : SIZE[1]].astype(float)
    return waves(*warp(u, v)).astype(np.float32)


HOST = image(lambda u, v: (u, v))
PIXELS = np.array([[30, 30], [50, 40], [70, 50], [90, 30], [40, 60], [100, 60]], np.int64)


def found(target: np.ndarray, start: np.ndarray, **more: np.ndarray) -> np.ndarray:
    n, out = len(PIXELS), np.empty((len(PIXELS), 3))
    scale = more.get("scale", np.ones(n))
    directions, reach = more.get("directions", np.zeros((n, 2))), more.get("reach", np.zeros(n))
    match_patches(HOST, target, PIXELS, start, scale, directions, reach, 1.0, out)
    return out


def keys(t: float) -> float:
    """The cubic of Keys 1981, a = -1/2."""
    t = abs(t)
    if t < 1:
        return 1.5 * t**3 - 2.5 * t**2 + 1
    return -0.5 * t**3 + 2.5 * t**2 - 4 * t + 2 if t < 2 else 0.0


def cubic(image: np.ndarray, x: float, y: float) -> float:
    """The image at (x, y) px by cubics."""
    columns, rows = range(int(x) - 1, int(x) + 3), range(int(y) - 1, int(y) + 3)
    return sum(keys(x - i) * keys(y - j) * float(image[j, i]) for j in rows for i in columns)


@pytest.mark.parametrize("at", [(20.0, 30.0), (20.25, 30.5), (41.9, 17.3)])
def test_interpolations_are_those_of_their_formulas(at: tuple[float, float]) -> None:
    x, y = at
    ix, iy = int(x), int(y)
    a, b = x - ix, y - iy
    naive = (1 - b) * ((1 - a) * HOST[iy, ix] + a * HOST[iy, ix + 1])
    naive += b * ((1 - a) * HOST[iy + 1, ix] + a * HOST[iy + 1, ix + 1])
    assert bilinear(HOST, x, y) == pytest.approx(naive, rel=1e-6)
    columns = matches.patch_columns()
    fetch_sixteen(HOST, x, y, columns, 5)
    add_cubics(columns, 0, 16)
    assert columns[1024 + 5] == pytest.approx(cubic(HOST, x, y), rel=1e-6)


def naive_rows(u: int, v: int) -> np.ndarray:
    """(121, 7): the derivatives of a patch's grey levels by its warp's steps and an offset."""
    rows = []
    for dy in range(-HALF, HALF + 1):
        for dx in range(-HALF, HALF + 1):
            gx = (float(HOST[v + dy, u + dx + 1]) - float(HOST[v + dy, u + dx - 1])) / 2
            gy = (float(HOST[v + dy + 1, u + dx]) - float(HOST[v + dy - 1, u + dx])) / 2
            rows.append([gx, gy, gx * dx, gx * dy, gy * dx, gy * dy, 1.0])
    return np.array(rows)


@pytest.mark.parametrize(("sharp", "sampled"), [(True, cubic), (False, bilinear)])
def test_the_normal_equations_are_those_of_the_patchs_rows(sharp: bool, sampled: Callable[..., float]) -> None:
    A, e, W = np.empty((7, 7)), np.empty(7), np.array([[1.1, 0.05], [-0.02, 0.95]])
    columns = matches.patch_columns()
    least = template_equations(HOST, 50, 40, columns, A)
    J = naive_rows(50, 40)
    np.testing.assert_allclose(A, J.T @ J, rtol=1e-5)
    centred = J[:, :2] - J[:, :2].mean(axis=0)
    assert least == pytest.approx(np.linalg.eigvalsh(centred.T @ centred)[0] / len(J), rel=1e-4)
    target = image(lambda u, v: (u + 0.3, v))
    variance = right_side(columns, target, 49.6, 40.2, W, sharp, e)
    r = [
        sampled(target, 49.6 + W[0] @ (dx, dy), 40.2 + W[1] @ (dx, dy)) - HOST[40 + dy, 50 + dx]
        for dy in range(-HALF, HALF + 1)
        for dx in range(-HALF, HALF + 1)
    ]
    np.testing.assert_allclose(e, J.T @ r, rtol=1e-4, atol=0.1)
    assert variance == pytest.approx(np.var(r), rel=1e-4)


def test_the_search_takes_the_place_of_least_cost() -> None:
    target = image(lambda u, v: (u - 6.0, v))
    W, direction = np.eye(2), np.array([1.0, 0.0])
    costs = []
    for k in range(-8, 9):
        patch = target[37:44, 50 + k - 3 : 50 + k + 4].astype(float) - HOST[37:44, 47:54]
        costs.append(patch.var() * (2 * SEARCH_HALF + 1) ** 2)
    assert search(HOST, target, 50, 40, 50.0, 40.0, W, direction, 8.0) == (50.0 + int(np.argmin(costs)) - 8, 40.0)
    assert math.isnan(search(HOST, target, 50, 40, 500.0, 40.0, W, direction, 8.0)[0])


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.3, -0.2), (-0.5, 0.5), (0.71, 0.43)])
def test_a_shift_is_found_to_a_hundredth_of_a_pixel(shift: tuple[float, float]) -> None:
    target = image(lambda u, v: (u - shift[0], v - shift[1]))
    out = found(target, PIXELS + np.array([0.6, -0.4]))
    np.testing.assert_allclose(out[:, :2], PIXELS + np.array(shift), atol=0.01)


def test_a_shear_as_that_of_the_road_and_a_brighter_image_move_no_match() -> None:
    target = image(lambda u, v: (u - 3.0 - 0.3 * (v - 45.0), v)) + np.float32(12.0)
    expected = PIXELS + np.column_stack([3.0 + 0.3 * (PIXELS[:, 1] - 45.0), np.zeros(len(PIXELS))])
    out = found(target, expected + np.array([0.5, 0.3]))
    np.testing.assert_allclose(out[:, :2], expected, atol=0.02)


def test_a_nearer_patch_is_found_by_its_scale_and_a_search() -> None:
    target = image(lambda u, v: (70 + (u - 72.0) / 1.25, 45 + (v - 45.0) / 1.25))
    expected = np.column_stack([72.0 + 1.25 * (PIXELS[:, 0] - 70), 45.0 + 1.25 * (PIXELS[:, 1] - 45)])
    away = expected - np.array([5.0, 0.0])
    directions = np.tile([1.0, 0.0], (len(PIXELS), 1))
    out = found(target, away, scale=np.full(len(PIXELS), 1.2), directions=directions, reach=np.full(len(PIXELS), 8.0))
    np.testing.assert_allclose(out[:, :2], expected, atol=0.02)


def test_what_is_not_there_has_no_match() -> None:
    flat = np.full(SIZE, 100.0, np.float32)
    assert np.isnan(found(flat, PIXELS.astype(float))).all()
    start = PIXELS.astype(float)
    start[0], start[1] = (np.nan, 3.0), (2.0, 2.0)
    out = found(HOST, start)
    assert np.isnan(out[:2]).all()
    assert np.isfinite(out[2:]).all()
    assert not stays_inside(HOST, 6.0, 40.0, 5.0)
    assert stays_inside(HOST, 8.0, 40.0, 5.0)


def test_a_patch_without_texture_is_left_out() -> None:
    host = np.full(SIZE, 100.0, np.float32)
    out = np.empty((1, 3))
    match_patches(host, HOST, PIXELS[:1], PIXELS[:1].astype(float), np.ones(1), np.zeros((1, 2)), np.zeros(1), 1.0, out)
    assert np.isnan(out).all()
