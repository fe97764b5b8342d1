import numpy as np
import pytest
from made_street import RIG, pair

from wayloom.odometry.kernels import stereo as kernels
from wayloom.odometry.kernels.compiler import opened
from wayloom.odometry.points import stereo
from wayloom.odometry.points.selection import select_candidates

pytestmark = pytest.mark.kernels
best_column, refine_column, patch_sums = (opened(part) for part in (kernels.best_column, kernels.refine_column, kernels.patch_sums))


def naive_best_column(template, image, u, v, low, high):
    low, high = max(kernels.HALF_W, low), min(image.shape[1] - 1 - kernels.HALF_W, high)
    patch = template[v - 2 : v + 3, u - 3 : u + 4].astype(int)
    costs = np.array([np.abs(patch - image[v - 2 : v + 3, x - 3 : x + 4]).sum() for x in range(low, high + 1)])
    at = int(np.argmin(costs))
    others = costs[np.abs(np.arange(len(costs)) - at) > 2]
    return low + at, costs[at] / 35, (others.min() if len(others) else 32767) / 35


def test_best_column_is_that_of_the_naive_search() -> None:
    rng = np.random.default_rng(0)
    left, right = (rng.integers(-60, 61, (20, 90)).astype(np.int16) for _ in range(2))
    costs = np.empty(200, np.int16)
    for u, low, high in ((40, 5, 42), (10, -20, 12), (80, 60, 95)):
        assert best_column(left, right, u, 9, low, high, costs) == pytest.approx(naive_best_column(left, right, u, 9, low, high))
    assert best_column(left, right, 5, 9, 88, 95, costs)[0] == -1


def shifted_pair(dx: float, dy: float) -> tuple[np.ndarray, np.ndarray]:
    y, x = np.mgrid[0:60, 0:120].astype(float)

    def texture(x, y):
        return 120 + 35 * np.sin(0.35 * x + 0.1 * y) + 30 * np.cos(0.23 * x - 0.31 * y) + 15 * np.sin(0.6 * y + 0.05 * x)

    left, right = texture(x, y), texture(x + dx, y + dy)  # right(x, y) = left(x + dx, y + dy): matches lie dx to the left, dy up
    return np.round(left).astype(np.uint8), np.round(right).astype(np.uint8)


@pytest.mark.parametrize("shift", [7.0, 7.3, 7.77])
def test_a_column_is_refined_to_a_fraction_of_a_pixel(shift: float) -> None:
    left, right = shifted_pair(shift, 0.0)
    x, sigma = refine_column(left, right, 60, 30, 53, kernels.refinement_columns())
    assert 60 - x == pytest.approx(shift, abs=0.03)
    assert sigma < 0.5


def naive_refinement(left: np.ndarray, right: np.ndarray, u: int, v: int, x: float) -> tuple[float, float]:
    """Gauss-Newton with the offset eliminated, the gradient that of both images; x and sigma."""
    patch, R = left[v - 2 : v + 3, u - 4 : u + 5].astype(float), right[v - 2 : v + 3].astype(float)
    for _ in range(6):
        columns = x + np.arange(-4, 5)
        sampled = np.array([np.interp(columns, np.arange(R.shape[1]), row) for row in R])
        r = (sampled - patch)[:, 1:-1].ravel()
        j = (0.25 * (sampled[:, 2:] - sampled[:, :-2] + patch[:, 2:] - patch[:, :-2])).ravel()
        information, step = 35 * j.var(), -np.mean((r - r.mean()) * (j - j.mean())) / j.var()
        x += step
        if abs(step) < 0.01:
            break
    return x, np.sqrt(max(r.var(), 4.0) / information)


def test_a_refined_column_is_that_of_the_naive_twin() -> None:
    left, right = shifted_pair(7.4, 0.0)
    right = np.clip(right.astype(int) + np.random.default_rng(0).integers(-9, 10, right.shape) + 20, 0, 255).astype(np.uint8)
    columns = kernels.refinement_columns()
    for u, v in ((60, 30), (41, 12), (88, 50), (112, 7)):
        expected = naive_refinement(left, right, u, v, u - 7)
        assert refine_column(left, right, u, v, u - 7, columns) == pytest.approx(expected, abs=1e-4)


def test_a_flat_patch_has_no_match() -> None:
    flat = np.full((40, 60), 90, np.uint8)
    assert refine_column(flat, flat, 30, 20, 25, kernels.refinement_columns())[1] == kernels.NO_MATCH


def test_both_axes_are_refined_to_a_fraction_of_a_pixel() -> None:
    left, right = shifted_pair(6.4, -0.6)
    out = np.zeros((2, 3))
    pixels = np.array([[60, 30], [2, 30]], np.int64)
    kernels.refine_both_axes(left, right, pixels, np.array([6.0, 6.0]), 5, 1.0, out)
    np.testing.assert_allclose(out[0], [6.4, 0.6, 1.0], atol=0.05)
    assert out[1, 2] == 0.0


def test_patch_sums_are_those_of_numpy() -> None:
    left, right = shifted_pair(3.2, 0.4)
    s = np.empty(8)
    patch_sums(left, right, 50, 30, 46.7, 29.4, 5, s)
    gy, gx = np.gradient(left.astype(float))
    window = np.s_[25:36, 45:56]
    gx, gy = gx[window], gy[window]
    a, b, R = 0.7, 0.4, right.astype(float)
    value = (1 - b) * ((1 - a) * R[24:35, 41:52] + a * R[24:35, 42:53]) + b * ((1 - a) * R[25:36, 41:52] + a * R[25:36, 42:53])
    r = value - left[window]
    expected = [(p * q).sum() for p, q in ((gx, gx), (gx, gy), (gy, gy), (gx, r), (gy, r))] + [gx.sum(), gy.sum(), r.sum()]
    np.testing.assert_allclose(s, expected, rtol=1e-9)


def test_disparities_of_the_made_street_are_right() -> None:
    left, right, rho = pair(np.eye(4))
    left8, right8 = (np.round(image).astype(np.uint8) for image in (left, right))
    pixels = select_candidates(left8, np.zeros((0, 2)), 6, 32, 7.0, 6)
    found = stereo.match(left8, right8, pixels, 100, 0.85, 12.0, 60)
    good = found[:, 1] < 0.5
    error = found[good, 0] - RIG.bf * rho[pixels[good, 1], pixels[good, 0]]
    assert good.mean() > 0.4
    assert np.median(np.abs(error)) < 0.1
    assert (np.abs(error) < 1).mean() > 0.95


def test_the_right_images_gain_and_offset_are_found_among_outliers() -> None:
    rng = np.random.default_rng(1)
    left = rng.integers(10, 180, (50, 80)).astype(np.uint8)
    right = np.clip(np.round(1.2 * left + 8.0), 0, 255).astype(np.uint8)
    right[:12] = 0
    pixels = np.column_stack([rng.integers(5, 70, 400), rng.integers(5, 45, 400)]).astype(np.int64)
    gain, offset = stereo.right_gain(left, right, pixels, np.zeros(400))
    assert gain == pytest.approx(1.2, abs=0.02)
    assert offset == pytest.approx(8.0, abs=2.0)


def test_too_few_matches_leave_the_right_image_as_bright_as_the_left() -> None:
    image = np.zeros((20, 20), np.uint8)
    assert stereo.right_gain(image, image, np.zeros((3, 2), np.int64), np.zeros(3)).tolist() == [1.0, 0.0]
