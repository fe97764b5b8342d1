"""Epipolar search and depth updates against slow twins and the truth of a made street."""

import numpy as np
import pytest
from made_window import BIAS_PX, NUMBERS, ROBUST, made_window

from odometry.naive import patch_terms, project, sample
from wayloom.odometry.backend import window as windows
from wayloom.odometry.backend.window import Window
from wayloom.odometry.kernels import linear, tracing
from wayloom.odometry.kernels.arrays import PATTERN
from wayloom.odometry.kernels.compiler import opened
from wayloom.odometry.kernels.patch import make_scratch
from wayloom.odometry.settings import OdometrySettings

pytestmark = pytest.mark.kernels
search_line, settle = opened(tracing.search_line), opened(tracing.settle)

STRICT = ROBUST._replace(max_energy=70.0)
GREY_SIGMA = OdometrySettings().grey_sigma


def ray(uv: np.ndarray) -> tuple[float, float]:
    return (uv[0] - NUMBERS.cx) / NUMBERS.fx, (uv[1] - NUMBERS.cy) / NUMBERS.fy


def relative(window: Window, host: int, target: int) -> np.ndarray:
    return linear.relative(window.frames.T_cam_world[target], window.frames.T_cam_world[host])


def traced(window: Window, target: int, nearest_m: float = 2.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """State and interval of all points of the window, searched without any knowledge."""
    n = len(window.points.rho)
    low, high, state = np.zeros(n), np.full(n, 1 / nearest_m), np.zeros(n, np.int64)
    tracing.trace_points(
        window.images, NUMBERS, window.frames, window.points, np.arange(n), target, low, high, 3.0, 80.0, STRICT, state
    )
    return state, low, high


def test_points_of_unknown_depth_are_found_along_their_epipolar_lines() -> None:
    window = made_window(4, 150, disturbed=False)
    truth = window.points.rho.copy()
    window.points.rho[:] = 0.0
    state, low, high = traced(window, 3)
    found = state == tracing.TRACED
    assert not found[window.points.host == 3].any()
    assert found.sum() > 40
    error = np.abs(window.points.rho[found] / truth[found] - 1.0)
    assert np.median(error) < 0.03
    inside = (low[found] <= truth[found]) & (truth[found] <= high[found])
    assert inside.mean() > 0.8
    assert ((high - low)[found] < 0.2).mean() > 0.9
    assert not window.points.rho[~found].any()


def test_a_search_in_the_right_interval_fails_less_often_than_one_without_knowledge() -> None:
    window = made_window(3, 150, disturbed=False)
    truth, n = window.points.rho.copy(), len(window.points.rho)
    wide, _, _ = traced(window, 2)
    low, high, narrow = 0.6 * truth, 1.6 * truth, np.zeros(n, np.int64)
    tracing.trace_points(
        window.images, NUMBERS, window.frames, window.points, np.arange(n), 2, low, high, 3.0, 80.0, STRICT, narrow
    )
    assert (narrow == tracing.TRACED).sum() > (wide == tracing.TRACED).sum()


@pytest.mark.parametrize(("pattern", "outcome"), [("along", tracing.VAGUE), ("repeated", tracing.AMBIGUOUS)])
def test_edges_along_the_line_and_repeated_ones_give_no_depth(pattern: str, outcome: int) -> None:
    window = made_window(2, 30, disturbed=False)
    v, u = np.mgrid[: window.images.left.shape[1], : window.images.left.shape[2]]
    wave = np.sin(2 * np.pi * (v if pattern == "along" else u) / 8.0)
    window.images.left[:] = np.round(128 + 60 * wave)
    window.frames.T_cam_world[1] = window.frames.T_cam_world[0]
    window.frames.T_cam_world[1, 0, 3] -= 1.0  # sideways: the lines are rows
    window.points.colour[:] = window.images.left[0][
        window.points.uv[:, 1:].astype(int) + PATTERN[:, 1], window.points.uv[:, :1].astype(int) + PATTERN[:, 0]
    ]
    state, _, _ = traced(window, 1)
    state = state[(window.points.host == 0) & (window.points.uv[:, 0] > 150)]
    assert len(state) > 5
    assert (state == outcome).all()


def naive_distances(image, T, x, y, ends, steps, colours, gain, offset) -> np.ndarray:
    """Patch distances at equal steps along a line; inf where the patch is near the image's border."""
    out = np.full(steps, np.inf)
    for k, s in enumerate(np.linspace(0.0, 1.0, steps)):
        u, v = ends[0] + s * (ends[1] - ends[0])
        rhos = np.linspace(0.0, 1.0, 20001)
        centre = np.array([project(T, x, y, rho, NUMBERS) for rho in rhos[::100]])
        i = 100 * int(np.argmin(np.hypot(*(centre - (u, v)).T)))
        near = rhos[max(i - 100, 0) : i + 101]
        centre = np.array([project(T, x, y, rho, NUMBERS) for rho in near])
        rho = near[int(np.argmin(np.hypot(*(centre - (u, v)).T)))]
        places = np.array([project(T, x + dx / NUMBERS.fx, y + dy / NUMBERS.fy, rho, NUMBERS) for dx, dy in PATTERN])
        if (places > 8).all() and (places < (image.shape[1] - 9, image.shape[0] - 9)).all():
            values = np.array([sample(image, *place)[0] for place in places])
            out[k] = ((values - gain * colours - offset) ** 2).sum()
    return out


def test_the_line_search_finds_the_minimum_of_the_naive_distances() -> None:
    window = made_window(3, 6, disturbed=False)
    image, points = window.images.left[2], window.points
    for i in np.flatnonzero(points.host == 0):
        T, (x, y) = relative(window, 0, 2), ray(points.uv[i])
        ends = np.array([project(T, x, y, rho, NUMBERS) for rho in (0.01, 0.4)])
        if not ((ends > 12).all() and (ends < (307, 187)).all()):
            continue
        distances = np.empty(100, np.float32)
        s, best, second = search_line(
            image, T, x, y, *ends[0], *ends[1], NUMBERS, points.colour[i], np.float32(1.1), np.float32(-4.0), 3.0, distances
        )
        length = np.hypot(*(ends[1] - ends[0]))
        steps = int(length) + 2
        slow = naive_distances(image, T, x, y, ends, steps, points.colour[i], 1.1, -4.0)
        at = round(s * (steps - 1))
        assert at == int(np.argmin(slow))
        assert best == pytest.approx(slow[at], rel=0.05, abs=5.0)
        away = np.abs(np.arange(steps) - at) > 2.0 * (steps - 1) / length
        expected = slow[away].min() if away.any() else np.inf
        assert second == pytest.approx(expected, rel=0.05, abs=5.0) if expected < 3.0 * best else second > 2.5 * best


def test_an_update_is_the_minimum_of_what_was_known_and_what_the_image_says() -> None:
    window = made_window(3, 12, disturbed=False)
    points, n = window.points, len(window.points.rho)
    truth = points.rho.copy()
    points.rho[:] = 1.02 * truth
    before, robust = points.rho.copy(), STRICT._replace(observer_right_weight=0.0)
    information = np.full(n, 2e4)
    state, agrees = np.zeros((2, n), np.int64)
    tracing.update_depths(
        window.images, NUMBERS, window.frames, points, np.arange(n), 2, BIAS_PX, robust, information, state, agrees
    )
    fits = np.flatnonzero((state == tracing.TRACED) & (points.host < 2))
    assert len(fits) > 8
    ratios, told = [], []
    for i in fits:
        T, (x, y) = relative(window, points.host[i], 2), ray(points.uv[i])

        def energy(rho, T=T, x=x, y=y, i=i) -> float:
            terms = patch_terms(window.images.left[2], T, x, y, rho, NUMBERS, 0.0, points.colour[i], points.weight[i], 1, 0, robust)
            return terms[2] + 2e4 * (rho - before[i]) ** 2

        around = points.rho[i] + np.linspace(-0.02, 0.02, 9) * points.rho[i]
        ratios.append(energy(points.rho[i]) / min(energy(rho) for rho in around))
        d = 1e-5
        slope = [project(T, x, y, points.rho[i] + s * d, NUMBERS) for s in (1, -1)]
        ru, rv = (slope[0] - slope[1]) / (2 * d)
        M = patch_terms(
            window.images.left[2], T, x, y, points.rho[i], NUMBERS, 0.0, points.colour[i], points.weight[i], 1, 0, robust
        )[0]
        expected = 2e4 + M[0, 0] * ru * ru + 2 * M[0, 1] * ru * rv + M[1, 1] * rv * rv
        told.append(information[i] / expected)
    assert np.median(ratios) < 1.03
    assert np.median(np.abs(np.array(told) - 1.0)) < 0.02
    assert told == pytest.approx(np.ones(len(told)), rel=0.3)  # the last step starts from elsewhere


def test_the_hosts_right_image_moves_depths_by_the_bias() -> None:
    window = made_window(1, 200, disturbed=False)
    truth, n = window.points.rho.copy(), len(window.points.rho)
    window.points.rho[:] = truth * 1.03
    state, agrees = np.zeros((2, n), np.int64)
    information = np.full(n, 1e-3)
    tracing.update_depths(
        window.images, NUMBERS, window.frames, window.points, np.arange(n), 0, BIAS_PX, STRICT, information, state, agrees
    )
    near = NUMBERS.fx * 0.5 * truth > 8.0  # farther away the made street's texture is finer than its pixels: left and right differ
    fits = near & (state == tracing.TRACED)
    assert fits.sum() > 0.7 * near.sum()  # the others lie across edges of planes
    error, sigma = NUMBERS.fx * 0.5 * (window.points.rho - truth), NUMBERS.fx * 0.5 * GREY_SIGMA / np.sqrt(information)
    assert (np.abs(error) < 2.0 * sigma)[fits].mean() > 0.9
    sure = fits & (information > np.median(information[fits]))
    assert np.median(error[sure]) == pytest.approx(0.0, abs=0.1)  # BIAS_PX = 0.3 where nobody knew of the bias


def test_points_that_do_not_fit_or_are_out_of_view_stay_as_they_are() -> None:
    window = made_window(2, 40, disturbed=False)
    points = windows.chosen(window.points, window.points.host == 0)
    points.colour[::2] += 90.0
    points.uv[1] = [7.0, 7.0]
    before, information = points.rho.copy(), np.full(len(points.rho), 50.0)
    state, agrees = np.zeros((2, len(points.rho)), np.int64)
    tracing.update_depths(
        window.images, NUMBERS, window.frames, points, np.arange(len(points.rho)), 1, 0.0, STRICT, information, state, agrees
    )
    assert (state[::2] == tracing.MISFIT).all()
    assert state[1] == tracing.UNSEEN
    unchanged = state != tracing.TRACED
    np.testing.assert_array_equal(points.rho[unchanged], before[unchanged])
    assert (information[unchanged] == 50.0).all()
    assert not agrees[unchanged].any()
    assert (state == tracing.TRACED).any()


def test_settling_never_leaves_the_interval() -> None:
    window = made_window(2, 10, disturbed=False)
    points = window.points
    for i in np.flatnonzero(points.host == 0):
        low, high = 1.1 * points.rho[i], 1.3 * points.rho[i]
        rho, _ = settle(
            window.images.left[1], relative(window, 0, 1), *ray(points.uv[i]), 1.2 * points.rho[i], low, high, NUMBERS,
            points.colour[i], points.weight[i], 1.0, 0.0, ROBUST, make_scratch(),
        )  # fmt: skip
        assert low <= rho <= high
