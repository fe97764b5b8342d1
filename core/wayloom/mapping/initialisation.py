"""Chordal initialisation of a pose graph (Carlone et al., Initialization Techniques for 3D SLAM, ICRA 2015).

Rotations first: the sum of w |R_second - R_first R_measured|^2 (Frobenius) is quadratic when the R may be any
matrices; with X = R^T the
three columns of X share one system of 3 x 3 blocks. Its solution is projected to rotations. Then the places, which
are linear once rotations are known.
"""

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.mapping.block_cholesky import block_factor
from wayloom.mapping.pose_graph_equations import GraphEquations

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


def chordal_poses(equations: GraphEquations, T_held: FloatArray, weight: FloatArray) -> FloatArray:
    """Poses (N, 4, 4) without any first guess; T_held (N + 1, 4, 4): where what is held is; weight (E + P,) of edges and priors."""
    R = chordal_rotations(equations, T_held[:, :3, :3], weight)
    t = places(equations, R, T_held[:, :3, 3], weight)
    return se3.from_rotation_translation(R, t)[:-1]


def chordal_rotations(equations: GraphEquations, R_held: FloatArray, weight: FloatArray) -> FloatArray:
    """(N + 1, 3, 3): the relaxed problem's solution, projected."""
    Z = equations.T_first_second[:, :3, :3]
    if equations.planar:
        rotation = equations.information[:, 2, 2]
    else:
        rotation = np.trace(equations.information[:, 3:, 3:], axis1=1, axis2=2) / 3.0
    w = (weight * rotation)[:, None, None] * np.eye(3)
    X = _solve(equations, (w, -w @ Z, w), np.zeros((len(Z), 2, 3, 3)), np.swapaxes(R_held, 1, 2))
    return nearest_rotations(np.swapaxes(X, 1, 2))


def places(equations: GraphEquations, R: FloatArray, t_held: FloatArray, weight: FloatArray) -> FloatArray:
    """(N + 1, 3) m: least squares of R_first^T (t_second - t_first) - t_measured, with rotations R (N + 1, 3, 3) known."""
    T = equations.T_first_second
    if equations.planar:
        omega = np.zeros((len(T), 3, 3))
        omega[:, :2, :2] = equations.information[:, :2, :2]
        omega[:, 2, 2] = np.trace(omega, axis1=1, axis2=2)
    else:
        omega = equations.information[:, :3, :3]
    axes = R[equations.first] @ T[:, :3, :3]  # errors are seen from the measured second pose
    M = weight[:, None, None] * (axes @ omega @ np.swapaxes(axes, 1, 2))
    step = R[equations.first] @ T[:, :3, 3:]
    right = np.stack([-(M @ step), M @ step], axis=1)
    return _solve(equations, (M, -M, M), right, t_held[:, :, None])[:, :, 0]


def _solve(
    equations: GraphEquations, blocks: tuple[FloatArray, FloatArray, FloatArray], right: FloatArray, held: FloatArray
) -> FloatArray:
    """x (N + 1, 3, r) of a linear problem with 3 x 3 blocks of each edge: first-first, first-second, second-second, and right-hand
    sides (E + P, 2, 3, r) at first and second. held (N + 1, 3, r): the values of what is held.
    """
    ii, ij, jj = blocks
    first, second, slot = equations.first, equations.second, equations.slot
    diagonal, off, b = np.zeros((len(equations.held), 3, 3)), np.zeros((equations.pairs + 1, 3, 3)), np.zeros_like(held)
    np.add.at(diagonal, first, ii)
    np.add.at(diagonal, second, jj)
    np.add.at(off, np.where(slot < 0, ~slot, slot), np.where((slot < 0)[:, None, None], np.swapaxes(ij, 1, 2), ij))
    np.add.at(b, first, right[:, 0] - np.where(equations.held[second, None, None], ij @ held[second], 0.0))
    np.add.at(b, second, right[:, 1] - np.where(equations.held[first, None, None], np.swapaxes(ij, 1, 2) @ held[first], 0.0))
    diagonal[equations.held], b[equations.held] = np.eye(3), held[equations.held]
    return block_factor(equations.pattern, diagonal, off[:-1]).solve(b)


def nearest_rotations(M: FloatArray) -> FloatArray:
    """The rotations nearest to matrices (N, 3, 3), Frobenius."""
    U, _, Vt = np.linalg.svd(M)
    U[:, :, 2] *= np.linalg.det(U @ Vt)[:, None]
    return np.asarray(U @ Vt)
