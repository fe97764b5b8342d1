"""One drive as a factor graph: odometry, GNSS and gravity, in the tangent plane of the drive's own place.

Unknowns: the pose T_enu_node of every node, and for every fix that is kept the true place g of the antenna at that time.

- Odometry between neighbouring nodes, L metres of road apart: error Log(Z^-1 T_i^-1 T_j) with
      sigma_position^2 = standing^2 + position_noise^2 L,   sigma_rotation^2 = standing^2 + rotation_noise^2 L.
  Drift is a random walk; with 0.1 m and 0.05 degrees a root metre it is 1 m (1 %) along the road and 0.5 degrees after 100 m,
  about what stereo odometry has on real streets (scale and calibration errors included). After a loss the link is the
  constant-motion guess and nearly free, so the segments are held together by GNSS.
- GNSS noise is correlated over time (multipath, atmosphere, a filter inside the receiver), so N fixes are not N witnesses. A fix is
      z_k = g_k + b_k + w_k,   w white with covariance s^2 R_k,   b Ornstein-Uhlenbeck with covariance (1 - s^2) R_k and time tau.
  With rho = exp(-dt / tau) the density of the b_k is, exactly, the product of plain Gaussians
      exp -1/2 [ sum_k u_k |b_k|^2 + sum_k rho_k / (1 - rho_k^2) |b_{k+1} - b_k|^2 ],  u_k = 1/(1+rho_{k-1}) + 1/(1+rho_k) - 1
  (rho = 0 beyond both ends; |.| weighted by the inverse covariance), that is priors on g_k and between factors of g_k and g_{k+1}.
  Where sigma changes slowly the error changes with it: its relative change, squared, is added to (1 - rho^2) / rho. Where it
  changes by more than a half from fix to fix (another fix type) the chain is cut: its errors are another process.
- Gravity: a camera is roughly level. On a straight road GNSS cannot tell the roll about the track; this weak prior does.
- Outliers are found first, with independent fixes, by graduated non-convexity (Yang et al., RA-L 2020), then by a chi-square gate.

gtsam perturbs Pose3 on the right and orders (omega, v); results are converted to the left, (v, omega), here and only here.
"""

from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from wayloom.geometry import se3

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
SAME_PROCESS_RATIO = 1.5
LOST_POSITION_M, LOST_ROTATION_RAD = 20.0, 0.5  # a link over a loss, plus half of the guessed distance
MAX_ITERATIONS, MAX_HALVINGS, CONVERGED = 30, 8, 1e-9
GAUGE_POSITION_M, GAUGE_ROTATION_RAD = 1e3, float(np.pi)


@dataclass(frozen=True, slots=True)
class OdometryChain:
    """The nodes of a drive in time order.

    T_world_node  (K, 4, 4) by the odometry
    length_m      (K - 1,) metres of road from each node to the next
    connected     (K - 1,) false where the track was lost between the two
    level         (k,) rows of the nodes that get a level prior
    """

    T_world_node: FloatArray
    length_m: FloatArray
    connected: BoolArray
    level: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class AntennaFixes:
    """GNSS fixes, each seen from a node.

    t_s           (M,) increasing, s
    node          (M,) row of the node
    p_node_gnss   (M, 3) m, the antenna at the time of the fix in the node's camera frame
    position_enu  (M, 3) m
    covariance    (M, 3, 3) m^2
    """

    t_s: FloatArray
    node: NDArray[np.int64]
    p_node_gnss: FloatArray
    position_enu: FloatArray
    covariance: FloatArray

    def __len__(self) -> int:
        return len(self.t_s)

    def take(self, rows: NDArray[np.int64]) -> "AntennaFixes":
        """The fixes of these rows."""
        return AntennaFixes(self.t_s[rows], self.node[rows], self.p_node_gnss[rows], self.position_enu[rows], self.covariance[rows])

    def residuals(self, T_enu_node: FloatArray) -> FloatArray:
        """(M, 3) m: fix minus antenna."""
        T = T_enu_node[self.node]
        antenna = np.einsum("nij,nj->ni", T[:, :3, :3], self.p_node_gnss) + T[:, :3, 3]
        return np.asarray(self.position_enu - antenna)


@dataclass(frozen=True, slots=True)
class DriveNoise:
    """Sigmas of the module's docstring: m and rad, for one metre of road where they grow."""

    position_m: float
    rotation_rad: float
    standing_position_m: float
    standing_rotation_rad: float
    level_rad: float
    correlation_s: float
    white_share: float
    gate_floor_m: float
    gate_probability: float


@dataclass(frozen=True, slots=True)
class DriveSolution:
    """T_enu_node (K, 4, 4); covariance (K, 6, 6) of its left perturbation (v, omega); inlier (M,); residual_enu (M, 3) m."""

    T_enu_node: FloatArray
    covariance: FloatArray
    inlier: BoolArray
    residual_enu: FloatArray


