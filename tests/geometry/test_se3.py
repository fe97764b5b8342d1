"""Rigid motions."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wayloom.geometry import se3

numbers = st.floats(-20.0, 20.0, allow_nan=False)
small_numbers = st.floats(-1.7, 1.7, allow_nan=False)
twists = st.tuples(*[numbers] * 3, *[small_numbers] * 3).map(np.array)


def series_exp(xi: np.ndarray) -> np.ndarray:
    """The matrix exponential by its series: slow, obvious."""
    A = np.zeros((4, 4))
    A[:3, :3], A[:3, 3] = se3.hat(xi[3:]), xi[:3]
    out, term = np.eye(4), np.eye(4)
    for n in range(1, 60):
        term = term @ A / n
        out = out + term
    return out


@given(twists)
def test_exp_is_the_series_of_the_matrix_exponential(xi: np.ndarray) -> None:
    np.testing.assert_allclose(se3.exp(xi), series_exp(xi), atol=1e-9)


@given(twists)
def test_log_gives_back_the_twist_of_exp(xi: np.ndarray) -> None:
    np.testing.assert_allclose(se3.log(se3.exp(xi)), xi, atol=1e-8)


@pytest.mark.parametrize(
    "angle", [0.0, 1e-12, 1e-9, 9.9e-7, 1.01e-6, 1e-5, 1e-3, np.pi / 2, np.pi - 1e-3, np.pi - 1e-6, np.pi - 1e-9]
)
def test_exp_of_log_is_the_motion_at_every_angle_from_nothing_to_half_a_turn(angle: float) -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        axis = rng.normal(size=3)
        xi = np.concatenate([rng.normal(size=3), angle * axis / np.linalg.norm(axis)])
        T = se3.exp(xi)
        np.testing.assert_allclose(se3.exp(se3.log(T)), T, atol=1e-9)


@given(twists)
def test_a_rotation_keeps_lengths_and_handedness(xi: np.ndarray) -> None:
    R = se3.exp(xi)[:3, :3]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1.0)


@given(twists)
def test_inverse_undoes_a_motion(xi: np.ndarray) -> None:
    T = se3.exp(xi)
    np.testing.assert_allclose(se3.inverse(T) @ T, np.eye(4), atol=1e-10)


@given(twists, twists)
def test_adjoint_carries_a_twist_across_a_motion(a: np.ndarray, b: np.ndarray) -> None:
    T = se3.exp(a)
    b = 0.05 * b
    np.testing.assert_allclose(T @ se3.exp(b), se3.exp(se3.adjoint(T) @ b) @ T, atol=1e-8)


def test_hat_is_the_derivative_of_the_left_perturbation() -> None:
    rng = np.random.default_rng(2)
    T, p, step = se3.exp(rng.normal(size=6)), rng.normal(size=3), 1e-6
    analytic = np.hstack([np.eye(3), -se3.hat(se3.transform(T, p[None])[0])])  # d(exp(xi) T p) / d(v, omega)
    for i in range(6):
        xi = np.zeros(6)
        xi[i] = step
        moved = [se3.transform(se3.exp(sign * xi) @ T, p[None])[0] for sign in (1, -1)]
        np.testing.assert_allclose((moved[0] - moved[1]) / (2 * step), analytic[:, i], atol=1e-8)


def test_all_functions_that_broadcast_agree_with_one_at_a_time() -> None:
    xi = np.random.default_rng(3).normal(size=(2, 5, 6))
    T = se3.exp(xi)
    for i in np.ndindex(2, 5):
        np.testing.assert_allclose(T[i], se3.exp(xi[i]), atol=1e-15)
        np.testing.assert_allclose(se3.inverse(T)[i], se3.inverse(T[i]), atol=1e-15)
        np.testing.assert_allclose(se3.adjoint(T)[i], se3.adjoint(T[i]), atol=1e-15)
    parts = se3.from_rotation_translation(T[..., :3, :3], T[..., :3, 3])
    np.testing.assert_array_equal(parts, T)


@settings(max_examples=50)
@given(twists)
def test_a_quaternion_turns_points_as_its_motion_does(xi: np.ndarray) -> None:
    T = se3.exp(xi)[None]
    w, x, y, z = se3.quaternion_wxyz(T)[0]
    q = np.array([x, y, z])
    R = (w * w - q @ q) * np.eye(3) + 2 * np.outer(q, q) + 2 * w * se3.hat(q)
    np.testing.assert_allclose(R, T[0, :3, :3], atol=1e-9)
    assert w >= 0
    np.testing.assert_allclose(se3.from_quaternion_wxyz(-3.0 * se3.quaternion_wxyz(T), T[:, :3, 3]), T, atol=1e-9)
    np.testing.assert_array_equal(se3.from_quaternion_wxyz(se3.quaternion_wxyz(T)[0], T[0, :3, 3]).shape, (4, 4))


def test_a_quaternion_of_no_length_is_nan() -> None:
    found = se3.from_quaternion_wxyz(np.zeros((1, 4)), np.ones((1, 3)))
    assert np.isnan(found[0, :3, :3]).all()
    np.testing.assert_array_equal(found[0, :, 3], 1.0)
