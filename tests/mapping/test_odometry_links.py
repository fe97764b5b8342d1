from dataclasses import replace

import gtsam
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from wayloom.geometry import se3
from wayloom.mapping.drive_types import DriveNoise, OdometryChain
from wayloom.mapping.odometry_links import (
    STRETCH_M,
    OdometryLinks,
    add_scale_factors,
    chain_correlations,
    inverse_right_jacobian,
    link_cost,
    link_errors,
    link_factors,
    link_jacobians,
    links_of,
    of_link_errors,
    pose_key,
    scale_key,
    stretches_of,
    whitened,
)

NOISE = DriveNoise(0.005, np.radians(0.02), 0.002, np.radians(0.01), 0.002, 100.0, np.radians(3.0), 30.0, 0.02, 0.9999, 1e-6, 1e-6)


@pytest.fixture
def links() -> OdometryLinks:
    rng = np.random.default_rng(1)
    steps = se3.exp(rng.normal(size=(3, 6)))
    sigma = rng.uniform(0.01, 0.1, size=(3, 6))
    return OdometryLinks(np.arange(3), steps, sigma, np.array([0, 0, 1]), 0.02, np.array([0.0, 0.8, 0.0]))


@pytest.fixture
def T_enu_node(links) -> np.ndarray:
    """Poses that agree with the links up to a few degrees and decimetres."""
    rng = np.random.default_rng(2)
    T = [se3.exp(rng.normal(size=6))]
    for step in links.T_i_j:
        T.append(T[-1] @ step @ se3.exp(0.1 * rng.normal(size=6)))
    return np.array(T)


def retracted(T: np.ndarray, node: int, twist: np.ndarray) -> np.ndarray:
    out = T.copy()
    out[node] = gtsam.Pose3(T[node]).retract(twist).matrix()
    return out


def test_the_jacobians_are_the_derivatives_of_the_error(links, T_enu_node):
    scale = np.array([0.01, -0.03])
    here = link_errors(links, T_enu_node, scale)
    by_i, by_j, by_s = link_jacobians(links, T_enu_node, here)
    for k in range(3):
        for axis in range(6):
            twist = np.zeros(6)
            twist[axis] = 1e-6
            for node, J in ((k, by_i), (k + 1, by_j)):
                moved = link_errors(links, retracted(T_enu_node, node, twist), scale)
                assert np.allclose((moved - here)[k] / 1e-6, J[k, :, axis], atol=1e-5)
        other = scale.copy()
        other[links.stretch[k]] += 1e-6
        assert np.allclose((link_errors(links, T_enu_node, other) - here)[k] / 1e-6, by_s[k, :, 0], atol=1e-6)


@pytest.mark.parametrize("angle", [0.0, 1e-7, 1e-3, 0.5, 2.5])
def test_the_inverse_right_jacobian_is_the_derivative_of_the_logarithm(angle):
    w = angle * np.array([0.6, -0.64, 0.48])
    J = inverse_right_jacobian(w[None])[0]
    for axis, d in enumerate(1e-6 * np.eye(3)):
        moved = (Rotation.from_rotvec(w) * Rotation.from_rotvec(d)).as_rotvec()
        assert np.allclose((moved - w) / 1e-6, J[:, axis], atol=1e-5)


def test_odometry_at_its_scale_has_no_error(links):
    scale = np.array([0.02, -0.01])
    T = [np.eye(4)]
    for step, s in zip(links.T_i_j, scale[links.stretch], strict=True):
        longer = step.copy()
        longer[:3, 3] *= 1.0 + s
        T.append(T[-1] @ longer)
    assert np.abs(link_errors(links, np.array(T), scale)).max() < 1e-12


def test_the_linear_factors_have_the_cost_of_the_links(links, T_enu_node):
    scale = np.array([0.01, -0.03])
    zero = gtsam.VectorValues()
    for i in range(4):
        zero.insert(pose_key(i), np.zeros(6))
    for k in range(2):
        zero.insert(scale_key(k), np.zeros(1))
    assert link_factors(links, T_enu_node, scale).error(zero) == pytest.approx(link_cost(links, T_enu_node, scale))


def test_links_fall_into_stretches_of_road_without_gaps():
    stretch, middle = stretches_of(np.array([1.0, 9.0, 11.0, 57.0]))
    assert stretch.tolist() == [0, 0, 1, 2]
    assert np.allclose(middle, [0.5 * STRETCH_M, 1.5 * STRETCH_M, 5.5 * STRETCH_M])


def test_the_chain_of_scales_is_an_ornstein_uhlenbeck_process():
    middle = np.array([5.0, 15.0, 55.0, 65.0])
    links = OdometryLinks(
        np.zeros(0, np.int64), np.zeros((0, 4, 4)), np.zeros((0, 6)), np.zeros(0, np.int64), 0.02, chain_correlations(middle, 100.0)
    )
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    add_scale_factors(graph, links)
    for k in range(4):
        values.insert(scale_key(k), 0.0)
    hessian, _ = graph.linearize(values).hessian()
    assert np.allclose(np.linalg.inv(hessian), 0.02**2 * np.exp(-np.abs(middle[:, None] - middle[None]) / 100.0))


def test_a_window_that_knows_more_than_the_noise_model_changes_nothing() -> None:
    chain = chain_of(np.diag([1e-4] * 6) ** 2)
    with_window, without = links_of(chain, NOISE), links_of(replace(chain, link_covariance=np.zeros((2, 6, 6))), NOISE)
    errors = np.random.default_rng(0).normal(size=(2, 6))
    np.testing.assert_allclose((whitened(with_window, errors) ** 2).sum(), (whitened(without, errors) ** 2).sum(), rtol=1e-9)


def test_a_weak_window_widens_a_link_where_it_is_weak_and_nowhere_else() -> None:
    weak = np.zeros((6, 6))
    weak[2, 2] = 0.1**2  # m^2, along the view
    links = links_of(chain_of(weak), NOISE)
    W = links.narrow / links.sigma[:, None, :]
    covariance = np.linalg.inv(np.swapaxes(W, 1, 2) @ W)
    np.testing.assert_allclose(covariance[:, 5, 5], NOISE.window_factor * 0.1**2, rtol=1e-6)
    others = [0, 1, 2, 3, 4]
    np.testing.assert_allclose(np.diagonal(covariance, axis1=1, axis2=2)[:, others], links.sigma[:, others] ** 2, rtol=1e-6)


def test_errors_of_a_link_follow_from_a_left_perturbation() -> None:
    T, rng = se3.exp(np.array([1.0, -0.2, 0.4, 0.1, 0.3, -0.2])), np.random.default_rng(3)
    xi = 1e-6 * rng.normal(size=6)
    moved = se3.exp(xi) @ T
    e_R, e_p = Rotation.from_matrix(T[:3, :3].T @ moved[:3, :3]).as_rotvec(), moved[:3, 3] - T[:3, 3]
    J_J = of_link_errors(np.outer(xi, xi)[None], T[None])[0]
    np.testing.assert_allclose(J_J, np.outer(np.hstack([e_R, e_p]), np.hstack([e_R, e_p])), atol=1e-17)


def chain_of(covariance: np.ndarray) -> OdometryChain:
    """Three nodes a metre apart, each link with this covariance (6, 6) of the window."""
    T = np.tile(np.eye(4), (3, 1, 1))
    T[:, 2, 3] = np.arange(3)
    return OdometryChain(T, np.ones(2), np.ones(2, bool), np.array([0]), np.tile(covariance, (2, 1, 1)))
