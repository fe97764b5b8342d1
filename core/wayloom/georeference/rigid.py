"""Rigid point-set alignment without scale, least-squares and robust."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3

FloatArray = NDArray[np.float64]
Solver = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]

# A level camera that looks north: its x is east, its y down, its z north.
R_ENU_LEVELCAM = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


def align_rigid(points_from: FloatArray, points_to: FloatArray, weights: FloatArray) -> FloatArray:
    """T_to_from (4, 4) that minimises sum w |p_to - T p_from|^2 (Kabsch 1976; Umeyama 1991 without scale).

    points_from, points_to : (N, 3) m, N >= 3 and not on one line, or the rotation about that line is arbitrary
    weights : (N,) >= 0
    """
    total = weights.sum()
    mean_from, mean_to = weights @ points_from / total, weights @ points_to / total
    covariance = (points_to - mean_to).T @ (weights[:, None] * (points_from - mean_from))
    U, _, Vt = np.linalg.svd(covariance)
    R = U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt
    return se3.from_rotation_translation(R, mean_to - R @ mean_from)


def align_yaw(points_from: FloatArray, points_to: FloatArray, weights: FloatArray) -> FloatArray:
    """As `align_rigid`, but only turned about the up axis of both frames: (4, 4) with four degrees of freedom."""
    total = weights.sum()
    mean_from, mean_to = weights @ points_from / total, weights @ points_to / total
    a, b = points_from - mean_from, points_to - mean_to
    yaw = np.arctan2(weights @ (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), weights @ (a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1]))
    c, s = np.cos(yaw), np.sin(yaw)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return se3.from_rotation_translation(R, mean_to - R @ mean_from)


def ransac_yaw(
    points_from: FloatArray, points_to: FloatArray, sigma: FloatArray, threshold_sigma: float, rounds: int
) -> NDArray[np.bool_]:
    """(N,) inliers of the best alignment by yaw and translation through two pairs, judged in the plane. Same input, same answer.

    sigma : (N,) m, horizontal sigma of each pair; a pair fits when it is within threshold_sigma of it
    """
    rng = np.random.default_rng(0)
    best = np.ones(len(points_from), bool)
    best_score = -1.0
    for _ in range(rounds):
        i, j = rng.choice(len(points_from), 2, replace=False)
        span = np.linalg.norm(points_from[j, :2] - points_from[i, :2])
        if span < 2.0 * (sigma[i] + sigma[j]) / threshold_sigma:
            continue  # too close to each other to tell a heading
        pair = [i, j]
        T = align_yaw(points_from[pair], points_to[pair], np.ones(2))
        residual = np.linalg.norm((points_to - se3.transform(T, points_from))[:, :2], axis=1) / sigma
        score = float(np.maximum(1.0 - (residual / threshold_sigma) ** 2, 0.0).sum())  # MSAC, Torr and Zisserman 2000
        if score > best_score:
            best, best_score = residual < threshold_sigma, score
    return best


def align_robust(
    points_from: FloatArray, points_to: FloatArray, sigma: FloatArray, solver: Solver, rounds: int = 20
) -> tuple[FloatArray, FloatArray]:
    """Alignment re-weighted by Cauchy: w = 1 / (sigma^2 + (r / 2.4)^2): T_to_from (4, 4) and residuals (N,) m."""
    weights = 1.0 / sigma**2
    for _ in range(rounds):
        T = solver(points_from, points_to, weights)
        residual = np.linalg.norm(points_to - se3.transform(T, points_from), axis=1)
        weights = 1.0 / (sigma**2 + (residual / 2.385) ** 2)
    return T, residual


def horizontal_spread(points: FloatArray) -> FloatArray:
    """(2,) m: the extent (twice the standard deviation times root three) of points along their two main directions in the plane."""
    centred = points[:, :2] - points[:, :2].mean(axis=0)
    return np.asarray(np.linalg.svd(centred, compute_uv=False) / np.sqrt(len(points)) * 2.0 * np.sqrt(3.0))


def mean_motion(T: FloatArray) -> FloatArray:
    """T (N, 4, 4) to their mean: mean translation, and the rotation nearest to the mean of the matrices (Moakher 2002)."""
    U, _, Vt = np.linalg.svd(T[:, :3, :3].mean(axis=0))
    R = U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt
    return se3.from_rotation_translation(R, T[:, :3, 3].mean(axis=0))
