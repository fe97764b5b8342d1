"""Odometry factors between neighbouring nodes, with the scale as a slowly varying unknown (an Ornstein-Uhlenbeck process).

Odometry errs in two ways (docs/decisions/0008 says how both were measured):

- White: between nodes L metres of road apart each axis errs by sigma_position^2 = standing^2 + position_noise^2 L, and
  sigma_rotation^2 = standing^2 + rotation_noise^2 L.
- Systematic: stereo measures length by disparity, and an error of the disparity is an error of the scale, larger where the scene is
  far. Every stretch of STRETCH_M of road has an unknown s, metres of road per metre of odometry less one, an Ornstein-Uhlenbeck
  process over the road (sigma `scale_sigma`, length `scale_length_m`).

A link from node i to j, of which odometry says rotation R_ij and translation t_ij, has the error
    e_R = Log(R_ij^T R_i^T R_j),   e_p = R_i^T (p_j - p_i) - (1 + s) t_ij
and, with gtsam's right perturbation (omega, v), R <- R Exp(omega), p <- p + R v, the Jacobians
    by i:  [-Jr^-1(e_R) R_j^T R_i, 0; hat(R_i^T (p_j - p_i)), -I]    by j:  [Jr^-1(e_R), 0; 0, R_i^T R_j]    by s:  [0; -t_ij].
Where the odometry's window of keyframes was weak (darkness, bare walls, few or far points), its covariance says so. It knows only
the noise of grey levels, not what all errs in common, so it widens the white sigmas and never narrows them: with D the diagonal
covariance above and S = window_factor times the window's, a link's is the least that is nowhere below either,
    D^1/2 V max(Lambda, 1) V^T D^1/2   with   V Lambda V^T = D^-1/2 S D^-1/2.
docs/decisions/0041 has how that was chosen.
The factors are linearised here, on arrays. (A factor in Python: gtsam's threads would queue for the interpreter.)
"""

from dataclasses import dataclass, field

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from wayloom.geometry import se3
from wayloom.mapping.drive_types import DriveNoise, OdometryChain

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
STRETCH_M = 10.0


@dataclass(frozen=True, slots=True)
class OdometryLinks:
    """The links of a drive, L of them, and its scale unknowns, S of them.

    first    (L,) row of node i; j = i + 1
    T_i_j    (L, 4, 4) by the odometry
    sigma    (L, 6) rotation rad, position m: the order of gtsam
    stretch  (L,) row of the scale unknown
    scale_sigma, scale_rho  prior sigma of every s; (S + 1,) its correlation with the one before, 0 at both ends
    narrow   (L, 6, 6) what errors over sigma are multiplied by to be white; the identity where none is given
    """

    first: IntArray
    T_i_j: FloatArray
    sigma: FloatArray
    stretch: IntArray
    scale_sigma: float
    scale_rho: FloatArray
    narrow: FloatArray = field(default_factory=lambda: np.zeros((0, 6, 6)))

    def __post_init__(self) -> None:
        if len(self.narrow) != len(self.first):
            object.__setattr__(self, "narrow", np.tile(np.eye(6), (len(self.first), 1, 1)))

    @property
    def stretches(self) -> int:
        """Number of scale unknowns."""
        return len(self.scale_rho) - 1


def ou_unary(rho: FloatArray) -> FloatArray:
    """(S,) weights u_k = 1/(1+rho_k) + 1/(1+rho_{k+1}) - 1 of the priors of an Ornstein-Uhlenbeck chain.

    rho : (S + 1,) correlation of each with the one before it, 0 at both ends. With between weights rho / (1 - rho^2) the density is
    exact: see `wayloom.mapping.drive_graph`.
    """
    return np.asarray(1.0 / (1.0 + rho[:-1]) + 1.0 / (1.0 + rho[1:]) - 1.0)


