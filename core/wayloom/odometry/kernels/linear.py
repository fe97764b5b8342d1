"""Small linear algebra: the SE(3) exponential and logarithm, the adjoint, a Cholesky solution with scaling."""

import math

import numpy as np

from wayloom.odometry.kernels.compiler import inlined, kernel, part

SMALL_ANGLE = 1e-6


def exp_se3(xi):  # type: ignore[no-untyped-def]
    """xi (6,) = (v, omega) to T (4, 4): R = I + A W + B W^2, t = (I + B W + C W^2) v (Rodrigues), W^2 = w w^T - |w|^2 I."""
    T = np.empty((4, 4))
    fill_exp_se3(xi, T)
    return T


@kernel
def fill_exp_se3(xi, T):  # type: ignore[no-untyped-def]
    """exp_se3 into T (4, 4)."""
    w0, w1, w2 = xi[3], xi[4], xi[5]
    angle2 = w0 * w0 + w1 * w1 + w2 * w2
    angle, a, b, c = math.sqrt(angle2), 1.0, 0.5, 1.0 / 6.0
    if angle >= SMALL_ANGLE:
        a = math.sin(angle) / angle
        b = (1.0 - math.cos(angle)) / angle2
        c = (1.0 - a) / angle2
    fill_identity(T)
    T[0, 1], T[0, 2], T[1, 0], T[1, 2], T[2, 0], T[2, 1] = -w2, w1, w2, -w0, -w1, w0
    for i in range(3):
        for j in range(3):
            identity, W = (1.0, 0.0) if i == j else (0.0, T[i, j])
            W2 = xi[3 + i] * xi[3 + j] - angle2 * identity
            T[i, j] = identity + (a * W + b * W2)
            T[i, 3] += (identity + b * W + c * W2) * xi[j]


@part
def fill_identity(T):  # type: ignore[no-untyped-def]
    """Make T (4, 4) the identity."""
    for i in range(4):
        for j in range(4):
            T[i, j] = 1.0 if i == j else 0.0


def log_se3(T):  # type: ignore[no-untyped-def]
    """T (4, 4) to xi (6,), the inverse of exp_se3 for rotations under about 3 rad."""
    xi = np.empty(6)
    fill_log_se3(T, xi)
    return xi


@kernel
def fill_log_se3(T, xi):  # type: ignore[no-untyped-def]
    """log_se3 into xi (6,)."""
    v0, v1, v2 = 0.5 * (T[2, 1] - T[1, 2]), 0.5 * (T[0, 2] - T[2, 0]), 0.5 * (T[1, 0] - T[0, 1])
    sine = math.sqrt(v0 * v0 + v1 * v1 + v2 * v2)
    angle = math.atan2(sine, 0.5 * (T[0, 0] + T[1, 1] + T[2, 2] - 1.0))
    scale, c = 1.0, 1.0 / 12.0
    if angle >= SMALL_ANGLE:
        scale = angle / sine
        half = 0.5 * angle
        c = (1.0 - half * math.cos(half) / math.sin(half)) / (angle * angle)
    w0, w1, w2 = scale * v0, scale * v1, scale * v2
    t0, t1, t2 = T[0, 3], T[1, 3], T[2, 3]
    dot, norm2 = w0 * t0 + w1 * t1 + w2 * t2, w0 * w0 + w1 * w1 + w2 * w2
    xi[0] = t0 - 0.5 * (w1 * t2 - w2 * t1) + c * (w0 * dot - norm2 * t0)
    xi[1] = t1 - 0.5 * (w2 * t0 - w0 * t2) + c * (w1 * dot - norm2 * t1)
    xi[2] = t2 - 0.5 * (w0 * t1 - w1 * t0) + c * (w2 * dot - norm2 * t2)
    xi[3], xi[4], xi[5] = w0, w1, w2


@part
def fill_product(A, B, out):  # type: ignore[no-untyped-def]
    """A (4, 4) times B (4, 4), both rigid, into out (4, 4), another array than A and B."""
    fill_identity(out)
    for i in range(3):
        for j in range(4):
            out[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j] + A[i, 3] * B[3, j]


@kernel
def orthonormalise(T):  # type: ignore[no-untyped-def]
    """Make the rotation of T (4, 4) orthonormal again, in place, by Gram-Schmidt on its rows.

    Inverting by transposing turns a rounding error of a rotation into twice that error in the next pose; along a drive it would
    double with every keyframe.
    """
    for i in range(3):
        for j in range(i):
            dot = T[i, 0] * T[j, 0] + T[i, 1] * T[j, 1] + T[i, 2] * T[j, 2]
            for k in range(3):
                T[i, k] -= dot * T[j, k]
        length = math.sqrt(T[i, 0] * T[i, 0] + T[i, 1] * T[i, 1] + T[i, 2] * T[i, 2])
        for k in range(3):
            T[i, k] /= length


