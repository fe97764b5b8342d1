"""The registration's kernels against slow, obvious twins, and their derivatives."""

import numpy as np
import pytest

from wayloom.geometry import se3
from wayloom.registration.kernels.fitting import fit_equations
from wayloom.registration.kernels.ray_fitting import ray_equations
from wayloom.registration.kernels.rays import blow_up, carve
from wayloom.registration.kernels.surfaces import surface_covariances
from wayloom.registration.scene import CELL_M, cells_of

pytestmark = pytest.mark.kernels
REACH_M, SPREAD_M, OUTLIER = 1.2, 0.3, 2.0


def some_points(seed: int, count: int):
    """xyz, group and surface of random points in a box of 8 m."""
    rng = np.random.default_rng(seed)
    root = rng.normal(0, 0.25, (count, 3, 3))
    surface = root @ np.swapaxes(root, 1, 2) + 0.01 * np.eye(3)
    return rng.uniform(0, 8, (count, 3)), rng.integers(0, 2, count).astype(np.int8), surface


def naive_cost(a, b, T, reach, spread) -> float:
    """-sum log(1 + sum of densities / outlier), point by point."""
    cost, R = 0.0, T[:3, :3]
    for x_b, group_b, S_b in zip(*b, strict=True):
        total = OUTLIER
        for x_a, group_a, S_a in zip(*a, strict=True):
            e = x_a - (R @ x_b + T[:3, 3])
            M = S_a + R @ S_b @ R.T + spread**2 * np.eye(3)
            d2 = e @ np.linalg.solve(M, e)
            if group_a == group_b and np.linalg.norm(e) <= reach and d2 <= 25.0:
                total += np.exp(-0.5 * d2) / np.sqrt(np.linalg.det(M))
        cost -= np.log(total / OUTLIER)
    return cost


def some_pose() -> np.ndarray:
    return se3.exp(np.array([0.2, -0.3, 0.1, 0.02, -0.03, 0.1]))


def test_the_cost_is_that_of_all_pairs_of_one_class_within_reach() -> None:
    a, b = some_points(1, 150), some_points(2, 60)
    _, _, cost, _ = fit_equations(a, b, cells_of(a[0]).arrays(), some_pose(), REACH_M, SPREAD_M, OUTLIER)
    assert cost == pytest.approx(naive_cost(a, b, some_pose(), REACH_M, SPREAD_M), rel=1e-10)


def test_the_right_hand_side_is_the_negative_gradient_of_the_cost() -> None:
    """Exact for covariances that a turn leaves as they are: the equations hold them fixed within a step."""
    a, b = some_points(3, 150), some_points(4, 60)
    round_a, round_b = ((x, group, np.tile(0.04 * np.eye(3), (len(x), 1, 1))) for x, group, _ in (a, b))
    cells, T, step = cells_of(a[0]).arrays(), some_pose(), 1e-5
    _, g, _, _ = fit_equations(round_a, round_b, cells, T, CELL_M, 0.0, OUTLIER)
    for k in range(6):
        xi = np.zeros(6)
        xi[k] = step
        ends = [fit_equations(round_a, round_b, cells, se3.exp(s * xi) @ T, CELL_M, 0.0, OUTLIER)[2] for s in (1.0, -1.0)]
        assert -(ends[0] - ends[1]) / (2 * step) == pytest.approx(g[k], rel=1e-4, abs=1e-4)


OFFSETS = np.linspace(-1.0, 1.0, 5)