def stretches_of(middle_m: FloatArray) -> tuple[IntArray, FloatArray]:
    """(L,) the stretch of each link, numbered without gaps, and (S,) m of road to the middle of each stretch.

    middle_m : (L,) m of road to the middle of each link
    """
    number, stretch = np.unique((middle_m // STRETCH_M).astype(np.int64), return_inverse=True)
    return stretch.astype(np.int64), np.asarray((number + 0.5) * STRETCH_M, np.float64)


def chain_correlations(middle_m: FloatArray, scale_length_m: float) -> FloatArray:
    """(S + 1,) correlation of the scale of each stretch, at middle_m (S,) of road, with the one before; 0 at both ends."""
    rho = np.zeros(len(middle_m) + 1)
    rho[1:-1] = np.exp(-np.diff(middle_m) / scale_length_m)
    return rho


def links_of(chain: OdometryChain, noise: DriveNoise) -> OdometryLinks:
    """The odometry between nodes, where the track was not lost. A link of L m errs across by its rotation too, which turns on its
    way."""
    first = np.flatnonzero(chain.connected)
    length = chain.length_m[first]
    stretch, middle_m = stretches_of((np.cumsum(chain.length_m) - 0.5 * chain.length_m)[first])
    rotation = np.hypot(noise.standing_rotation_rad, noise.rotation_rad * np.sqrt(length))
    white = np.hypot(noise.standing_position_m, noise.position_m * np.sqrt(length))
    position = np.hypot(white, noise.rotation_rad * length**1.5 / np.sqrt(3.0))
    T_i_j = se3.inverse(chain.T_world_node[first]) @ chain.T_world_node[first + 1]
    sigma = np.repeat(np.stack([rotation, position], axis=1), 3, axis=1)
    return OdometryLinks(
        first=first,
        T_i_j=T_i_j,
        sigma=sigma,
        stretch=stretch,
        scale_sigma=noise.scale_sigma,
        scale_rho=chain_correlations(middle_m, noise.scale_length_m),
        narrow=narrowing(of_link_errors(noise.window_factor * chain.link_covariance[first], T_i_j), sigma),
    )


def of_link_errors(covariance: FloatArray, T_i_j: FloatArray) -> FloatArray:
    """(L, 6, 6) of (e_R, e_p) from the covariance of xi = (v, omega), exp(xi) T_i_j: e_R = R_ij^T omega, e_p = v + omega x t_ij."""
    J = np.zeros((len(T_i_j), 6, 6))
    J[:, :3, 3:] = np.swapaxes(T_i_j[:, :3, :3], 1, 2)
    J[:, 3:, :3] = np.eye(3)
    J[:, 3:, 3:] = -se3.hat(T_i_j[:, :3, 3])
    return J @ covariance @ np.swapaxes(J, 1, 2)


def narrowing(covariance: FloatArray, sigma: FloatArray) -> FloatArray:
    """(L, 6, 6) max(Lambda, 1)^-1/2 V^T of links' covariances (L, 6, 6) over their sigmas (L, 6); see above."""
    over = covariance / (sigma[:, :, None] * sigma[:, None, :])
    values, V = np.linalg.eigh(over)
    return np.asarray(np.swapaxes(V, 1, 2) / np.sqrt(np.maximum(values, 1.0))[:, :, None])


def link_errors(links: OdometryLinks, T_enu_node: FloatArray, scale: FloatArray) -> FloatArray:
    """(L, 6) rad and m: e_R, e_p at the poses T_enu_node (K, 4, 4) and the scale unknowns (S,)."""
    T_i_j = se3.inverse(T_enu_node[links.first]) @ T_enu_node[links.first + 1]
    turned = np.swapaxes(links.T_i_j[:, :3, :3], 1, 2) @ T_i_j[:, :3, :3]
    moved = T_i_j[:, :3, 3] - (1.0 + scale[links.stretch])[:, None] * links.T_i_j[:, :3, 3]
    return np.hstack([Rotation.from_matrix(turned).as_rotvec(), moved])


def link_jacobians(links: OdometryLinks, T_enu_node: FloatArray, errors: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Jacobians of the errors (L, 6) by node i (L, 6, 6), by node j (L, 6, 6) and by s (L, 6, 1), at T_enu_node (K, 4, 4)."""
    T_i_j = se3.inverse(T_enu_node[links.first]) @ T_enu_node[links.first + 1]
    R_i_j, inverse_Jr = T_i_j[:, :3, :3], inverse_right_jacobian(errors[:, :3])
    by_i, by_j = np.zeros((2, len(errors), 6, 6))
    by_i[:, :3, :3] = -inverse_Jr @ np.swapaxes(R_i_j, 1, 2)
    by_i[:, 3:, :3] = se3.hat(T_i_j[:, :3, 3])
    by_i[:, 3:, 3:] = -np.eye(3)
    by_j[:, :3, :3] = inverse_Jr
    by_j[:, 3:, 3:] = R_i_j
    by_s = np.zeros((len(errors), 6, 1))
    by_s[:, 3:, 0] = -links.T_i_j[:, :3, 3]
    return by_i, by_j, by_s


def inverse_right_jacobian(w: FloatArray) -> FloatArray:
    """Jr^-1 (N, 3, 3) of rotation vectors w (N, 3) rad: Log(Exp(w) Exp(d)) = w + Jr^-1 d (Forster et al., TRO 2017, eq. 9)."""
    angle2 = (w**2).sum(axis=1)
    half = 0.5 * np.sqrt(np.maximum(angle2, 1e-8))
    c = np.where(angle2 < 1e-8, 1.0 / 12.0, (1.0 - half / np.tan(half)) / (4.0 * half**2))
    W = se3.hat(w)
    return np.asarray(np.eye(3) + 0.5 * W + c[:, None, None] * (W @ W))


def pose_key(node: int) -> int:
    """gtsam's key of a node's pose."""
    return int(gtsam.symbol("x", node))


def scale_key(stretch: int) -> int:
    """gtsam's key of a stretch's scale unknown."""
    return int(gtsam.symbol("s", stretch))


def link_factors(links: OdometryLinks, T_enu_node: FloatArray, scale: FloatArray) -> gtsam.GaussianFactorGraph:
    """The links, linear at T_enu_node (K, 4, 4) and scale (S,), whitened."""
    errors = link_errors(links, T_enu_node, scale)
    by_i, by_j, by_s = (links.narrow @ (J / links.sigma[:, :, None]) for J in link_jacobians(links, T_enu_node, errors))
    b = -whitened(links, errors)
    graph, unit = gtsam.GaussianFactorGraph(), gtsam.noiseModel.Unit.Create(6)
    for k, (i, s) in enumerate(zip(links.first.tolist(), links.stretch.tolist(), strict=True)):
        graph.add(pose_key(i), by_i[k], pose_key(i + 1), by_j[k], scale_key(s), by_s[k], b[k], unit)
    return graph


def add_scale_factors(graph: gtsam.NonlinearFactorGraph, links: OdometryLinks) -> None:
    """The Ornstein-Uhlenbeck chain of the scale unknowns."""
    unary = ou_unary(links.scale_rho)
    for k in range(links.stretches):
        prior = gtsam.noiseModel.Isotropic.Sigma(1, links.scale_sigma / np.sqrt(unary[k]))
        graph.add(gtsam.PriorFactorDouble(scale_key(k), 0.0, prior))
        rho = links.scale_rho[k]
        if k and rho > 0.0:
            sigma = links.scale_sigma * np.sqrt((1.0 - rho**2) / rho)
            graph.add(gtsam.BetweenFactorDouble(scale_key(k - 1), scale_key(k), 0.0, gtsam.noiseModel.Isotropic.Sigma(1, sigma)))


def link_cost(links: OdometryLinks, T_enu_node: FloatArray, scale: FloatArray) -> float:
    """Half the sum of squares of the whitened errors, as gtsam counts."""
    return 0.5 * float((whitened(links, link_errors(links, T_enu_node, scale)) ** 2).sum())


def whitened(links: OdometryLinks, errors: FloatArray) -> FloatArray:
    """(L, 6) of the links' errors (L, 6)."""
    return np.asarray((links.narrow @ (errors / links.sigma)[:, :, None])[:, :, 0])
