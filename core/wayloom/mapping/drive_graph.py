"""Factor graph of one drive: odometry, GNSS and gravity, in the tangent plane of the drive's own place.

Unknowns: the pose T_enu_node of every node, the scale s of every stretch of odometry, and for every fix that is kept the true
place g of the antenna at that time.

- Odometry between neighbouring nodes: small white noise, and a scale that varies slowly (`wayloom.mapping.odometry_links`).
  After a loss the link is the constant-motion guess and nearly free, so the segments are held together by GNSS.
- GNSS noise is correlated over time (multipath, atmosphere, a filter inside the receiver), so N fixes are not N witnesses. A fix is
      z_k = g_k + b_k + w_k,   w white with covariance s^2 R_k,   b Ornstein-Uhlenbeck with covariance (1 - s^2) R_k and time tau.
  With rho = exp(-dt / tau) the density of the b_k is, exactly, the product of plain Gaussians
      exp -1/2 [ sum_k u_k |b_k|^2 + sum_k rho_k / (1 - rho_k^2) |b_{k+1} - b_k|^2 ],  u_k = 1/(1+rho_{k-1}) + 1/(1+rho_k) - 1
  (rho = 0 beyond both ends; |.| weighted by the inverse covariance), that is priors on g_k and between factors of g_k and g_{k+1}.
  Where sigma changes slowly the error changes with it: its relative change, squared, is added to (1 - rho^2) / rho. Where it
  changes by more than a half from fix to fix (another fix type) the chain is cut: its errors are another process.
- Gravity: a camera is roughly level. On a straight road GNSS cannot tell the roll about the track; this weak prior does.
- Outliers are found first, with independent fixes, by graduated non-convexity (Yang et al., RA-L 2020), then by a chi-square gate.
  The first of the two knows no scale: there the odometry is a random walk as wide as a scale off by its sigma over SCREENING_M.

gtsam perturbs Pose3 on the right and orders (omega, v); results are converted to the left, (v, omega), here and only here.
"""

from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from wayloom.geometry import se3
from wayloom.mapping.drive_types import AntennaFixes, DriveNoise, DriveSolution, OdometryChain
from wayloom.mapping.odometry_links import (
    OdometryLinks,
    add_scale_factors,
    chain_correlations,
    link_cost,
    link_factors,
    ou_unary,
    pose_key,
    scale_key,
    stretches_of,
)

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
SAME_PROCESS_RATIO = 1.5
LOST_POSITION_M, LOST_ROTATION_RAD = 20.0, 0.5  # a link over a loss, plus half of the guessed distance
SCREENING_M, SCREENING_ROTATION = 25.0, 2.5  # for outliers: see the docstring; rotation noise times so much
MAX_ITERATIONS, MAX_HALVINGS, CONVERGED = 30, 8, 1e-9
GAUGE_POSITION_M, GAUGE_ROTATION_RAD = 1e3, float(np.pi)


def optimise_drive(chain: OdometryChain, fixes: AntennaFixes, T_enu_node: FloatArray, noise: DriveNoise) -> DriveSolution:
    """The most likely poses of a drive and their covariance.

    T_enu_node : (K, 4, 4) first guess
    A fix that is found to be an outlier is left out altogether; at least one fix is needed.
    """
    inlier = np.ones(len(fixes), bool)
    if len(fixes) >= 4:
        inlier, T_enu_node = _graduated(chain, fixes, T_enu_node, noise)
    inlier &= _gate(fixes, T_enu_node, noise)
    if not inlier.any():  # nothing agrees with the odometry: believe the fixes, not the gate
        inlier[:] = True
    links = _links(chain, noise)
    state, tree = _solve(chain, links, fixes.take(np.flatnonzero(inlier)), T_enu_node, noise)
    again = _gate(fixes, state.T_enu_node, noise)
    if again.any() and (again != inlier).any():
        inlier = again
        state, tree = _solve(chain, links, fixes.take(np.flatnonzero(inlier)), state.T_enu_node, noise)
    return DriveSolution(
        state.T_enu_node,
        _left_covariances(tree, state.T_enu_node),
        1.0 + state.scale,
        _scale_sigmas(tree, links.stretches),
        inlier,
        fixes.residuals(state.T_enu_node),
    )


def _antenna_key(fix: int) -> int:
    return int(gtsam.symbol("g", fix))


def _pose_sigmas(rotation_rad: float, position_m: float) -> gtsam.noiseModel.Diagonal:
    return gtsam.noiseModel.Diagonal.Sigmas(np.array([rotation_rad] * 3 + [position_m] * 3))


