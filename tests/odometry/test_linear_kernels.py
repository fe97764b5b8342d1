import numpy as np
import pytest

from wayloom.geometry import se3
from wayloom.odometry.kernels import linear
from wayloom.odometry.kernels.compiler import opened

pytestmark = pytest.mark.kernels


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-4, 0.01, 1.0])
def test_exponential_and_logarithm_agree_with_the_geometry_room(size: float) -> None:
    xi = np.random.default_rng(1).normal(size=6) * size
    T = linear.exp_se3(xi)
    np.testing.assert_allclose(T, se3.exp(xi), atol=1e-14)
    np.testing.assert_allclose(linear.log_se3(T), xi, atol=1e-12)


def test_products_and_relative_poses_are_those_of_numpy() -> None:
    rng = np.random.default_rng(2)
    A, B = se3.exp(rng.normal(size=6)), se3.exp(rng.normal(size=6))
    product = np.empty((4, 4))
    opened(linear.fill_product)(A, B, product)
    np.testing.assert_allclose(product, A @ B, atol=1e-14)
    np.testing.assert_allclose(linear.relative(A, B), A @ np.linalg.inv(B), atol=1e-14)


def test_a_rotation_with_rounding_errors_becomes_orthonormal() -> None:
    rng = np.random.default_rng(3)
    T = se3.exp(rng.normal(size=6))
    bent = T.copy()
    bent[:3, :3] += 1e-5 * rng.normal(size=(3, 3))
    linear.orthonormalise(bent)
    np.testing.assert_allclose(bent[:3, :3] @ bent[:3, :3].T, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(bent, T, atol=1e-4)


def test_cholesky_solves_badly_scaled_systems_and_refuses_indefinite_ones() -> None:
    rng = np.random.default_rng(4)
    A = rng.normal(size=(12, 12))
    scale = 10.0 ** rng.uniform(-4, 4, 12)
    H, b, x = (A @ A.T + np.eye(12)) * np.outer(scale, scale), rng.normal(size=12), np.zeros(12)
    assert linear.solve_spd(H, b, x)
    np.testing.assert_allclose(x * scale, np.linalg.solve(A @ A.T + np.eye(12), b / scale), rtol=1e-9)
    assert not linear.solve_spd(-np.eye(3), np.ones(3), np.zeros(3))
    assert not linear.solve_spd(np.array([[1.0, 2.0], [2.0, 1.0]]), np.ones(2), np.zeros(2))
    assert not linear.solve_spd(np.full((2, 2), np.nan), np.ones(2), np.zeros(2))


def test_the_hosts_map_to_local_unknowns_is_the_derivative() -> None:
    rng = np.random.default_rng(5)
    T_target, T_host, a_host, a_target = se3.exp(rng.normal(size=6)), se3.exp(rng.normal(size=6)), 0.2, -0.1
    T, gain, A = T_target @ np.linalg.inv(T_host), np.exp(a_target - a_host), np.zeros((8, 8))
    opened(linear.local_from_host)(T, gain, A)
    for k in range(6):
        xi = np.zeros(6)
        xi[k] = 1e-6
        moved = T_target @ np.linalg.inv(se3.exp(xi) @ T_host)
        np.testing.assert_allclose(A[:6, k], se3.log(moved @ np.linalg.inv(T)) / 1e-6, atol=1e-5)
    # predicted grey value of a host's grey value I: exp(a_t - a_h) (I - b_h) + b_t
    assert A[6, 6] == -1.0
    assert A[7, 7] == -gain


def test_rows_are_solved_as_each_alone() -> None:
    rng = np.random.default_rng(7)
    A = rng.normal(size=(9, 9))
    H, B, X, alone = A @ A.T + np.eye(9), rng.normal(size=(4, 9)), np.empty((4, 9)), np.empty(9)
    assert linear.solve_spd_rows(H, B, X)
    for b, x in zip(B, X, strict=True):
        assert linear.solve_spd(H, b, alone)
        np.testing.assert_array_equal(x, alone)
    assert not linear.solve_spd_rows(-H, B, X)
