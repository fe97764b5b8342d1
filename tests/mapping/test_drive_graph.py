import gtsam
import numpy as np
import pytest

from wayloom.geometry import se3
from wayloom.mapping import drive_graph
from wayloom.mapping.drive_graph import AntennaFixes, DriveNoise, OdometryChain, correlations, optimise_drive

NOISE = DriveNoise(0.1, np.radians(0.05), 0.005, np.radians(0.02), np.radians(3.0), 30.0, 0.3, 0.15, 0.9999)


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
    return AntennaFixes(np.arange(n) * 0.1, np.arange(n), lever, antenna, np.tile(np.eye(3) * sigma**2, (n, 1, 1)))


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
    fix = AntennaFixes(np.zeros(1), np.zeros(1, np.int64), rng.normal(size=(1, 3)), np.zeros((1, 3)), np.eye(3)[None])
    pose, g = gtsam.Pose3(se3.exp(rng.normal(size=6))), rng.normal(size=3)
    x_key, g_key = gtsam.symbol("x", 0), gtsam.symbol("g", 0)

    def values(twist: np.ndarray, shift: np.ndarray) -> gtsam.Values:
        out = gtsam.Values()
        out.insert(x_key, pose.retract(twist))
        out.insert(g_key, gtsam.Point3(*(g + shift)))
        return out

    def error(at: gtsam.Values) -> np.ndarray:
        return drive_graph._antenna_errors(fix, at.atPose3(x_key).matrix()[None], at)[0]

    here = values(np.zeros(6), np.zeros(3))
    linear = drive_graph._antenna_factors(fix, 1.0, here)
    A, minus_error = linear.jacobian(ordering(x_key, g_key))
    for i in range(9):
        step = np.zeros(9)
        step[i] = 1e-6
        numeric = (error(values(step[:6], step[6:])) - error(here)) / 1e-6
        assert np.allclose(A[:, i], numeric, atol=1e-5)
    assert np.allclose(minus_error, -error(here))


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
    """The odometry's noise alone, one exact fix at the first node: where the last node goes is known by sampling."""
    chain = straight(10)
    fixes = exact_fixes(chain, 1e-3).take(np.array([0, 1, 2]))
    solution = optimise_drive(chain, fixes, chain.T_world_node, NOISE)
    last = solution.covariance[-1]
    first_to_last = last - solution.covariance[0]
    # Position: v + omega x p. North is along the road: 9 steps of 0.1 m.
    J = np.hstack([np.eye(3), -se3.hat(solution.T_enu_node[-1, :3, 3])])
    along = np.sqrt((J @ last @ J.T)[1, 1])
    assert along == pytest.approx(np.sqrt(7) * 0.1, rel=0.15)
    assert first_to_last[5, 5] == pytest.approx(9 * (NOISE.rotation_rad**2 + NOISE.standing_rotation_rad**2), rel=0.3)


def test_fixes_that_all_disagree_with_the_odometry_are_still_believed():
    chain = straight(3)
    fixes = exact_fixes(chain, 0.01).take(np.array([0, 2]))
    fixes.position_enu[1] += [0.0, 50.0, 0.0]
    solution = optimise_drive(chain, fixes, chain.T_world_node, NOISE)
    assert solution.inlier.any()
    assert np.isfinite(solution.covariance).all()