def _links(chain: OdometryChain, noise: DriveNoise) -> OdometryLinks:
    """The odometry between nodes, where the track was not lost."""
    first = np.flatnonzero(chain.connected)
    length = chain.length_m[first]
    stretch, middle_m = stretches_of((np.cumsum(chain.length_m) - 0.5 * chain.length_m)[first])
    rotation = np.hypot(noise.standing_rotation_rad, noise.rotation_rad * np.sqrt(length))
    position = np.hypot(noise.standing_position_m, noise.position_m * np.sqrt(length))
    return OdometryLinks(
        first=first,
        T_i_j=se3.inverse(chain.T_world_node[first]) @ chain.T_world_node[first + 1],
        sigma=np.repeat(np.stack([rotation, position], axis=1), 3, axis=1),
        stretch=stretch,
        scale_sigma=noise.scale_sigma,
        scale_rho=chain_correlations(middle_m, noise.scale_length_m),
    )


def _anchor_factors(chain: OdometryChain, noise: DriveNoise) -> gtsam.NonlinearFactorGraph:
    """Level, gauge and the guesses over losses: everything but odometry and GNSS."""
    graph = gtsam.NonlinearFactorGraph()
    gauge = _pose_sigmas(GAUGE_ROTATION_RAD, GAUGE_POSITION_M)
    graph.add(gtsam.PriorFactorPose3(pose_key(0), gtsam.Pose3(), gauge))
    for i in np.flatnonzero(~chain.connected).tolist():
        lost = _pose_sigmas(LOST_ROTATION_RAD, LOST_POSITION_M + 0.5 * float(chain.length_m[i]))
        graph.add(_between(chain, i, lost))
    up, camera_up = gtsam.Unit3(np.array([0.0, 0.0, 1.0])), gtsam.Unit3(np.array([0.0, -1.0, 0.0]))
    level = gtsam.noiseModel.Isotropic.Sigma(2, noise.level_rad)
    for node in chain.level:
        graph.add(gtsam.AttitudeFactorPose3(pose_key(int(node)), up, level, camera_up))
    return graph


def _between(chain: OdometryChain, i: int, sigmas: gtsam.noiseModel.Diagonal) -> gtsam.BetweenFactorPose3:
    step = gtsam.Pose3(se3.inverse(chain.T_world_node[i]) @ chain.T_world_node[i + 1])
    return gtsam.BetweenFactorPose3(pose_key(i), pose_key(i + 1), step, sigmas)


def _pose_values(T_enu_node: FloatArray) -> gtsam.Values:
    values = gtsam.Values()
    for i, T in enumerate(T_enu_node):
        values.insert(pose_key(i), gtsam.Pose3(T))
    return values


def _poses(values: gtsam.Values, count: int) -> FloatArray:
    return np.array([values.atPose3(pose_key(i)).matrix() for i in range(count)])


def _judged_covariance(fixes: AntennaFixes, noise: DriveNoise) -> FloatArray:
    return fixes.covariance + noise.gate_floor_m**2 * np.eye(3)


def _gate(fixes: AntennaFixes, T_enu_node: FloatArray, noise: DriveNoise) -> BoolArray:
    """(M,) whether each fix lies within the gate around the antenna's pose."""
    residual = fixes.residuals(T_enu_node)
    distance2 = np.einsum("ni,nij,nj->n", residual, np.linalg.inv(_judged_covariance(fixes, noise)), residual)
    return np.asarray(distance2 <= chi2.ppf(noise.gate_probability, 3))


def _graduated(
    chain: OdometryChain, fixes: AntennaFixes, T_enu_node: FloatArray, noise: DriveNoise
) -> tuple[BoolArray, FloatArray]:
    """Inliers by truncated least squares with graduated non-convexity over independent fixes, and the poses that go with them."""
    graph = _anchor_factors(chain, noise)
    walk_m = np.hypot(noise.position_m, noise.scale_sigma * np.sqrt(SCREENING_M))
    for i in np.flatnonzero(chain.connected).tolist():
        root = np.sqrt(chain.length_m[i])
        rotation = np.hypot(noise.standing_rotation_rad, SCREENING_ROTATION * noise.rotation_rad * root)
        graph.add(_between(chain, i, _pose_sigmas(rotation, np.hypot(noise.standing_position_m, walk_m * root))))
    known = list(range(graph.size()))
    for i, covariance in enumerate(_judged_covariance(fixes, noise)):
        model = gtsam.noiseModel.Gaussian.Covariance(covariance)
        graph.add(gtsam.GPSFactorArm(pose_key(int(fixes.node[i])), fixes.position_enu[i], fixes.p_node_gnss[i], model))
    params = gtsam.GncLMParams()
    params.setLossType(gtsam.GncLossType.TLS)
    params.setKnownInliers(known)
    optimiser = gtsam.GncLMOptimizer(graph, _pose_values(T_enu_node), params)
    optimiser.setInlierCostThresholdsAtProbability(noise.gate_probability)
    values = optimiser.optimize()
    inlier = np.asarray(optimiser.getWeights())[len(known) :] > 0.5
    return inlier, _poses(values, len(chain.T_world_node))


