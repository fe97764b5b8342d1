"""GNSS fixes as Gaussian factors: correlated noise, time offset of the receiver, lever arm of the antenna.

The unknowns beside the poses are the true place g_k of the antenna at each fix, the receiver's time offset tau (its stamps are
tau too late) and the error delta of the lever arm, in the camera's frame. With p_k, v_k the antenna's place and velocity in the
frame of its node where the stamps are tau_0 too late, and R_k the rotation from the camera at the fix to the node,
    e_k = T_enu_node (p_k - (tau - tau_0) v_k + R_k delta) - g_k.
Noise of fixes is correlated over time (multipath, atmosphere, a filter inside the receiver), so N fixes are not N witnesses: z_k
= g_k + b_k + w_k,   w white with covariance s^2 R_k,   b Ornstein-Uhlenbeck with covariance (1 - s^2) R_k and time T. With rho =
exp(-dt / T) the density of the b_k is, exactly, the product of plain Gaussians exp -1/2 [ sum_k u_k |b_k|^2 + sum_k rho_k / (1 -
rho_k^2) |b_{k+1} - b_k|^2 ],  u_k = 1/(1+rho_{k-1}) + 1/(1+rho_k) - 1 (rho = 0 beyond both ends; |.| weighted by the inverse
covariance), that is priors on g_k and between factors of g_k and g_{k+1}. Where sigma changes slowly the error changes with it:
its relative change, squared, is added to (1 - rho^2) / rho. Where it changes by more than a half from fix to fix (another fix
type) the chain is cut: its errors are another process. Fixes of another height datum than the drive's have an unknown constant in
their heights: the chain of their heights keeps its links and loses its priors; it is cut where the datum changes."""

from dataclasses import replace

import gtsam
import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.mapping.drive_types import AntennaFixes, DriveNoise
from wayloom.mapping.odometry_links import ou_unary, pose_key

FloatArray = NDArray[np.float64]
SAME_PROCESS_RATIO = 1.5
UNKNOWN_HEIGHT_M = 1e3
"""Sigma of the height of another datum."""
RECEIVER = 4
"""Unknowns of the receiver: its time offset, s, and the error of the lever arm, 3 m."""


def antenna_key(fix: int) -> int:
    """gtsam's key of the antenna's true place at a fix."""
    return int(gtsam.symbol("g", fix))


def receiver_key() -> int:
    """gtsam's key of the receiver's time offset and lever arm."""
    return int(gtsam.symbol("r", 0))


def correlations(t_s: FloatArray, covariance: FloatArray, correlation_s: float) -> FloatArray:
    """(M + 1,) rho between each fix and the one before it; 0 at both ends and where the fix's sigma changes by more than a half."""
    rho = np.zeros(len(t_s) + 1)
    sigma = np.sqrt(np.trace(covariance, axis1=1, axis2=2))
    ratio = sigma[1:] / sigma[:-1]
    same = (ratio < SAME_PROCESS_RATIO) & (ratio > 1.0 / SAME_PROCESS_RATIO)
    rho[1:-1] = np.where(same, np.exp(-np.diff(t_s) / correlation_s), 0.0)
    return np.minimum(rho, 1.0 - 1e-6)  # two fixes at one time


def add_correlated_noise(graph: gtsam.NonlinearFactorGraph, fixes: AntennaFixes, noise: DriveNoise) -> None:
    """Add the Ornstein-Uhlenbeck part of the noise: priors on the g_k and links between them."""
    correlated = (1.0 - fixes.white_share**2)[:, None, None] * fixes.covariance
    rho = correlations(fixes.t_s, correlated, noise.correlation_s)
    rho[1:-1][np.diff(fixes.datum) != 0] = 0.0
    unary = ou_unary(rho)
    free = np.zeros((len(fixes), 3, 3))
    free[:, 2, 2] = np.where(fixes.datum, UNKNOWN_HEIGHT_M**2, 0.0)
    sigma = np.sqrt(np.trace(correlated, axis1=1, axis2=2))
    for k in range(len(fixes)):
        prior = gtsam.noiseModel.Gaussian.Covariance(correlated[k] / unary[k] + free[k])
        graph.add(gtsam.PriorFactorPoint3(antenna_key(k), fixes.position_enu[k], prior))
        if k and rho[k] > 0.0:
            change = (sigma[k] - sigma[k - 1]) / (0.5 * (sigma[k] + sigma[k - 1]))
            spread = 0.5 * (correlated[k - 1] + correlated[k]) * ((1.0 - rho[k] ** 2) / rho[k] + change**2)
            step = fixes.position_enu[k] - fixes.position_enu[k - 1]
            model = gtsam.noiseModel.Gaussian.Covariance(spread)
            graph.add(gtsam.BetweenFactorPoint3(antenna_key(k - 1), antenna_key(k), step, model))


