"""Edges of a pose graph in SE(3): errors, Jacobians and normal equations.

Poses T_world_node are perturbed on the right inside the solver, T <- T exp(xi), xi = (v, omega): the equations then
do not depend on where the
world's origin lies. The error of an edge is e = log(Z^-1 T_first^-1 T_second), Z the measurement. To first order
e <- e + J_r^-1(e) xi_second - J_r^-1(e) Ad(T_second^-1 T_first) xi_first (Barfoot, State Estimation for Robotics, ch. 7).
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
SERIES_RAD = 0.05  # below, coefficients by their series: closed forms lose digits


@njit(cache=True, error_model="numpy")
def fill_errors(T: FloatArray, first: IntArray, second: IntArray, measured: FloatArray, errors: FloatArray) -> None:
    """errors (E, 6) of measured (E, 4, 4), between nodes first and second (E,) of T (N, 4, 4)."""
    between, off = np.empty((3, 4)), np.empty((3, 4))
    for e in range(len(first)):
        fill_between(T[first[e]], T[second[e]], between)
        fill_between(measured[e], between, off)
        fill_log(off, errors[e])


@njit(cache=True, error_model="numpy")
def fill_between(A: FloatArray, B: FloatArray, out: FloatArray) -> None:
    """out = A^-1 B, upper three rows of each."""
    for i in range(3):
        for j in range(3):
            out[i, j] = A[0, i] * B[0, j] + A[1, i] * B[1, j] + A[2, i] * B[2, j]
        out[i, 3] = A[0, i] * (B[0, 3] - A[0, 3]) + A[1, i] * (B[1, 3] - A[1, 3]) + A[2, i] * (B[2, 3] - A[2, 3])


@njit(cache=True, error_model="numpy")
def fill_log(T: FloatArray, xi: FloatArray) -> None:
    """xi (6,) = log(T), by the unit quaternion: exact up to half a turn."""
    q = np.empty(4)  # w, x, y, z, from its largest entry (Shepperd 1978)
    trace = T[0, 0] + T[1, 1] + T[2, 2]
    if trace >= max(T[0, 0], T[1, 1], T[2, 2]):
        q[0], q[1], q[2], q[3] = 1.0 + trace, T[2, 1] - T[1, 2], T[0, 2] - T[2, 0], T[1, 0] - T[0, 1]
    else:
        i = 0
        if T[1, 1] > T[0, 0]:
            i = 1
        if T[2, 2] > T[i, i]:
            i = 2
        j, k = (i + 1) % 3, (i + 2) % 3
        q[0] = T[k, j] - T[j, k]
        q[1 + i] = 1.0 + T[i, i] - T[j, j] - T[k, k]
        q[1 + j] = T[j, i] + T[i, j]
        q[1 + k] = T[k, i] + T[i, k]
    if q[0] < 0.0:
        q *= -1.0
    sine = np.sqrt(q[1] ** 2 + q[2] ** 2 + q[3] ** 2)
    factor = 2.0 * np.arctan2(sine, q[0]) / sine if sine > 0.0 else 0.0
    x, y, z = factor * q[1], factor * q[2], factor * q[3]
    c = turn_coefficient(x * x + y * y + z * z)
    a, b, g = T[0, 3], T[1, 3], T[2, 3]
    u, v, w = y * g - z * b, z * a - x * g, x * b - y * a  # omega x t
    xi[0] = a - 0.5 * u + c * (y * w - z * v)
    xi[1] = b - 0.5 * v + c * (z * u - x * w)
    xi[2] = g - 0.5 * w + c * (x * v - y * u)
    xi[3], xi[4], xi[5] = x, y, z


@njit(cache=True, error_model="numpy")
def turn_coefficient(angle2: float) -> float:
    """c of J_l^-1(omega) = I - W / 2 + c W^2, at the angle squared."""
    if angle2 < SERIES_RAD**2:
        return 1.0 / 12.0 + angle2 / 720.0 + angle2 * angle2 / 30240.0
    half = 0.5 * np.sqrt(angle2)
    return (1.0 - half / np.tan(half)) / angle2


@njit(cache=True, error_model="numpy")
def fill_inverse_right_jacobian(xi: FloatArray, out: FloatArray) -> None:
    """J_r^-1 (6, 6) = J_l^-1(-xi) of SE(3) (Barfoot, eqs. 7.85-7.95)."""
    V, W = hat(-xi[:3]), hat(-xi[3:])
    angle2 = xi[3] ** 2 + xi[4] ** 2 + xi[5] ** 2
    if angle2 < SERIES_RAD**2:
        c2, c3, c4 = 1.0 / 6.0 - angle2 / 120.0, 1.0 / 24.0 - angle2 / 720.0, 1.0 / 120.0 - angle2 / 2520.0
    else:
        angle = np.sqrt(angle2)
        sine, cosine = np.sin(angle), np.cos(angle)
        c2 = (angle - sine) / (angle * angle2)
        c3 = (angle2 + 2.0 * cosine - 2.0) / (2.0 * angle2 * angle2)
        c4 = (2.0 * angle - 3.0 * sine + angle * cosine) / (2.0 * angle * angle2 * angle2)
    WV, VW, WW = product(W, V), product(V, W), product(W, W)
    WVW = product(WV, W)
    W_WV, VW_W, WVW_W, W_WVW = product(W, WV), product(VW, W), product(WVW, W), product(W, WVW)
    Q, turn, c1 = np.empty((3, 3)), np.empty((3, 3)), turn_coefficient(angle2)
    for i in range(3):
        for j in range(3):
            cubic = WV[i, j] + VW[i, j] + WVW[i, j]
            Q[i, j] = 0.5 * V[i, j] + c2 * cubic + c3 * (W_WV[i, j] + VW_W[i, j] - 3.0 * WVW[i, j])
            Q[i, j] += c4 * (WVW_W[i, j] + W_WVW[i, j])
            turn[i, j] = (1.0 if i == j else 0.0) - 0.5 * W[i, j] + c1 * WW[i, j]
    shift = product(turn, product(Q, turn))
    for i in range(3):
        for j in range(3):
            out[i, j] = out[3 + i, 3 + j] = turn[i, j]
            out[3 + i, j], out[i, 3 + j] = 0.0, -shift[i, j]


@njit(cache=True, error_model="numpy")
def hat(w: FloatArray) -> FloatArray:
    """Skew matrix (3, 3) of w (3,)."""
    out = np.zeros((3, 3))
    out[0, 1], out[0, 2], out[1, 2] = -w[2], w[1], -w[0]
    out[1, 0], out[2, 0], out[2, 1] = w[2], -w[1], w[0]
    return out


@njit(cache=True, error_model="numpy")
def fill_adjoint(T: FloatArray, out: FloatArray) -> None:
    """Ad(T) (6, 6), of which out holds zeros below the left: [R, hat(t) R; 0, R]."""
    t = hat(T[:3, 3])
    for i in range(3):
        for j in range(3):
            out[i, j] = out[3 + i, 3 + j] = T[i, j]
            out[i, 3 + j] = t[i, 0] * T[0, j] + t[i, 1] * T[1, j] + t[i, 2] * T[2, j]


@njit(cache=True, error_model="numpy")
def product(A: FloatArray, B: FloatArray) -> FloatArray:
    """A B, small."""
    out = np.zeros((A.shape[0], B.shape[1]))
    for i in range(A.shape[0]):
        for k in range(A.shape[1]):
            for j in range(B.shape[1]):
                out[i, j] += A[i, k] * B[k, j]
    return out


@njit(cache=True, error_model="numpy")
def fill_jacobians(
    T: FloatArray,
    first: IntArray,
    second: IntArray,
    measured: FloatArray,
    errors: FloatArray,
    by_first: FloatArray,
    by_second: FloatArray,
) -> None:
    """by_first and by_second (E, 6, 6) of errors (E, 6), between nodes first and second (E,) of T (N, 4, 4)."""
    for e in range(len(first)):
        fill_edge_jacobians(T[first[e]], T[second[e]], errors[e], by_first[e], by_second[e])


@njit(cache=True, error_model="numpy")
def fill_edge_jacobians(A: FloatArray, B: FloatArray, error: FloatArray, by_first: FloatArray, by_second: FloatArray) -> None:
    """Of an edge's error (6,) by its poses A and B (4, 4), perturbed on the right: (6, 6) each."""
    fill_inverse_right_jacobian(error, by_second)
    back = np.empty((3, 4))
    fill_between(B, A, back)
    adjoint = np.zeros((6, 6))
    fill_adjoint(back, adjoint)
    moved = product(by_second, adjoint)
    for i in range(6):
        for j in range(6):
            by_first[i, j] = -moved[i, j]