def _antenna_factors(
    fixes: AntennaFixes, white_share: float, T_enu_node: FloatArray, antenna_enu: FloatArray
) -> gtsam.GaussianFactorGraph:
    """error = T_enu_node p_node_gnss - g, linear there: [-R hat(p), R] for gtsam's right (omega, v), and -I for g.

    T_enu_node : (K, 4, 4), antenna_enu : (M, 3) m, the g of each fix
    """
    R = T_enu_node[fixes.node, :3, :3]
    error = _antenna_errors(fixes, T_enu_node, antenna_enu)
    by_pose = np.concatenate([-R @ se3.hat(fixes.p_node_gnss), R], axis=2)
    root = _information_roots(white_share**2 * fixes.covariance)
    graph = gtsam.GaussianFactorGraph()
    unit = gtsam.noiseModel.Unit.Create(3)
    for k, (A, b) in enumerate(zip(root @ by_pose, -(root @ error[:, :, None])[:, :, 0], strict=True)):
        graph.add(pose_key(int(fixes.node[k])), A, _antenna_key(k), -root[k], b, unit)
    return graph


def _antenna_errors(fixes: AntennaFixes, T_enu_node: FloatArray, antenna_enu: FloatArray) -> FloatArray:
    """(M, 3) m: the antenna on its node's pose, of T_enu_node (K, 4, 4), minus its own unknown g (M, 3)."""
    return np.asarray(fixes.position_enu - fixes.residuals(T_enu_node) - antenna_enu)


def _information_roots(covariance: FloatArray) -> FloatArray:
    """(M, 3, 3) upper triangular S with S^T S = covariance^-1."""
    return np.asarray(np.swapaxes(np.linalg.cholesky(np.linalg.inv(covariance)), 1, 2))


def correlations(t_s: FloatArray, covariance: FloatArray, correlation_s: float) -> FloatArray:
    """(M + 1,) rho between each fix and the one before it; 0 at both ends and where the fix's sigma changes by more than a half."""
    rho = np.zeros(len(t_s) + 1)
    sigma = np.sqrt(np.trace(covariance, axis1=1, axis2=2))
    ratio = sigma[1:] / sigma[:-1]
    same = (ratio < SAME_PROCESS_RATIO) & (ratio > 1.0 / SAME_PROCESS_RATIO)
    rho[1:-1] = np.where(same, np.exp(-np.diff(t_s) / correlation_s), 0.0)
    return np.minimum(rho, 1.0 - 1e-6)  # two fixes at one time


def _gnss_factors(graph: gtsam.NonlinearFactorGraph, fixes: AntennaFixes, noise: DriveNoise) -> None:
    """Add the correlated part of the GNSS model: priors on the g_k and links between them."""
    rho = correlations(fixes.t_s, fixes.covariance, noise.correlation_s)
    unary = ou_unary(rho)
    correlated = (1.0 - noise.white_share**2) * fixes.covariance
    sigma = np.sqrt(np.trace(fixes.covariance, axis1=1, axis2=2))
    for k in range(len(fixes)):
        prior = gtsam.noiseModel.Gaussian.Covariance(correlated[k] / unary[k])
        graph.add(gtsam.PriorFactorPoint3(_antenna_key(k), fixes.position_enu[k], prior))
        if k and rho[k] > 0.0:
            change = (sigma[k] - sigma[k - 1]) / (0.5 * (sigma[k] + sigma[k - 1]))
            spread = 0.5 * (correlated[k - 1] + correlated[k]) * ((1.0 - rho[k] ** 2) / rho[k] + change**2)
            step = fixes.position_enu[k] - fixes.position_enu[k - 1]
            model = gtsam.noiseModel.Gaussian.Covariance(spread)
            graph.add(gtsam.BetweenFactorPoint3(_antenna_key(k - 1), _antenna_key(k), step, model))


@dataclass(frozen=True, slots=True)
class _State:
    """All unknowns at one point: T_enu_node (K, 4, 4), scale s (S,), antenna_enu (M, 3) m, and the same as gtsam's values."""

    T_enu_node: FloatArray
    scale: FloatArray
    antenna_enu: FloatArray
    values: gtsam.Values