def antenna_errors(fixes: AntennaFixes, T_enu_node: FloatArray, receiver: FloatArray, place_enu: FloatArray) -> FloatArray:
    """(M, 3) m: e_k, the antenna on its node's pose minus place_enu (M, 3) m.

    T_enu_node : (K, 4, 4), receiver : (4,) tau in s, delta in m
    """
    return fixes.antenna_enu(T_enu_node, receiver) - place_enu


def antenna_jacobians(fixes: AntennaFixes, T_enu_node: FloatArray, receiver: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Of e_k by the node's pose, gtsam's right (omega, v): (M, 3, 6) [-R hat(p), R]; by the receiver (M, 3, 4) [-R v, R R_k]."""
    R = T_enu_node[fixes.node, :3, :3]
    by_pose = np.concatenate([-R @ se3.hat(fixes.p_node_antenna(receiver)), R], axis=2)
    by_receiver = np.concatenate([-(R @ fixes.v_node_gnss[:, :, None]), R @ fixes.R_node_cam], axis=2)
    return by_pose, by_receiver


def antenna_factors(
    fixes: AntennaFixes, T_enu_node: FloatArray, receiver: FloatArray, place_enu: FloatArray
) -> gtsam.GaussianFactorGraph:
    """e_k linear at T_enu_node (K, 4, 4), receiver (4,) and the g of each fix place_enu (M, 3), whitened."""
    by_pose, by_receiver = antenna_jacobians(fixes, T_enu_node, receiver)
    error = antenna_errors(fixes, T_enu_node, receiver, place_enu)
    root = information_roots(white_covariance(fixes))
    graph = gtsam.GaussianFactorGraph()
    unit, key = gtsam.noiseModel.Unit.Create(3), receiver_key()
    rows = zip(fixes.node.tolist(), root @ by_pose, root @ by_receiver, -(root @ error[:, :, None])[:, :, 0], strict=True)
    for k, (node, A, B, b) in enumerate(rows):
        graph.add(gtsam.JacobianFactor(pose_key(node), A, antenna_key(k), -root[k], key, B, b, unit))
    return graph


def white_covariance(fixes: AntennaFixes) -> FloatArray:
    """(M, 3, 3) m^2 of w_k."""
    return np.asarray((fixes.white_share**2)[:, None, None] * fixes.covariance)


def fix_factors(
    fixes: AntennaFixes, covariance: FloatArray, T_enu_node: FloatArray, receiver: FloatArray
) -> gtsam.GaussianFactorGraph:
    """Fixes with independent noise of covariance (M, 3, 3), no unknown place each: e_k against the fix itself, whitened."""
    by_pose, by_receiver = antenna_jacobians(fixes, T_enu_node, receiver)
    error = antenna_errors(fixes, T_enu_node, receiver, fixes.position_enu)
    root = information_roots(covariance)
    graph = gtsam.GaussianFactorGraph()
    unit, key = gtsam.noiseModel.Unit.Create(3), receiver_key()
    rows = zip(fixes.node.tolist(), root @ by_pose, root @ by_receiver, -(root @ error[:, :, None])[:, :, 0], strict=True)
    for node, A, B, b in rows:
        graph.add(gtsam.JacobianFactor(pose_key(node), A, key, B, b, unit))
    return graph


def receiver_prior(noise: DriveNoise, receiver: FloatArray) -> gtsam.JacobianFactor:
    """The prior of the receiver (4,), linear there, whitened."""
    root = receiver_root(noise)
    return gtsam.JacobianFactor(receiver_key(), root, -root @ receiver, gtsam.noiseModel.Unit.Create(RECEIVER))


def receiver_root(noise: DriveNoise) -> FloatArray:
    """(4, 4) upper triangular S with S^T S the information of the receiver's prior: time offset s, lever arm m."""
    return np.asarray(information_roots(receiver_covariance(noise)[None])[0])


def receiver_covariance(noise: DriveNoise) -> FloatArray:
    """(4, 4) prior covariance of time offset, s, and lever arm, m."""
    if noise.receiver is not None:
        return noise.receiver
    return np.diag(np.square([noise.time_offset_s, noise.lever_m, noise.lever_m, noise.lever_m]))


def with_held(noise: DriveNoise, unknown: int, sigma: float) -> DriveNoise:
    """The noise with one of the receiver's unknowns held at what the fixes are made with."""
    prior = receiver_covariance(noise).copy()
    prior[unknown], prior[:, unknown] = 0.0, 0.0
    prior[unknown, unknown] = sigma**2
    return replace(noise, receiver=prior)


def information_roots(covariance: FloatArray) -> FloatArray:
    """(M, n, n) upper triangular S with S^T S = covariance^-1."""
    return np.asarray(np.swapaxes(np.linalg.cholesky(np.linalg.inv(covariance)), 1, 2))