def relative(T_target_world, T_host_world):  # type: ignore[no-untyped-def]
    """T_target_host (4, 4) of two rigid T_cam_world (4, 4)."""
    out = np.empty((4, 4))
    fill_relative(T_target_world, T_host_world, out)
    return out


@kernel
def fill_relative(T_target_world, T_host_world, out):  # type: ignore[no-untyped-def]
    """relative into out (4, 4)."""
    fill_identity(out)
    for i in range(3):
        for j in range(3):
            out[i, j] = (
                T_target_world[i, 0] * T_host_world[j, 0]
                + T_target_world[i, 1] * T_host_world[j, 1]
                + T_target_world[i, 2] * T_host_world[j, 2]
            )
        out[i, 3] = T_target_world[i, 3]
    for i in range(3):
        out[i, 3] -= out[i, 0] * T_host_world[0, 3] + out[i, 1] * T_host_world[1, 3] + out[i, 2] * T_host_world[2, 3]


def solve_spd(A, b, x):  # type: ignore[no-untyped-def]
    """Cholesky solution of A x = b into x, A (n, n) scaled to a unit diagonal first; False where A is not positive definite."""
    n = len(b)
    return cholesky_solve(A, b, x, np.empty(n), np.empty((n, n)))


def solve_spd_rows(A, B, X):  # type: ignore[no-untyped-def]
    """solve_spd for each row of B (m, n) into that of X (m, n), A factorised once."""
    n = len(A)
    return cholesky_solve_rows(A, B, X, np.empty(n), np.empty((n, n)))


@kernel
def cholesky_solve(A, b, x, scale, L):  # type: ignore[no-untyped-def]
    """solve_spd with working space scale (n,) and L (n, n)."""
    if not factorise(A, b.shape[0], scale, L):
        return False
    substitute(L, scale, b, x)
    return True


@kernel
def cholesky_solve_rows(A, B, X, scale, L):  # type: ignore[no-untyped-def]
    """solve_spd_rows with working space scale (n,) and L (n, n)."""
    if not factorise(A, B.shape[1], scale, L):
        return False
    for row in range(B.shape[0]):
        substitute(L, scale, B[row], X[row])
    return True


@inlined
def factorise(A, n, scale, L):  # type: ignore[no-untyped-def]
    """Cholesky factor L (n, n, lower) of A (n, n) scaled by scale (n,) to a unit diagonal; False where A is not positive
    definite."""
    for i in range(n):
        if not A[i, i] > 0.0:
            return False
        scale[i] = 1.0 / math.sqrt(A[i, i])
    for i in range(n):
        for j in range(i + 1):
            s = A[i, j] * scale[i] * scale[j]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            if i != j:
                L[i, j] = s / L[j, j]
            elif s > 1e-14:
                L[i, i] = math.sqrt(s)
            else:
                return False
    return True


@inlined
def substitute(L, scale, b, x):  # type: ignore[no-untyped-def]
    """Solution of A x = b into x (n,), by what factorise made of A."""
    n = b.shape[0]
    for i in range(n):
        s = b[i] * scale[i]
        for k in range(i):
            s -= L[i, k] * x[k]
        x[i] = s / L[i, i]
    for i in range(n - 1, -1, -1):
        s = x[i]
        for k in range(i + 1, n):
            s -= L[k, i] * x[k]
        x[i] = s / L[i, i]
    for i in range(n):
        x[i] *= scale[i]


@part
def local_from_host(T_target_host, gain, A):  # type: ignore[no-untyped-def]
    """Fills A (8, 8) = d(local unknowns of the pair) / d(unknowns of the host), gain = exp(a_target - a_host).

    exp(xi_t) T_t T_h^-1 exp(-xi_h) = exp(xi_t - Ad(T_target_host) xi_h) T_target_host to first order; the predicted grey value
    gain (I - b_h) + b_t depends on a_t - a_h and on b_t - gain b_h.
    """
    A[:] = 0.0
    for i in range(3):
        for j in range(3):
            A[i, j] = A[3 + i, 3 + j] = -T_target_host[i, j]
    t0, t1, t2 = T_target_host[0, 3], T_target_host[1, 3], T_target_host[2, 3]
    for j in range(3):  # -hat(t) R
        r0, r1, r2 = T_target_host[0, j], T_target_host[1, j], T_target_host[2, j]
        A[0, 3 + j], A[1, 3 + j], A[2, 3 + j] = t2 * r1 - t1 * r2, t0 * r2 - t2 * r0, t1 * r0 - t0 * r1
    A[6, 6], A[7, 7] = -1.0, -gain