def _first_state(links: OdometryLinks, fixes: AntennaFixes, T_enu_node: FloatArray) -> _State:
    """True scale, and every antenna where its node has it."""
    values, scale = _pose_values(T_enu_node), np.zeros(links.stretches)
    antenna = fixes.position_enu - fixes.residuals(T_enu_node)
    for k in range(links.stretches):
        values.insert(scale_key(k), 0.0)
    for k, position in enumerate(antenna):
        values.insert(_antenna_key(k), gtsam.Point3(*position))
    return _State(T_enu_node, scale, antenna, values)


def _retracted(state: _State, step: gtsam.VectorValues) -> _State:
    values = state.values.retract(step)
    scale = np.array([values.atDouble(scale_key(k)) for k in range(len(state.scale))])
    antenna = np.array([values.atPoint3(_antenna_key(k)) for k in range(len(state.antenna_enu))])
    return _State(_poses(values, len(state.T_enu_node)), scale, antenna, values)


@dataclass(frozen=True, slots=True)
class _Equations:
    """The graph's factors: gtsam's own, the odometry's links and the antennas."""

    graph: gtsam.NonlinearFactorGraph
    links: OdometryLinks
    fixes: AntennaFixes
    white_share: float

    def linear(self, at: _State) -> gtsam.GaussianFactorGraph:
        linear = self.graph.linearize(at.values)
        linear.push_back(link_factors(self.links, at.T_enu_node, at.scale))
        linear.push_back(_antenna_factors(self.fixes, self.white_share, at.T_enu_node, at.antenna_enu))
        return linear

    def tree(self, at: _State) -> gtsam.GaussianBayesTree:
        """The Bayes tree by QR: Cholesky fails where a heading that nothing observes stands beside millimetres."""
        return self.linear(at).eliminateMultifrontal(function=gtsam.EliminateQR)

    def cost(self, at: _State) -> float:
        root = _information_roots(self.white_share**2 * self.fixes.covariance)
        whitened = root @ _antenna_errors(self.fixes, at.T_enu_node, at.antenna_enu)[:, :, None]
        own = float(self.graph.error(at.values))
        return own + link_cost(self.links, at.T_enu_node, at.scale) + 0.5 * float((whitened**2).sum())


def _solve(
    chain: OdometryChain, links: OdometryLinks, fixes: AntennaFixes, T_enu_node: FloatArray, noise: DriveNoise
) -> tuple[_State, gtsam.GaussianBayesTree]:
    """Gauss-Newton, with halved steps while the cost would grow, and the Bayes tree at the solution, which knows the marginals."""
    graph = _anchor_factors(chain, noise)
    add_scale_factors(graph, links)
    _gnss_factors(graph, fixes, noise)
    equations = _Equations(graph, links, fixes, noise.white_share)
    state = _first_state(links, fixes, T_enu_node)
    cost = equations.cost(state)
    for _ in range(MAX_ITERATIONS):
        before = cost
        state, cost = _line_search(equations, state, equations.tree(state).optimize(), before)
        if before - cost <= CONVERGED * (before + 1.0):
            break
    return state, equations.tree(state)


def _line_search(equations: _Equations, state: _State, step: gtsam.VectorValues, cost: float) -> tuple[_State, float]:
    """The state after the step, or after the first of its half, quarter, … that lowers the cost; unchanged when none does."""
    for _ in range(MAX_HALVINGS):
        moved = _retracted(state, step)
        new_cost = equations.cost(moved)
        if new_cost < cost:
            return moved, new_cost
        step = step.scale(0.5)
    return state, cost


def _marginal(tree: gtsam.GaussianBayesTree, key: int) -> FloatArray:
    """Covariance of one unknown, (R^T R)^-1 of its marginal. (R is a view: the marginal must live as long.)"""
    marginal = tree.marginalFactor(key, function=gtsam.EliminateQR)
    inverse_root = np.linalg.inv(marginal.R())
    return np.asarray(inverse_root @ inverse_root.T)


def _scale_sigmas(tree: gtsam.GaussianBayesTree, stretches: int) -> FloatArray:
    """(S,) sigma of each scale unknown."""
    variances = [float(_marginal(tree, scale_key(k))[0, 0]) for k in range(stretches)]
    return np.sqrt(np.array(variances, np.float64))


def _left_covariances(tree: gtsam.GaussianBayesTree, T_enu_node: FloatArray) -> FloatArray:
    """(K, 6, 6): T exp(xi) = exp(Ad_T xi) T, after (omega, v) has been put in the order (v, omega)."""
    order = [3, 4, 5, 0, 1, 2]
    right = np.array([_marginal(tree, pose_key(i))[np.ix_(order, order)] for i in range(len(T_enu_node))])
    Ad = se3.adjoint(T_enu_node)
    covariance = Ad @ right @ np.swapaxes(Ad, -1, -2)
    return np.asarray(0.5 * (covariance + np.swapaxes(covariance, -1, -2)))
