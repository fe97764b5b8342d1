"""Marginalisation of keyframes and points into the window's prior (Engel et al. 2018, sec. 2.3 and 3.1)."""

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.odometry.backend.inertial import inertial_rows, is_inertial, without_keyframe
from wayloom.odometry.backend.window import Window, chosen, keep_points, remove_keyframe
from wayloom.odometry.kernels.adjustment import deviation, reduced_equations
from wayloom.odometry.kernels.arrays import Frames, Rig, Robust
from wayloom.odometry.kernels.inertial import Inertial, add_links

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
FEW_POINTS = 10
GAUGE = 1e10


def leaving_keyframe(frames: Frames, host: NDArray[np.int64]) -> int:
    """Index of the keyframe to marginalise, never one of the newest two: the first that hosts fewer than 10 live points, else the
    one with the largest distance score sqrt(d(i, newest)) sum_j 1/d(i, j) (Engel et al. 2018, eq. 20)."""
    older = len(frames.slot) - 2
    few = np.flatnonzero(np.bincount(host, minlength=older)[:older] < FEW_POINTS)
    if len(few):
        return int(few[0])
    centre = se3.inverse(frames.T_cam_world)[:, :3, 3]
    distance = np.linalg.norm(centre[:, None] - centre[None], axis=2)
    near = 1.0 / (distance[:older, :older] + 1e-5)
    near[np.arange(older), np.arange(older)] = 0.0
    return int(np.argmax(np.sqrt(distance[:older, -1]) * near.sum(axis=1)))


def leaving_points(window: Window, j: int) -> BoolArray:
    """(N,) the points hosted in keyframe j, and those with no residual left in the newest two keyframes."""
    F, p = len(window), window.points
    return np.asarray((p.host == j) | ((p.host < F - 2) & (p.closed[:, F - 2 : F] == 1).all(axis=1)))


def fix_first_estimates(frames: Frames, inertial: Inertial) -> None:
    """From now on the prior speaks of these keyframes: their Jacobians stay where they are."""
    new = frames.has_first == 0
    frames.T_first[new], frames.affine_first[new] = frames.T_cam_world[new], frames.affine[new]
    frames.has_first[new] = 1


def eliminate(H: FloatArray, g: FloatArray, out: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
    """Schur complement of the unknowns `out` of z^T H z - 2 g^T z. Pseudo-inverse after scaling: a, b are poorly conditioned."""
    rest = np.delete(np.arange(len(g)), out)
    H_out, H_rest = H.take(out, axis=0), H.take(rest, axis=0)
    H_own, H_both = H_out.take(out, axis=1), H_out.take(rest, axis=1)
    scale = 1.0 / np.sqrt(H_own.diagonal() + 1e-6)
    scales = scale[:, None] * scale
    inverse = np.linalg.pinv(H_own * scales, hermitian=True) * scales
    B = np.einsum("ij,jk->ik", H_rest.take(out, axis=1), inverse)
    H_rest = H_rest.take(rest, axis=1) - np.einsum("ij,jk->ik", B, H_both)
    return 0.5 * (H_rest + H_rest.T), g[rest] - np.einsum("ij,j->i", B, g[out])


def fold_points(window: Window, fold: BoolArray, rig: Rig, robust: Robust) -> None:
    """Add the residuals of the points in fold (N,) to the prior, the points eliminated."""
    first_prior = not window.has_prior
    fix_first_estimates(window.frames, window.inertial)
    points = chosen(window.points, fold)
    H, g = reduced_equations(window.images, rig, window.frames, points, window.disparity_bias[0], robust)
    if first_prior:
        H[1:7, 1:7] += GAUGE * np.eye(6)  # the drive's first pose is the origin
    add_to_prior(window, H, g)


def fold_links(window: Window, j: int) -> None:
    """Add the IMU's links that keyframe j is an end of to the prior."""
    inertial, n = window.inertial, len(window.prior_g)
    ends = np.isin(np.arange(len(window)), (j - 1, j))
    H, g = np.zeros((n, n)), np.zeros(n)
    add_links(window.frames, inertial._replace(has_link=inertial.has_link * ends), H, g)
    add_to_prior(window, H, g)
    inertial.has_link[ends] = 0


def add_to_prior(window: Window, H: FloatArray, g: FloatArray) -> None:
    """Add normal equations of the present state, of all unknowns or of the first ones, to the prior."""
    n, z = len(g), np.zeros(len(window.prior_g))
    deviation(window.frames, window.disparity_bias[0], window.inertial, z)
    window.prior_H, window.prior_g = window.prior_H.copy(), window.prior_g.copy()
    window.prior_H[:n, :n] += H
    window.prior_g[:n] = window.prior_g[:n] + g + np.einsum("ij,j->i", H, z[:n])


def marginalise(window: Window, j: int, gone: BoolArray, rig: Rig, robust: Robust, affine_prior: tuple[float, float]) -> None:
    """Keyframe j and the points in gone (N,) leave the window for the prior. Residuals of other points in j are dropped, which
    keeps the prior small (Engel et al. 2018, sec. 2.3)."""
    F = len(window)
    fold_points(window, gone & (window.inlier[:, :F] > 0).any(axis=1) & (window.information > 1.0), rig, robust)
    a, b = 7 + 8 * j, 8 + 8 * j
    window.prior_H[[a, b], [a, b]] += affine_prior
    window.prior_g[[a, b]] -= np.array(affine_prior) * window.frames.affine_first[j]
    out = np.arange(1 + 8 * j, 9 + 8 * j)
    if is_inertial(window.inertial):
        fold_links(window, j)
        out = np.concatenate([out, inertial_rows(F, j)])
        window.inertial = without_keyframe(window.inertial, j)
    window.prior_H, window.prior_g = eliminate(window.prior_H, window.prior_g, out)
    keep_points(window, ~gone)
    remove_keyframe(window, j)
