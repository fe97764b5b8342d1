import math

import numpy as np
import pytest

from wayloom.ground.kernels import kerbs, lines
from wayloom.ground.markings.bars import _median

pytestmark = pytest.mark.kernels
NORMALS = np.array([(1.0, 0.0), (math.sqrt(0.5), math.sqrt(0.5)), (0.0, 1.0), (-math.sqrt(0.5), math.sqrt(0.5))])


def picture(seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    grey = (80 + 20 * rng.random((24, 30))).astype(np.float32)
    grey[11:14, 4:26] += 60
    seen = (rng.random(grey.shape) > 0.05).astype(np.uint8)
    return grey, seen, (seen & (rng.random(grey.shape) > 0.1)).astype(np.uint8)


def test_side_contrast_is_that_of_the_plain_loop() -> None:
    grey, seen, candidate = picture()
    offsets = np.array([3.0, 5.0])
    out = np.zeros((4, *grey.shape), np.float32)
    lines.side_contrast(grey, seen, candidate, NORMALS, offsets, 8.0, out)
    expected = np.zeros_like(out)
    for k, (nx, ny) in enumerate(NORMALS):
        for y, x in np.argwhere(candidate):
            for d in offsets:
                dx, dy = round(d * nx), round(d * ny)
                a, b = (y + dy, x + dx), (y - dy, x - dx)
                if min(*a, *b) < 0 or max(a[0], b[0]) >= 24 or max(a[1], b[1]) >= 30 or not (seen[a] and seen[b]):
                    continue
                side = max(grey[a], grey[b])
                expected[k, y, x] = max(expected[k, y, x], (grey[y, x] - side) / (side + 8.0))
    np.testing.assert_allclose(out, expected, rtol=1e-5)


def test_along_mean_takes_the_best_direction_and_the_angle_across_a_line() -> None:
    grey, seen, _ = picture()
    candidate = np.ones_like(seen)
    contrast = np.empty((4, *grey.shape), np.float32)
    lines.side_contrast(grey, candidate, candidate, NORMALS, np.array([4.0]), 8.0, contrast)
    best, angle = np.empty(grey.shape, np.float32), np.empty(grey.shape, np.float32)
    lines.along_mean(contrast, candidate, NORMALS, 2, best, angle)
    for y, x in ((12, 15), (5, 7), (0, 0), (23, 29)):
        means = []
        for k, (nx, ny) in enumerate(NORMALS):
            places = [(y + round(t * nx), x - round(t * ny)) for t in range(-2, 3)]
            means.append(sum(contrast[k][p] for p in places if 0 <= p[0] < 24 and 0 <= p[1] < 30) / 5)
        assert best[y, x] == pytest.approx(max(means), rel=1e-5)
    assert abs(angle[12, 15]) == pytest.approx(np.pi / 2, abs=0.3)


def test_groups_are_connected_and_do_not_turn() -> None:
    best = np.zeros((6, 8), np.float32)
    angle = np.zeros((6, 8), np.float32)
    best[1, 1:7], best[2:5, 6] = 1.0, 1.0
    angle[2:5, 6] = 1.2
    group = np.empty(best.shape, np.int32)
    assert lines.like_directions(best, angle, 0.5, 0.4, group, np.empty(best.size, np.int32)) == 2
    assert set(group[1, 1:7].tolist()) == {1}
    assert set(group[2:5, 6].tolist()) == {2}
    angle[2:5, 6] = np.pi - 0.1  # nearly the same direction, modulo pi
    assert lines.like_directions(best, angle, 0.5, 0.4, group, np.empty(best.size, np.int32)) == 1


def test_mean_profiles_are_bilinear_means_over_what_is_seen() -> None:
    grey, seen, _ = picture(3)
    places = np.random.default_rng(1).uniform(3, 20, (4, 5, 2))
    across, steps = np.array([0.6, 0.8]), np.array([-2.5, 0.0, 1.7])
    out = np.empty((4, 3))
    lines.mean_profiles(grey, seen, places, across, steps, out)
    for s in range(4):
        for t, step in enumerate(steps):
            values = []
            for u, v in places[s] + step * across:
                x, y = int(np.floor(u)), int(np.floor(v))
                if seen[y : y + 2, x : x + 2].all():
                    a, b = u - x, v - y
                    values.append(np.array([1 - b, b]) @ grey[y : y + 2, x : x + 2].astype(float) @ np.array([1 - a, a]))
            expected = np.mean(values) if len(values) > 2.5 else np.nan
            np.testing.assert_allclose(out[s, t], expected, rtol=1e-6)


def test_band_edges_lie_at_half_height() -> None:
    steps = np.arange(-16, 16.1, 0.25)
    profiles = np.array([90 + 80 * np.clip(2.4 - np.abs(steps - at), 0, 1) for at in (0.0, 0.6)])
    middle, width, contrast, flank = np.empty((4, 2))
    lines.band_edges(profiles, steps, 2.0, 8.0, middle, width, contrast, flank)
    np.testing.assert_allclose(middle, [0.0, 0.6], atol=0.01)
    np.testing.assert_allclose(width, 2 * 1.9, atol=0.02)
    np.testing.assert_allclose(contrast, 80 / 98, atol=0.02)
    np.testing.assert_allclose(flank, 0.0, atol=1e-9)
    profiles[0, steps == 0.0] = np.nan
    lines.band_edges(profiles, steps, 2.0, 8.0, middle, width, contrast, flank)
    assert np.isnan(middle[0])


def test_the_best_step_is_that_of_least_squares() -> None:
    rng = np.random.default_rng(4)
    x = rng.uniform(-10, 10, 300)
    w = rng.uniform(0.5, 2.0, 300)
    erf = np.vectorize(math.erf)

    def ramp(shift: float, smear: float) -> np.ndarray:
        return 0.5 * (1 + erf((x - shift) / smear / math.sqrt(2)))

    z = 0.3 + 0.004 * x + 0.12 * ramp(1.0, 1.5) + rng.normal(0, 0.004, 300)
    shifts, smears, out = np.arange(-4, 4.1, 0.5), np.array([0.6, 1.5, 2.5]), np.empty(6)
    kerbs.best_step(x, z, w, shifts, smears, 6, out)
    fits = []
    for shift in shifts:
        for smear in smears:
            A = np.column_stack([np.ones(300), x, ramp(shift, smear)])
            p = np.linalg.lstsq(A * np.sqrt(w)[:, None], z * np.sqrt(w), rcond=None)[0]
            fits.append((float(w @ (z - A @ p) ** 2 / w.sum()), shift, p[2], smear))
    cost, shift, step, smear = min(fits)
    np.testing.assert_allclose(out[[0, 1, 3, 5]], [shift, step, cost, smear], rtol=1e-6)
    assert out[1] == pytest.approx(0.12, abs=4 * out[2])
    slope = np.column_stack([np.ones(300), x])
    p = np.linalg.lstsq(slope * np.sqrt(w)[:, None], z * np.sqrt(w), rcond=None)[0]
    assert out[4] == pytest.approx(float(w @ (z - slope @ p) ** 2 / w.sum()), rel=1e-6)


def test_too_few_heights_on_a_side_give_no_step() -> None:
    out = np.empty(6)
    kerbs.best_step(np.linspace(-5, 1, 30), np.zeros(30), np.ones(30), np.array([0.0]), np.array([0.5]), 6, out)
    assert np.isnan(out).all()


@pytest.mark.parametrize("count", [1, 2, 7, 20])
def test_medians_of_few_numbers_are_those_of_numpy(count: int) -> None:
    values = np.random.default_rng(count).normal(size=count)
    assert _median(values) == np.median(values)
    values[0] = np.nan
    assert np.isnan(_median(values))