def some_rays(seed: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Unit rays (N, 3) and half lengths (N,) m, every third of them 0."""
    rays = np.random.default_rng(seed).normal(size=(count, 3))
    return rays / np.linalg.norm(rays, axis=1)[:, None], np.where(np.arange(count) % 3 == 0, 0.0, 0.7)


def test_a_point_counts_by_its_density_over_the_mean_density_along_its_ray() -> None:
    a, b = some_points(21, 150), some_points(22, 40)
    rays, half_m = some_rays(23, 40)
    T = some_pose()
    _, _, cost = ray_equations(a, b, rays, half_m, OFFSETS, cells_of(a[0]).arrays(), T, REACH_M, SPREAD_M, OUTLIER)
    expected = 0.0
    for n in range(40):
        at = [(b[0][n : n + 1] + t * half_m[n] * rays[n], b[1][n : n + 1], b[2][n : n + 1]) for t in (0.0, *OFFSETS)]
        here, *along = (-naive_cost(a, one, T, REACH_M, SPREAD_M) for one in at)
        expected -= here if half_m[n] == 0.0 else here - np.log(np.mean(np.exp(along)))
    assert cost == pytest.approx(expected, rel=1e-10)


def test_the_scores_of_points_on_rays_are_the_derivatives_of_their_log_likelihood() -> None:
    """Exact for covariances that a turn leaves as they are; the information is that of the scores, point by point."""
    a, b = some_points(24, 150), some_points(25, 30)
    a, b = ((x, group, np.tile(0.04 * np.eye(3), (len(x), 1, 1))) for x, group, _ in (a, b))
    rays, half_m = some_rays(26, 30)
    cells, T, step, scatter = cells_of(a[0]).arrays(), some_pose(), 1e-5, np.zeros((6, 6))

    def of(rows: slice, pose: np.ndarray):
        return ray_equations(
            a, tuple(x[rows] for x in b), rays[rows], half_m[rows], OFFSETS, cells, pose, CELL_M, 0.0, OUTLIER
        )  # fmt: skip

    H, g, _ = of(slice(None), T)
    for k, xi in enumerate(step * np.eye(6)):
        fall = of(slice(None), se3.exp(xi) @ T)[2] - of(slice(None), se3.exp(-xi) @ T)[2]
        assert -fall / (2 * step) == pytest.approx(g[k], rel=1e-4, abs=1e-4)
    for n in range(30):
        score = of(slice(n, n + 1), T)[1]
        scatter += np.outer(score, score)
    np.testing.assert_allclose(H, scatter, rtol=1e-10, atol=1e-10)


def test_the_hessian_sums_the_information_of_each_pair_by_its_weight() -> None:
    a, b = some_points(5, 80), some_points(6, 20)
    T = some_pose()
    H, _, _, weight = fit_equations(a, b, cells_of(a[0]).arrays(), T, REACH_M, SPREAD_M, OUTLIER)
    expected, total_weight, R = np.zeros((6, 6)), 0.0, T[:3, :3]
    for x_b, group_b, S_b in zip(*b, strict=True):
        p, terms = R @ x_b + T[:3, 3], []
        J = np.hstack([np.eye(3), -se3.hat(p)])
        for x_a, group_a, S_a in zip(*a, strict=True):
            M = S_a + R @ S_b @ R.T + SPREAD_M**2 * np.eye(3)
            d2 = (x_a - p) @ np.linalg.solve(M, x_a - p)
            if group_a == group_b and np.linalg.norm(x_a - p) <= REACH_M and d2 <= 25.0:
                terms.append((np.exp(-0.5 * d2) / np.sqrt(np.linalg.det(M)), J.T @ np.linalg.solve(M, J)))
        total = OUTLIER + sum(density for density, _ in terms)
        expected += sum((density / total * part for density, part in terms), np.zeros((6, 6)))
        total_weight += sum(density for density, _ in terms) / total
    np.testing.assert_allclose(H, expected, rtol=1e-9, atol=1e-9)
    assert weight == pytest.approx(total_weight)


def test_a_surface_is_the_scatter_of_the_neighbours_less_their_noise() -> None:
    rng = np.random.default_rng(7)
    xyz = rng.normal(0, [0.4, 0.2, 0.06], (40, 3))
    near = np.array([rng.permutation(40)[:12] for _ in range(40)], np.int32)
    near[3, 2:] = -1
    noise = np.tile(np.diag([0.01, 0.0, 0.001]), (40, 1, 1))
    surface = np.empty((40, 3, 3))
    surface_covariances(xyz, near, noise, 0.03, 0.5, surface)
    np.testing.assert_allclose(surface[3], 0.25 * np.eye(3))  # too few neighbours
    for n in (0, 11, 39):
        values, axes = np.linalg.eigh(np.cov(xyz[near[n]].T))
        left = [np.clip(v - axis @ noise[0] @ axis, 0.03**2, 0.5**2) for v, axis in zip(values, axes.T, strict=True)]
        np.testing.assert_allclose(surface[n], axes @ np.diag(left) @ axes.T, atol=1e-12)


def test_lines_of_sight_are_counted_in_the_voxels_that_they_pass() -> None:
    rng = np.random.default_rng(8)
    cameras, xyz = rng.uniform(-1, 9, (30, 3)), rng.uniform(-1, 9, (30, 3))
    origin, margin = np.zeros(3), np.full(30, 0.7)
    free = np.zeros((16, 16, 16), np.uint8)
    carve(cameras, xyz, margin, origin, 0.5, free)
    expected = np.zeros_like(free)
    for camera, point in zip(cameras, xyz, strict=True):
        length = np.linalg.norm(point - camera)
        places = [camera + s * 0.5 / length * (point - camera) for s in range(1, int((length - 0.7) / 0.5))]
        voxels = [tuple((place // 0.5).astype(int)) for place in places if (place >= 0).all() and (place < 8).all()]
        for voxel in dict.fromkeys(voxels):
            expected[voxel] += 1
    np.testing.assert_array_equal(free, expected)


def test_voxels_within_reach_of_a_point_bear_its_group() -> None:
    xyz, group = np.array([[1.2, 3.3, 0.1], [3.9, 3.9, 3.9], [-9.0, 0.0, 0.0]]), np.array([0, 3, 1], np.int8)
    seen = np.zeros((8, 8, 8), np.uint8)
    blow_up(xyz, group, 1, np.zeros(3), 0.5, seen)
    index = np.stack(np.meshgrid(*[np.arange(8)] * 3, indexing="ij"), axis=-1)
    for point, bit in zip(xyz, (1, 8, 2), strict=True):
        near = (np.abs(index - np.floor(point / 0.5)) <= 1).all(axis=-1)
        np.testing.assert_array_equal((seen & bit) != 0, near)
