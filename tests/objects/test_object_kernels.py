"""Kernels of the objects against slow twins."""

import numpy as np
import pytest

from wayloom.objects.kernels.looked import mark_looked
from wayloom.objects.kernels.matching import NOISE2, match_rectangles
from wayloom.objects.kernels.pieces import chain_pieces, runs_in_bands
from wayloom.objects.kernels.placing import RIDGE, ROUNDS, SCALE, place_by_views
from wayloom.objects.kernels.shapes import bar_shapes

pytestmark = pytest.mark.kernels


def naive_match(left: np.ndarray, right: np.ndarray, box: tuple[int, int, int, int], most: int) -> float:
    u0, v0, u1, v1 = box
    costs = []
    for d in range(min(most, u0) + 1):
        off = left[v0:v1, u0:u1].astype(float) - right[v0:v1, u0 - d : u1 - d]
        costs.append(((off - off.mean()) ** 2).sum())
    k = int(np.argmin(costs))
    a, b, c = costs[k - 1 : k + 2]
    return k + 0.5 * (a - c) / (a + c - 2 * b)


def a_pair(shift: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(5)
    wide = rng.integers(20, 235, (24, 90)).astype(np.uint8)
    return np.ascontiguousarray(wide[:, :70]), np.ascontiguousarray(
        np.clip(wide[:, shift : 70 + shift] * 0.9 + 7.0, 0, 255).astype(np.uint8)
    )


def matched(left: np.ndarray, right: np.ndarray, boxes: list[tuple[int, int, int, int]], start: list[int], most: int) -> np.ndarray:
    found = np.empty((len(start) - 1, 2))
    match_rectangles(left, right, np.array(boxes, np.int64).reshape(-1, 4), np.array(start), most, 0.85, found)
    return found


def test_rectangles_match_as_a_slow_search_has_them() -> None:
    left, right = a_pair(9)
    boxes = [(30, 3, 38, 9), (40, 10, 46, 20), (55, 0, 63, 5)]
    found = matched(left, right, boxes, [0, 1, 2, 3], 20)
    for box, (d, sigma) in zip(boxes, found, strict=True):
        assert d == pytest.approx(naive_match(left, right, box, 20), abs=1e-9)
        assert d == pytest.approx(9.0, abs=0.3)
        assert np.sqrt(NOISE2 / (60 * 110**2)) < sigma < 0.3


def test_rectangles_of_a_group_have_one_disparity() -> None:
    left, right = a_pair(9)
    together = matched(left, right, [(30, 3, 33, 5), (40, 10, 43, 12)], [0, 2], 20)
    assert together[0, 0] == pytest.approx(9.0, abs=0.3)


def test_what_cannot_be_told_is_nan() -> None:
    left, right = a_pair(9)
    flat = np.full_like(left, 90)
    assert np.isnan(matched(flat, flat, [(30, 3, 38, 9)], [0, 1], 20)).all()
    stripes = np.tile(np.arange(70) % 4 * 60, (24, 1)).astype(np.uint8)
    assert np.isnan(matched(stripes, stripes, [(30, 3, 38, 9)], [0, 1], 20)).all()
    for box in ((1, 3, 8, 9), (30, 3, 31, 9), (30, 30, 38, 40), (-5, 0, 2, 6)):
        assert np.isnan(matched(left, right, [box], [0, 1], 20)).all()
    assert matched(left, right, [], [0], 20).shape == (0, 2)


def test_runs_are_those_of_a_slow_search() -> None:
    rng = np.random.default_rng(2)
    label = (rng.random((17, 40)) < 0.6).astype(np.uint8) * 5
    out = np.empty((500, 3), np.int64)
    count = runs_in_bands(label, 5, 4, 6, out)
    naive = []
    for v0 in range(0, 14, 4):
        inside = [*((label[v0 : v0 + 4] == 5).sum(axis=0) > 2), False]
        start = None
        for u, on in enumerate(inside):
            if on and start is None:
                start = u
            if not on and start is not None:
                naive += [(v0, start, u)] if u - start <= 6 else []
                start = None
    assert [tuple(row) for row in out[:count].tolist()] == naive
    assert len(naive) > 10
    assert runs_in_bands(label, 5, 4, 6, np.empty((3, 3), np.int64)) == 3


def test_pieces_chain_where_they_stand_over_each_other_at_one_depth() -> None:
    band = np.array([0, 0, 1, 1, 2, 3, 9])
    middle = np.array([10.0, 50.0, 10.5, 50.0, 11.0, 50.0, 11.0])
    disparity = np.array([8.0, 20.0, 8.2, 9.0, 8.1, 20.4, 8.0])
    chain = np.zeros(7, np.int64)
    count = chain_pieces(band, middle, np.full(7, 3.0), disparity, 4, chain)
    assert chain.tolist() == [0, 1, 0, 2, 0, 1, 3]
    assert count == 4


def test_a_view_counts_once_in_each_cell_that_its_rays_go_through() -> None:
    looked, mark = np.zeros((20, 20), np.uint8), np.full((20, 20), -1, np.int32)
    rays = np.array([[0.0, 1.0], [0.02, 1.0], [0.5, 1.0]])
    for number in range(2):
        mark_looked(np.array([0.25, 0.0]), rays, np.array([6.0, 6.0, 3.0]), 2.0, 0.5, np.array([-4, 0]), looked, mark, number)
    naive = np.zeros((20, 20), bool)
    for ray, depth in zip(rays, (6.0, 6.0, 3.0), strict=True):
        for z in np.arange(2.0, depth + 1e-9, 0.25 / np.hypot(*ray)):
            x, y = np.array([0.25, 0.0]) + z * ray
            naive[int(np.floor(y / 0.5)), int(np.floor(x / 0.5)) + 4] = True
    np.testing.assert_array_equal(looked, 2 * naive)


def test_counts_of_looks_do_not_run_over() -> None:
    looked, mark = np.full((8, 8), 255, np.uint8), np.full((8, 8), -1, np.int32)
    mark_looked(np.zeros(2), np.array([[0.3, 1.0]]), np.array([9.0]), 0.0, 0.5, np.zeros(2, np.int64), looked, mark, 0)
    assert (looked == 255).all()


def naive_place(
    R: np.ndarray, centre: np.ndarray, camera: np.ndarray, uvd: np.ndarray, sigma: np.ndarray, height: np.ndarray, stands: bool,
    place: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """The steps by matrices, with derivatives by differences."""
    fx, fy, cx, cy, bf = camera
    rows, axes = ([0, 2], 2) if stands else ([0, 1, 2], 3)

    def residuals(at: np.ndarray) -> np.ndarray:
        points = np.tile(at, (len(uvd), 1))
        if stands:
            points[:, 2] = height
        x, y, z = np.einsum("nji,nj->in", R, points - centre)
        return ((uvd - np.column_stack([fx * x / z + cx, fy * y / z + cy, bf / z])) / sigma)[:, rows]

    place = place.copy()
    for _ in range(ROUNDS):
        r = residuals(place)
        steps = 1e-6 * np.eye(3)[:axes]
        J = np.stack([(residuals(place - step) - residuals(place + step)) / 2e-6 for step in steps], axis=-1)
        off = np.sqrt((r**2).mean(axis=1))
        weight = 1.0 / (1.0 + (off / SCALE) ** 2)
        H = np.einsum("n,nij,nik->jk", weight, J, J) + RIDGE * np.eye(axes)
        place[:axes] += np.clip(np.linalg.solve(H, np.einsum("n,nij,ni->j", weight, J, r)), -1.0, 1.0)
    return place, H, off


@pytest.mark.parametrize("stands", [True, False])
def test_a_place_by_views_is_that_of_plain_matrices(stands: bool) -> None:
    rng = np.random.default_rng(3)
    camera = np.array([700.0, 690.0, 600.0, 180.0, 380.0])
    true, axes = np.array([14.0, 2.0, 1.0]), 2 if stands else 3
    for count in (1, 2, 7):
        centre = rng.normal(size=(count, 3)) * np.array([3.0, 1.0, 0.1])
        turn = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
        a = rng.normal(0.0, 0.1, count)
        yaw = np.array([[np.cos(a), -np.sin(a), 0 * a], [np.sin(a), np.cos(a), 0 * a], [0 * a, 0 * a, 1 + 0 * a]]).transpose(
            2, 0, 1
        )
        R = np.ascontiguousarray(yaw @ turn)
        x, y, z = np.einsum("nji,nj->in", R, true - centre)
        uvd = np.column_stack([camera[0] * x / z + camera[2], camera[1] * y / z + camera[3], camera[4] / z])
        sigma = rng.uniform(0.2, 1.0, uvd.shape)
        uvd += rng.normal(size=uvd.shape) * sigma
        height = np.full(count, true[2])
        start = true + np.array([0.5, -0.4, 0.0 if stands else 0.3])
        place, H, off, space = start.copy(), np.zeros((axes, axes)), np.zeros(count), rng.normal(size=(7, 3)) * 1e6
        place_by_views(R, centre, camera, np.arange(count), uvd, sigma, height, stands, place, H, off, space)
        wanted = naive_place(R, centre, camera, uvd, sigma, height, stands, start)
        for found, slow in zip((place, H, off), wanted, strict=True):
            np.testing.assert_allclose(found, slow, rtol=1e-5, atol=1e-7)
        assert np.abs(place - true)[:2].max() < 1.5


def test_shapes_of_bars_are_medians_and_means_of_their_pieces() -> None:
    rng = np.random.default_rng(4)
    counts = np.array([1, 2, 5, 8, 3])
    start = np.concatenate([[0], np.cumsum(counts)])
    u0, v0 = rng.integers(0, 100, (2, start[-1]))
    pieces = np.column_stack([u0, v0, u0 + rng.integers(2, 9, len(u0)), v0 + 10])
    disparity, sigma = rng.normal(10.0, 1.0, len(u0)), rng.uniform(0.0, 0.3, len(u0))
    shapes = np.empty((len(counts), 6))
    bar_shapes(pieces, disparity, sigma, start, 0.05, shapes, np.full(counts.max(), np.nan))
    for row, first, last in zip(shapes, start[:-1], start[1:], strict=True):
        own, d = pieces[first:last], disparity[first:last]
        weight = 1.0 / (np.maximum(sigma[first:last], 0.05) ** 2 + (d - np.median(d)) ** 2)
        wanted = (
            np.median(0.5 * (own[:, 0] + own[:, 2] - 1)), (own[:, 1] + 4.5).mean(), (weight * d).sum() / weight.sum(), weight.sum(),
            np.median(d), np.median(own[:, 2] - own[:, 0]),
        )  # fmt: skip
        np.testing.assert_allclose(row, wanted, rtol=1e-12)