def optimise_drive(chain: OdometryChain, fixes: AntennaFixes, T_enu_node: FloatArray, noise: DriveNoise) -> DriveSolution:
    """The most likely poses of a drive and their covariance.

    T_enu_node : (K, 4, 4) first guess
    A fix that is found to be an outlier is left out altogether; at least one fix is needed.
    """
    motion = _motion_factors(chain, noise)
    inlier = np.ones(len(fixes), bool)
    if len(fixes) >= 4:
        inlier, T_enu_node = _graduated(motion, chain, fixes, T_enu_node, noise)
    inlier &= _gate(fixes, T_enu_node, noise)
    if not inlier.any():  # nothing agrees with the odometry: believe the fixes, not the gate
        inlier[:] = True
    marginals, T_enu_node = _solve_correlated(motion, fixes, inlier, T_enu_node, noise)
    again = _gate(fixes, T_enu_node, noise)
    if again.any() and (again != inlier).any():
        inlier = again
        marginals, T_enu_node = _solve_correlated(motion, fixes, inlier, T_enu_node, noise)
    return DriveSolution(T_enu_node, _left_covariances(marginals, T_enu_node), inlier, fixes.residuals(T_enu_node))


def _pose_key(node: int) -> int:
    return int(gtsam.symbol("x", node))


def _antenna_key(fix: int) -> int:
    return int(gtsam.symbol("g", fix))


def _pose_sigmas(rotation_rad: float, position_m: float) -> gtsam.noiseModel.Diagonal:
    return gtsam.noiseModel.Diagonal.Sigmas(np.array([rotation_rad] * 3 + [position_m] * 3))


def _motion_factors(chain: OdometryChain, noise: DriveNoise) -> gtsam.NonlinearFactorGraph:
    """Odometry, level and gauge: everything but GNSS."""
    graph = gtsam.NonlinearFactorGraph()
    gauge = _pose_sigmas(GAUGE_ROTATION_RAD, GAUGE_POSITION_M)
    graph.add(gtsam.PriorFactorPose3(_pose_key(0), gtsam.Pose3(), gauge))
    for i, (length, connected) in enumerate(zip(chain.length_m, chain.connected, strict=True)):
        rotation = np.hypot(noise.standing_rotation_rad, noise.rotation_rad * np.sqrt(length))
        position = np.hypot(noise.standing_position_m, noise.position_m * np.sqrt(length))
        if not connected:
            rotation, position = LOST_ROTATION_RAD, LOST_POSITION_M + 0.5 * length
        step = gtsam.Pose3(se3.inverse(chain.T_world_node[i]) @ chain.T_world_node[i + 1])
        graph.add(gtsam.BetweenFactorPose3(_pose_key(i), _pose_key(i + 1), step, _pose_sigmas(rotation, position)))
    up, camera_up = gtsam.Unit3(np.array([0.0, 0.0, 1.0])), gtsam.Unit3(np.array([0.0, -1.0, 0.0]))
    for node in chain.level:
        level = gtsam.noiseModel.Isotropic.Sigma(2, noise.level_rad)
        graph.add(gtsam.AttitudeFactorPose3(_pose_key(int(node)), up, level, camera_up))
    return graph


def _pose_values(T_enu_node: FloatArray) -> gtsam.Values:
    values = gtsam.Values()
    for i, T in enumerate(T_enu_node):
        values.insert(_pose_key(i), gtsam.Pose3(T))
    return values


def _poses(values: gtsam.Values, count: int) -> FloatArray:
    return np.array([values.atPose3(_pose_key(i)).matrix() for i in range(count)])


def _judged_covariance(fixes: AntennaFixes, noise: DriveNoise) -> FloatArray:
    return fixes.covariance + noise.gate_floor_m**2 * np.eye(3)


def _gate(fixes: AntennaFixes, T_enu_node: FloatArray, noise: DriveNoise) -> BoolArray:
    """(M,) whether each fix lies within the gate around the antenna's pose."""
    residual = fixes.residuals(T_enu_node)
    distance2 = np.einsum("ni,nij,nj->n", residual, np.linalg.inv(_judged_covariance(fixes, noise)), residual)
    return np.asarray(distance2 <= chi2.ppf(noise.gate_probability, 3))


def _graduated(
    motion: gtsam.NonlinearFactorGraph, chain: OdometryChain, fixes: AntennaFixes, T_enu_node: FloatArray, noise: DriveNoise
) -> tuple[BoolArray, FloatArray]:
    """Inliers by truncated least squares with graduated non-convexity over independent fixes, and the poses that go with them."""
    graph = gtsam.NonlinearFactorGraph(motion)
    known = list(range(graph.size()))
    for i, covariance in enumerate(_judged_covariance(fixes, noise)):
        model = gtsam.noiseModel.Gaussian.Covariance(covariance)
        graph.add(gtsam.GPSFactorArm(_pose_key(int(fixes.node[i])), fixes.position_enu[i], fixes.p_node_gnss[i], model))
    params = gtsam.GncLMParams()
    params.setLossType(gtsam.GncLossType.TLS)
    params.setKnownInliers(known)
    optimiser = gtsam.GncLMOptimizer(graph, _pose_values(T_enu_node), params)
    optimiser.setInlierCostThresholdsAtProbability(noise.gate_probability)
    values = optimiser.optimize()
    inlier = np.asarray(optimiser.getWeights())[len(known) :] > 0.5
    return inlier, _poses(values, len(chain.T_world_node))


