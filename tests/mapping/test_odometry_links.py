import gtsam
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from wayloom.geometry import se3
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
    pose_key,
    scale_key,
    stretches_of,
)


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
