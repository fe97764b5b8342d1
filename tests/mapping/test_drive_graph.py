import dataclasses

import gtsam
import numpy as np
import pytest

from wayloom.geometry import se3
from wayloom.logs.types import FixType
from wayloom.mapping.drive_equations import V_OMEGA, CorrelatedFixes, DriveEquations
from wayloom.mapping.drive_graph import optimise_drive
from wayloom.mapping.drive_types import AntennaFixes, DriveNoise, OdometryChain
from wayloom.mapping.gnss_factors import antenna_errors, antenna_factors, antenna_key, correlations, receiver_key
from wayloom.mapping.odometry_links import links_of, pose_key

NOISE = DriveNoise(0.005, np.radians(0.02), 0.002, np.radians(0.01), 0.02, 100.0, np.radians(3.0), 30.0, 0.02, 0.9999, 1e-6, 1e-6)
"""The receiver's clock and lever arm as given."""


def straight(count: int) -> OdometryChain:
    """A level camera that drives north, a metre a node."""
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3] = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]
    T[:, 1, 3] = np.arange(count)
    return OdometryChain(T, np.ones(count - 1), np.ones(count - 1, bool), np.array([count // 2]))


def exact_fixes(chain: OdometryChain, sigma: float = 0.1) -> AntennaFixes:
    n = len(chain.T_world_node)
    lever = np.tile([0.3, -1.0, -0.5], (n, 1))
    antenna = np.einsum("nij,nj->ni", chain.T_world_node[:, :3, :3], lever) + chain.T_world_node[:, :3, 3]
    return AntennaFixes(
        t_s=np.arange(n) * 0.1, node=np.arange(n), late_s=np.zeros(n),
        p_node_gnss=lever, v_node_gnss=np.tile([0.0, 0.0, 10.0], (n, 1)),
        R_node_cam=np.tile(np.eye(3), (n, 1, 1)), position_enu=antenna, covariance=np.tile(np.eye(3) * sigma**2, (n, 1, 1)),
        kind=np.full(n, FixType.FIXED, np.uint8), white_share=np.full(n, 0.3),
    )  # fmt: skip


def test_exact_fixes_leave_exact_poses():
    chain = straight(20)
    solution = optimise_drive(chain, exact_fixes(chain), chain.T_world_node, NOISE)
    assert solution.inlier.all()
    assert np.abs(solution.T_enu_node - chain.T_world_node).max() < 1e-4


def test_a_poor_first_guess_comes_to_the_same_poses():
    chain = straight(30)
    guess = se3.exp(np.array([3.0, -2.0, 1.0, 0.05, 0.05, 0.3])) @ chain.T_world_node
    solution = optimise_drive(chain, exact_fixes(chain), guess, NOISE)
    assert np.abs(solution.T_enu_node - chain.T_world_node).max() < 1e-3


def test_the_antenna_factor_has_the_derivatives_of_its_error():
    rng = np.random.default_rng(0)
    fix = AntennaFixes(
        t_s=np.zeros(1), node=np.zeros(1, np.int64), late_s=np.full(1, 0.1),
        p_node_gnss=rng.normal(size=(1, 3)), v_node_gnss=rng.normal(size=(1, 3)),
        R_node_cam=se3.exp(rng.normal(size=6))[None, :3, :3], position_enu=np.zeros((1, 3)), covariance=np.eye(3)[None],
        kind=np.zeros(1, np.uint8), white_share=np.ones(1),
    )  # fmt: skip
    pose, g, receiver = gtsam.Pose3(se3.exp(rng.normal(size=6))), rng.normal(size=3), rng.normal(size=4)

    def error(twist: np.ndarray, shift: np.ndarray, change: np.ndarray) -> np.ndarray:
        return antenna_errors(fix, pose.retract(twist).matrix()[None], receiver + change, (g + shift)[None])[0]

    here = error(np.zeros(6), np.zeros(3), np.zeros(4))
    linear = antenna_factors(fix, pose.matrix()[None], receiver, g[None])
    A, minus_error = linear.jacobian(ordering(pose_key(0), antenna_key(0), receiver_key()))
    for i in range(13):
        step = np.zeros(13)
        step[i] = 1e-6
        assert np.allclose(A[:, i], (error(step[:6], step[6:9], step[9:]) - here) / 1e-6, atol=1e-5)
    assert np.allclose(minus_error, -here)


def ordering(*keys: int) -> gtsam.Ordering:
    out = gtsam.Ordering()
    for key in keys:
        out.push_back(key)
    return out


def test_the_product_of_plain_gaussians_is_the_ornstein_uhlenbeck_process():
    t = np.array([0.0, 1.0, 4.0, 4.5, 9.0, 30.0])
    rho = correlations(t, np.tile(np.eye(3), (6, 1, 1)), 5.0)
    unary = 1.0 / (1.0 + rho[:-1]) + 1.0 / (1.0 + rho[1:]) - 1.0
    information = np.diag(unary)
    for k in range(1, 6):
        weight = rho[k] / (1.0 - rho[k] ** 2)
        information[np.ix_([k - 1, k], [k - 1, k])] += weight * np.array([[1, -1], [-1, 1]])
    assert np.allclose(np.linalg.inv(information), np.exp(-np.abs(t[:, None] - t[None]) / 5.0))


def test_the_chain_of_errors_is_cut_where_the_kind_of_fix_changes():
    covariance = np.tile(np.eye(3), (4, 1, 1))
    covariance[2:] *= 0.0004
    rho = correlations(np.arange(4.0), covariance, 30.0)
    assert (rho[[0, 2, 4]] == 0.0).all()
    assert (rho[[1, 3]] > 0.9).all()


def test_the_covariance_is_of_the_left_perturbation_as_sampling_shows():
    """Exact fixes at the first nodes, then the odometry alone: what its noise and its scale make of the last node is known."""
    chain = straight(40)
    fixes = exact_fixes(chain, 1e-3).take(np.arange(10))
    noise = dataclasses.replace(NOISE, scale_length_m=1e5)
    solution = optimise_drive(chain, fixes, chain.T_world_node, noise)
    last = solution.covariance[-1]
    # Position: v + omega x p. North is along the road: 30 steps, at a scale that the first 9 m tell.
    J = np.hstack([np.eye(3), -se3.hat(solution.T_enu_node[-1, :3, 3])])
    along = np.sqrt((J @ last @ J.T)[1, 1])
    step2 = NOISE.position_m**2 + NOISE.standing_position_m**2
    scale2 = 1.0 / (1.0 / NOISE.scale_sigma**2 + 81.0 / (9.0 * step2 + 2e-6))
    assert along == pytest.approx(np.sqrt(30.0 * step2 + 30.0**2 * scale2), rel=0.15)
    turned = last - solution.covariance[9]
    assert turned[5, 5] == pytest.approx(30 * (NOISE.rotation_rad**2 + NOISE.standing_rotation_rad**2), rel=0.3)


def test_the_joint_covariance_of_two_nodes_is_that_of_the_dense_inverse():
    chain = straight(40)
    fixes = exact_fixes(chain, 0.5)
    pairs = np.array([[0, 39], [5, 6], [12, 30]])
    links = links_of(chain, NOISE)
    equations = DriveEquations(chain, links, CorrelatedFixes(fixes, NOISE), NOISE)
    state = equations.descend(equations.first_state(chain.T_world_node))
    A, _ = equations.linear(state).jacobian()  # unknowns by their keys: the poses come last
    dense = np.linalg.inv(A.T @ A)[-6 * 40 :, -6 * 40 :].reshape(40, 6, 40, 6)[:, V_OMEGA][:, :, :, V_OMEGA]
    Ad = se3.adjoint(state.T_enu_node)
    found = equations.covariances(state, pairs).cross
    for (a, b), cross in zip(pairs, found, strict=True):
        expected = Ad[a] @ dense[a, :, b] @ Ad[b].T
        np.testing.assert_allclose(cross, expected, atol=1e-5 * np.abs(expected).max())


def test_what_is_in_doubt_for_the_whole_drive_is_common_to_its_nodes():
    """The last third of the fixes lies 3 m apart for good: which part is right nobody tells, but it shifts all nodes as one."""
    chain = straight(60)
    fixes = exact_fixes(chain, 0.02)
    fixes.position_enu[40:, 0] += 3.0
    solution = optimise_drive(chain, fixes, chain.T_world_node, NOISE, pairs=np.array([[5, 30]]))
    assert solution.unconfirmed_m > 1.0
    step = solution.covariance[5] + solution.covariance[30] - solution.cross[0] - solution.cross[0].T
    assert solution.covariance[5, 0, 0] > 1.0
    assert np.sqrt(step[0, 0]) < 0.1


def test_the_scale_of_the_odometry_is_found_where_it_changes():
    chain = straight(200)
    metres = np.where(np.arange(199) < 100, 1.0 / 1.02, 1.0 / 0.98)
    T = chain.T_world_node.copy()
    T[1:, 1, 3] = np.cumsum(metres)
    solution = optimise_drive(OdometryChain(T, metres, chain.connected, chain.level), exact_fixes(chain, 0.03), T, NOISE)
    assert np.allclose(solution.scale[[3, -4]], [1.02, 0.98], atol=3e-3)
    assert (solution.scale_sigma < 0.005).all()
    assert np.abs(solution.T_enu_node - chain.T_world_node)[:, :3, 3].max() < 0.03


def test_fixes_that_all_disagree_with_the_odometry_are_still_believed():
    chain = straight(3)
    fixes = exact_fixes(chain, 0.01).take(np.array([0, 2]))
    fixes.position_enu[1] += [0.0, 50.0, 0.0]
    solution = optimise_drive(chain, fixes, chain.T_world_node, NOISE)
    assert solution.inlier.any()
    assert np.isfinite(solution.covariance).all()