def _antenna_factors(fixes: AntennaFixes, white_share: float, values: gtsam.Values) -> gtsam.GaussianFactorGraph:
    """error = T_enu_node p_node_gnss - g, linear at `values`: [-R hat(p), R] for gtsam's right (omega, v), and -I for g.

    (Not a factor in Python: gtsam's threads would queue for the interpreter.)
    """
    poses = [values.atPose3(_pose_key(int(node))).matrix() for node in fixes.node]
    T = np.array(poses)
    R = T[:, :3, :3]
    error = _antenna_errors(fixes, T, values)
    by_pose = np.concatenate([-R @ se3.hat(fixes.p_node_gnss), R], axis=2)
    root = _information_roots(white_share**2 * fixes.covariance)
    graph = gtsam.GaussianFactorGraph()
    unit = gtsam.noiseModel.Unit.Create(3)
    for k, (A, b) in enumerate(zip(root @ by_pose, -(root @ error[:, :, None])[:, :, 0], strict=True)):
        graph.add(_pose_key(int(fixes.node[k])), A, _antenna_key(k), -root[k], b, unit)
    return graph


def _antenna_errors(fixes: AntennaFixes, T_enu_node: FloatArray, values: gtsam.Values) -> FloatArray:
    """(M, 3) m: the antenna on the pose T_enu_node (M, 4, 4) of its node, minus its own unknown g."""
    g = np.array([values.atPoint3(_antenna_key(k)) for k in range(len(fixes))])
    return np.asarray((T_enu_node[:, :3, :3] @ fixes.p_node_gnss[:, :, None])[:, :, 0] + T_enu_node[:, :3, 3] - g)


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
    unary = 1.0 / (1.0 + rho[:-1]) + 1.0 / (1.0 + rho[1:]) - 1.0
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


def _solve_correlated(
    motion: gtsam.NonlinearFactorGraph, fixes: AntennaFixes, inlier: BoolArray, T_enu_node: FloatArray, noise: DriveNoise
) -> tuple[gtsam.Marginals, FloatArray]:
    """Gauss-Newton, with halved steps while the error would grow: marginals at the solution, and T_enu_node (K, 4, 4)."""
    kept = fixes.take(np.flatnonzero(inlier))
    graph = gtsam.NonlinearFactorGraph(motion)
    _gnss_factors(graph, kept, noise)
    values = _pose_values(T_enu_node)
    for k, position in enumerate(kept.position_enu - kept.residuals(T_enu_node)):
        values.insert(_antenna_key(k), gtsam.Point3(*position))
    error = _total_error(graph, kept, noise.white_share, values)
    for _ in range(MAX_ITERATIONS):
        step = _linear(graph, kept, noise.white_share, values).optimize()
        before = error
        values, error = _descend(graph, kept, noise.white_share, values, step, before)
        if before - error <= CONVERGED * (before + 1.0):
            break
    return gtsam.Marginals(_linear(graph, kept, noise.white_share, values), values), _poses(values, len(T_enu_node))


def _linear(
    graph: gtsam.NonlinearFactorGraph, fixes: AntennaFixes, white_share: float, values: gtsam.Values
) -> gtsam.GaussianFactorGraph:
    linear = graph.linearize(values)
    linear.push_back(_antenna_factors(fixes, white_share, values))
    return linear


def _total_error(graph: gtsam.NonlinearFactorGraph, fixes: AntennaFixes, white_share: float, values: gtsam.Values) -> float:
    T = np.array([values.atPose3(_pose_key(int(node))).matrix() for node in fixes.node])
    whitened = _information_roots(white_share**2 * fixes.covariance) @ _antenna_errors(fixes, T, values)[:, :, None]
    return float(graph.error(values)) + 0.5 * float((whitened**2).sum())


def _descend(
    graph: gtsam.NonlinearFactorGraph,
    fixes: AntennaFixes,
    white_share: float,
    values: gtsam.Values,
    step: gtsam.VectorValues,
    error: float,
) -> tuple[gtsam.Values, float]:
    """The values after the step, or after the first of its half, quarter, … that lowers the error; unchanged when none does."""
    for _ in range(MAX_HALVINGS):
        moved = values.retract(step)
        new_error = _total_error(graph, fixes, white_share, moved)
        if new_error < error:
            return moved, new_error
        step = step.scale(0.5)
    return values, error


def _left_covariances(marginals: gtsam.Marginals, T_enu_node: FloatArray) -> FloatArray:
    """(K, 6, 6): T exp(xi) = exp(Ad_T xi) T, after (omega, v) has been put in the order (v, omega)."""
    order = [3, 4, 5, 0, 1, 2]
    right = np.array([marginals.marginalCovariance(_pose_key(i))[np.ix_(order, order)] for i in range(len(T_enu_node))])
    Ad = se3.adjoint(T_enu_node)
    covariance = Ad @ right @ np.swapaxes(Ad, -1, -2)
    return np.asarray(0.5 * (covariance + np.swapaxes(covariance, -1, -2)))
