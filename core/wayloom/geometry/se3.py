"""Rigid motions in SE(3): T_to_from, 4x4 float64, p_to = T_to_from @ p_from. Twists are xi = (v, omega), v in m, omega in rad.

Perturbation is on the left: T <- exp(xi) T. (gtsam perturbs on the right and orders (omega, v): convert at that border only.)
All functions broadcast over leading axes unless they say otherwise.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
SMALL_ANGLE_RAD = 1e-6


def hat(w: Array) -> Array:
    """w (..., 3) to the skew matrix (..., 3, 3) with hat(w) @ p = w x p."""
    out = np.zeros((*w.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -w[..., 2], w[..., 1], -w[..., 0]
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = w[..., 2], -w[..., 1], w[..., 0]
    return out


def exp(xi: Array) -> Array:
    """xi (..., 6) to T (..., 4, 4): R = I + A W + B W^2, t = (I + B W + C W^2) v (Rodrigues)."""
    v, w = xi[..., :3], xi[..., 3:]
    angle = np.linalg.norm(w, axis=-1)
    safe = np.maximum(angle, SMALL_ANGLE_RAD)
    small = angle < SMALL_ANGLE_RAD
    a = np.where(small, 1.0, np.sin(safe) / safe)
    b = np.where(small, 0.5, (1.0 - np.cos(safe)) / safe**2)
    c = np.where(small, 1.0 / 6.0, (1.0 - np.sin(safe) / safe) / safe**2)
    W = hat(w)
    W2 = W @ W
    out = np.zeros((*xi.shape[:-1], 4, 4))
    out[..., :3, :3] = np.eye(3) + a[..., None, None] * W + b[..., None, None] * W2
    V = np.eye(3) + b[..., None, None] * W + c[..., None, None] * W2
    out[..., :3, 3] = (V @ v[..., None])[..., 0]
    out[..., 3, 3] = 1.0
    return out


def log(T: Array) -> Array:
    """T (4, 4) to xi (6,), the inverse of exp for rotations under pi."""
    R = T[:3, :3]
    w2 = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])  # 2 sin(angle) axis
    angle = float(np.arctan2(np.linalg.norm(w2), np.trace(R) - 1.0))
    if angle < SMALL_ANGLE_RAD:
        w = 0.5 * w2
        return np.concatenate([T[:3, 3] - 0.5 * np.cross(w, T[:3, 3]), w])
    if (
        np.trace(R) < 0 and np.linalg.norm(w2) < 1e-5
    ):  # near pi: the axis from the symmetric part, (1 + cos) I + (1 - cos) axis axis^T
        M = 0.5 * (R + R.T) + np.eye(3)
        axis = M[:, int(np.argmax(np.diag(M)))]
        w = angle * axis / np.linalg.norm(axis)
        w = w if w @ w2 >= 0 else -w
    else:
        w = angle * w2 / np.linalg.norm(w2)
    W = hat(w)
    half = 0.5 * angle
    c = (1.0 - half / np.tan(half)) / angle**2
    return np.concatenate([(np.eye(3) - 0.5 * W + c * W @ W) @ T[:3, 3], w])


def inverse(T: Array) -> Array:
    """T (..., 4, 4) to its inverse, by transposing the rotation."""
    out = np.zeros_like(T)
    Rt = np.swapaxes(T[..., :3, :3], -1, -2)
    out[..., :3, :3] = Rt
    out[..., :3, 3] = -(Rt @ T[..., :3, 3:4])[..., 0]
    out[..., 3, 3] = 1.0
    return out


def adjoint(T: Array) -> Array:
    """T (..., 4, 4) to Ad (..., 6, 6) with T exp(xi) = exp(Ad xi) T, for xi = (v, omega)."""
    R, t = T[..., :3, :3], T[..., :3, 3]
    out = np.zeros((*T.shape[:-2], 6, 6))
    out[..., :3, :3] = out[..., 3:, 3:] = R
    out[..., :3, 3:] = hat(t) @ R
    return out


def transform(T: Array, points: Array) -> Array:
    """T_to_from (4, 4) on points_from (N, 3) m, to points_to (N, 3) m."""
    return points @ T[:3, :3].T + T[:3, 3]


def from_rotation_translation(R: Array, t: Array) -> Array:
    """R (..., 3, 3) and t (..., 3) m to T (..., 4, 4)."""
    out = np.zeros((*R.shape[:-2], 4, 4))
    out[..., :3, :3], out[..., :3, 3], out[..., 3, 3] = R, t, 1.0
    return out


def quaternion_wxyz(T: Array) -> Array:
    """T (N, 4, 4) to unit quaternions (N, 4) in (w, x, y, z) order with w >= 0, for the borders of files."""
    R = T[:, :3, :3]
    # Bar-Itzhack 2000: the quaternion is the largest eigenvector of this symmetric matrix; it is stable for every rotation.
    M = np.zeros((len(T), 4, 4))
    M[:, 0, 0] = R[:, 0, 0] + R[:, 1, 1] + R[:, 2, 2]
    M[:, 1, 1] = R[:, 0, 0] - R[:, 1, 1] - R[:, 2, 2]
    M[:, 2, 2] = R[:, 1, 1] - R[:, 0, 0] - R[:, 2, 2]
    M[:, 3, 3] = R[:, 2, 2] - R[:, 0, 0] - R[:, 1, 1]
    M[:, 0, 1] = M[:, 1, 0] = R[:, 2, 1] - R[:, 1, 2]
    M[:, 0, 2] = M[:, 2, 0] = R[:, 0, 2] - R[:, 2, 0]
    M[:, 0, 3] = M[:, 3, 0] = R[:, 1, 0] - R[:, 0, 1]
    M[:, 1, 2] = M[:, 2, 1] = R[:, 0, 1] + R[:, 1, 0]
    M[:, 1, 3] = M[:, 3, 1] = R[:, 0, 2] + R[:, 2, 0]
    M[:, 2, 3] = M[:, 3, 2] = R[:, 1, 2] + R[:, 2, 1]
    q = np.linalg.eigh(M)[1][:, :, -1]
    return np.where(q[:, :1] < 0, -q, q)


def from_quaternion_wxyz(q_wxyz: Array, t: Array) -> Array:
    """Quaternions (..., 4) in (w, x, y, z) order, of any length but 0, and translations (..., 3) m to T (..., 4, 4).

    A quaternion of length 0 gives NaN.
    """
    with np.errstate(invalid="ignore"):
        q = q_wxyz / np.linalg.norm(q_wxyz, axis=-1, keepdims=True)
    w, x, y, z = (q[..., k] for k in range(4))
    T = np.zeros((*q.shape[:-1], 4, 4))
    T[..., 0, 0], T[..., 0, 1], T[..., 0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)
    T[..., 1, 0], T[..., 1, 1], T[..., 1, 2] = 2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)
    T[..., 2, 0], T[..., 2, 1], T[..., 2, 2] = 2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)
    T[..., :3, 3], T[..., 3, 3] = t, 1.0
    return T
