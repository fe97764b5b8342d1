import gtsam
import numpy as np
import pytest

from wayloom.geometry import se3
from wayloom.mapping.odometry_links import pose_key
from wayloom.mapping.up_factors import UpObservations, lean_key, up_errors, up_jacobians


@pytest.fixture
def T_enu_node() -> np.ndarray:
    T = se3.exp(0.2 * np.random.default_rng(0).normal(size=(3, 6)))
    T[:, :3, :3] = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]]) @ T[:, :3, :3]
    return T


@pytest.fixture
def up(T_enu_node) -> UpObservations:
    covariance = np.array([[[1e-4, 2e-5], [2e-5, 3e-4]], [[1e-3, 0.0], [0.0, 10.0]]])
    lean_sigma = np.array([[0.01, 0.02], [0.03, 0.04]])
    return UpObservations(np.array([2, 0]), T_enu_node[[2, 0], 2, :3], covariance, np.array([1, 0]), lean_sigma)


def test_up_as_the_cameras_have_it_leaves_no_error(up, T_enu_node):
    assert np.abs(up_errors(up, T_enu_node, np.zeros((2, 2)))).max() < 1e-15


def test_the_jacobians_are_the_derivatives_of_the_error(up, T_enu_node):
    lean = np.array([[0.01, 0.02], [-0.03, 0.01]])
    here, J = up_errors(up, T_enu_node, lean), up_jacobians(up, T_enu_node)
    for k, node in enumerate(up.node):
        for axis, omega in enumerate(1e-6 * np.eye(3)):
            moved = T_enu_node.copy()
            moved[node] = gtsam.Pose3(T_enu_node[node]).retract(np.concatenate([omega, np.zeros(3)])).matrix()
            assert np.allclose((up_errors(up, moved, lean) - here)[k] / 1e-6, J[k, :, axis], atol=1e-5)


def test_the_linear_factors_have_the_cost_of_the_observations(up, T_enu_node):
    values, zero = gtsam.Values(), gtsam.VectorValues()
    up.start(values)
    for i in range(3):
        zero.insert(pose_key(i), np.zeros(6))
    for w in range(2):
        values.update(lean_key(w), np.array([0.01, -0.02]))
        zero.insert(lean_key(w), np.zeros(2))
    assert up.factors(T_enu_node, values).error(zero) == pytest.approx(up.cost(T_enu_node, values))


def test_the_lean_of_a_witness_is_bound_by_its_prior(up):
    values = gtsam.Values()
    up.start(values)
    values.update(lean_key(1), np.array([0.03, 0.0]))
    assert up.constant().error(values) == pytest.approx(0.5)
