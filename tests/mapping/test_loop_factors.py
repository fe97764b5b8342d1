import gtsam
import numpy as np
import pytest

from wayloom.geometry import se3
from wayloom.mapping.drive_types import OdometryChain
from wayloom.mapping.loop_factors import LoopLinks, LoopTerms, inverse_left_jacobian, loop_errors, loop_jacobians, loop_links
from wayloom.mapping.odometry_links import pose_key


def some_loops(rng: np.random.Generator, apart: float) -> tuple[LoopLinks, np.ndarray]:
    """Three closures in two groups between five nodes, apart by twists of that size."""
    T = se3.exp(rng.normal(size=(5, 6)))
    first, second = np.array([0, 1, 2]), np.array([3, 4, 4])
    measured = se3.exp(apart * rng.normal(size=(3, 6))) @ se3.inverse(T[first]) @ T[second]
    root = rng.normal(size=(3, 6, 6))
    return LoopLinks(
        first, second, measured, root @ np.swapaxes(root, 1, 2) + 0.1 * np.eye(6), np.array([0, 0, 1]), np.array([0, 0, 1])
    ), T


def retracted(T: np.ndarray, node: int, twist: np.ndarray) -> np.ndarray:
    out = T.copy()
    out[node] = gtsam.Pose3(T[node]).retract(twist).matrix()
    return out


def test_the_jacobians_are_the_derivatives_of_the_error():
    loops, T = some_loops(np.random.default_rng(0), 0.2)
    here = loop_errors(loops, T)
    by_a, by_b = loop_jacobians(loops, T, here)
    for k in range(3):
        for axis, twist in enumerate(1e-6 * np.eye(6)):
            for node, J in ((loops.first[k], by_a), (loops.second[k], by_b)):
                moved = loop_errors(loops, retracted(T, node, twist))
                assert np.allclose((moved - here)[k] / 1e-6, J[k, :, axis], atol=1e-5)


@pytest.mark.parametrize("angle", [0.0, 0.1, 0.9])
def test_the_inverse_left_jacobian_is_the_derivative_of_the_logarithm(angle):
    xi = np.array([3.0, -2.0, 1.0, 0.6 * angle, -0.64 * angle, 0.48 * angle])
    J = inverse_left_jacobian(xi[None])[0]
    for axis, d in enumerate(1e-6 * np.eye(6)):
        assert np.allclose((se3.log(se3.exp(d) @ se3.exp(xi)) - xi) / 1e-6, J[:, axis], atol=3e-4)


def test_the_error_is_the_left_perturbation_of_the_closure():
    loops, T = some_loops(np.random.default_rng(1), 0.0)
    xi = 0.1 * np.random.default_rng(2).normal(size=(3, 6))
    wrong = LoopLinks(loops.first, loops.second, se3.exp(xi) @ loops.T_first_second, loops.covariance, loops.group, loops.visit)
    assert np.allclose(loop_errors(wrong, T), -xi)


def test_the_linear_factors_have_the_cost_of_the_closures():
    loops, T = some_loops(np.random.default_rng(3), 0.3)
    terms = LoopTerms(loops, np.array([0.5, 2.0]))
    zero, values = gtsam.VectorValues(), gtsam.Values()
    for i in range(5):
        zero.insert(pose_key(i), np.zeros(6))
    assert terms.factors(T, values).error(zero) == pytest.approx(terms.cost(T, values))


def test_a_group_of_equal_closures_weighs_as_much_as_one_of_them():
    loops, T = some_loops(np.random.default_rng(4), 0.3)
    one = LoopLinks(
        *(part[:1] for part in (loops.first, loops.second, loops.T_first_second, loops.covariance, loops.group, loops.visit))
    )
    many = LoopLinks(
        *(np.repeat(part, 7, axis=0) for part in (one.first, one.second, one.T_first_second, one.covariance, one.group, one.visit))
    )
    assert many.distance2(T) == pytest.approx(one.distance2(T))


def straight(count: int) -> OdometryChain:
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, 2, 3] = np.arange(count)
    return OdometryChain(T, np.ones(count - 1), np.ones(count - 1, bool), np.array([0]))


def test_closures_are_grouped_with_neighbours_at_both_ends_and_visits_are_groups_that_agree():
    first, second = np.array([10, 12, 30, 11, 13, 45]), np.array([110, 112, 130, 150, 108, 145])
    T, covariance = np.tile(np.eye(4), (6, 1, 1)), np.tile(1e-6 * np.eye(6), (6, 1, 1))
    T[3, 0, 3] = 20.0  # this one is elsewhere
    T[:, 2, 3] = [100.0, 100.0, 100.0, 139.0, 95.0, 100.0]
    T[5, 0, 3] = 3.0  # near by, but 3 m apart from the others
    loops = loop_links(first, second, T, covariance, straight(200))
    assert loops.first.tolist() == [10, 11, 12, 13, 30, 45]
    assert loops.group.tolist() == [0, 1, 0, 0, 2, 3]
    assert loops.visit.tolist() == [0, 1, 0, 0, 0, 2]
    taken = loops.take(np.array([True, False, True]))
    assert (taken.group.tolist(), taken.visit.tolist()) == ([0, 0, 0, 1, 2], [0, 0, 0, 0, 1])


def test_the_price_is_a_quantile_of_what_true_closures_cost():
    loops, _ = some_loops(np.random.default_rng(5), 0.0)
    assert loops.price(0.99) == pytest.approx([16.8119, 16.8119], abs=1e-3)  # table of chi-square, 6 degrees of freedom
    together = LoopLinks(loops.first, loops.second, loops.T_first_second, loops.covariance, loops.group, np.zeros(3, np.int64))
    assert together.price(0.99) == pytest.approx([26.2170], abs=1e-3)  # 12 degrees
