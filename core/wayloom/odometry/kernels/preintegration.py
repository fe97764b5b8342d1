"""IMU preintegration: samples between two keyframes as one measurement, with its covariance and its change with the biases.

After Forster, Carlone, Dellaert, Scaramuzza, On-Manifold Preintegration for Real-Time Visual-Inertial Odometry, T-RO 2017.
Rows and columns of nine are (theta, v, p), of six (gyroscope bias, accelerometer bias).
"""

import math

import numpy as np

from wayloom.odometry.kernels.compiler import jit
from wayloom.odometry.kernels.linear import SMALL_ANGLE


@jit
def skew(w, out):  # type: ignore[no-untyped-def]
    """Fills out (3, 3) with the matrix of w x."""
    out[0, 0] = out[1, 1] = out[2, 2] = 0.0
    out[0, 1], out[0, 2], out[1, 0], out[1, 2], out[2, 0], out[2, 1] = -w[2], w[1], w[2], -w[0], -w[1], w[0]


@jit
def product(A, B):  # type: ignore[no-untyped-def]
    """A (m, n) times B (n, k), always in the same order of summation."""
    out = np.zeros((A.shape[0], B.shape[1]))
    for i in range(A.shape[0]):
        for k in range(A.shape[1]):
            for j in range(B.shape[1]):
                out[i, j] += A[i, k] * B[k, j]
    return out


@jit
def exp_so3(w):  # type: ignore[no-untyped-def]
    """w (3,) rad to R (3, 3)."""
    angle2 = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    angle, a, b = math.sqrt(angle2), 1.0, 0.5
    if angle >= SMALL_ANGLE:
        a, b = math.sin(angle) / angle, (1.0 - math.cos(angle)) / angle2
    R = np.empty((3, 3))
    skew(w, R)
    for i in range(3):
        for j in range(3):
            identity = 1.0 if i == j else 0.0
            R[i, j] = identity * (1.0 - b * angle2) + a * R[i, j] + b * w[i] * w[j]
    return R


@jit
def log_so3(R):  # type: ignore[no-untyped-def]
    """R (3, 3) to w (3,) rad, for angles under about 3 rad."""
    w = np.array([0.5 * (R[2, 1] - R[1, 2]), 0.5 * (R[0, 2] - R[2, 0]), 0.5 * (R[1, 0] - R[0, 1])])
    sine = math.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    angle = math.atan2(sine, 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1.0))
    if angle >= SMALL_ANGLE:
        w *= angle / sine
    return w


@jit
def right_jacobian(w):  # type: ignore[no-untyped-def]
    """Jr (3, 3) of exp(w + d) = exp(w) exp(Jr d): I - (1 - cos a)/a^2 W + (a - sin a)/a^3 W^2."""
    angle2 = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    angle, b, c = math.sqrt(angle2), 0.5, 1.0 / 6.0
    if angle >= 1e-4:
        b, c = (1.0 - math.cos(angle)) / angle2, (angle - math.sin(angle)) / (angle2 * angle)
    J = np.empty((3, 3))
    skew(w, J)
    for i in range(3):
        for j in range(3):
            identity = 1.0 if i == j else 0.0
            J[i, j] = identity * (1.0 - c * angle2) - b * J[i, j] + c * w[i] * w[j]
    return J


@jit
def inverse_right_jacobian(w):  # type: ignore[no-untyped-def]
    """The inverse (3, 3) of right_jacobian: I + W / 2 + (1/a^2 - (1 + cos a) / (2 a sin a)) W^2."""
    angle2 = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    angle, c = math.sqrt(angle2), 1.0 / 12.0
    if angle >= 1e-4:
        c = 1.0 / angle2 - (1.0 + math.cos(angle)) / (2.0 * angle * math.sin(angle))
    J = np.empty((3, 3))
    skew(w, J)
    for i in range(3):
        for j in range(3):
            identity = 1.0 if i == j else 0.0
            J[i, j] = identity * (1.0 - c * angle2) + 0.5 * J[i, j] + c * w[i] * w[j]
    return J


@jit
def preintegrate(t, force, rate, start, stop, bias, density, R, v, p, J, C):  # type: ignore[no-untyped-def]
    """Integrate the samples from start to stop, linear in between, by the midpoint rule, in the IMU's frame at start.

    t (M,) s increasing, of samples that enclose start to stop; force (M, 3) m/s^2; rate (M, 3) rad/s;
    bias (6,) gyroscope, accelerometer; density (2,): noise of rate (rad/s/sqrt Hz) and force (m/s^2/sqrt Hz).
    Fills R (3, 3), v (3,), p (3,), J (9, 6) their derivative by the biases, C (9, 9) their covariance (eqs. A.7 to A.9 and B).
    """
    R[:], v[:], p[:], J[:], C[:] = np.eye(3), 0.0, 0.0, 0.0, 0.0
    k = max(int(np.searchsorted(t, start, side="right")) - 1, 0)
    begin = start
    while begin < stop and k + 1 < t.shape[0]:
        end = min(stop, t[k + 1])
        step = end - begin
        if step > 0.0:
            middle = (0.5 * (begin + end) - t[k]) / (t[k + 1] - t[k])
            w = rate[k] + middle * (rate[k + 1] - rate[k]) - bias[:3]
            f = force[k] + middle * (force[k + 1] - force[k]) - bias[3:]
            advance(w, f, step, density, R, v, p, J, C)
        begin = end
        k += 1


@jit
def advance(w, f, step, density, R, v, p, J, C):  # type: ignore[no-untyped-def]
    """One step (s) of preintegrate at constant rate w and force f (3,)."""
    turn, half = w * step, 0.5 * step * w
    ahead = exp_so3(half)
    middle, forward = product(R, ahead), np.empty(3)
    for i in range(3):
        forward[i] = ahead[i, 0] * f[0] + ahead[i, 1] * f[1] + ahead[i, 2] * f[2]
    D, Jr, F = exp_so3(turn), right_jacobian(turn), np.empty((3, 3))
    skew(forward, F)
    lever = product(R, F)
    skew(f, F)
    own = 0.5 * step * product(product(middle, F), right_jacobian(half))  # of the rate's error within the step
    A, B = np.eye(9), np.zeros((9, 6))
    for i in range(3):
        A[6 + i, 3 + i] = step
        for j in range(3):
            A[i, j] = D[j, i]
            A[3 + i, j], A[6 + i, j] = -lever[i, j] * step, -0.5 * lever[i, j] * step * step
            B[i, j], B[3 + i, j], B[6 + i, j] = -Jr[i, j] * step, own[i, j] * step, 0.5 * own[i, j] * step * step
            B[3 + i, 3 + j], B[6 + i, 3 + j] = -middle[i, j] * step, -0.5 * middle[i, j] * step * step
    J[:] = product(A, J) + B
    N = B.copy()
    N[:, :3] *= density[0] ** 2 / step
    N[:, 3:] *= density[1] ** 2 / step
    C[:] = product(product(A, C), A.T) + product(N, B.T)
    for i in range(3):
        a = middle[i, 0] * f[0] + middle[i, 1] * f[1] + middle[i, 2] * f[2]
        p[i] += v[i] * step + 0.5 * a * step * step
        v[i] += a * step
    R[:] = product(R, D)


@jit
def predict(T_world_imu, velocity, gravity, duration, R, v, p):  # type: ignore[no-untyped-def]
    """T_world_imu (4, 4) and velocity (3,) `duration` s later, by gravity (3,) m/s^2 and a preintegrated motion."""
    T, new = np.eye(4), np.empty(3)
    start = np.ascontiguousarray(T_world_imu[:3, :3])
    T[:3, :3] = product(start, R)
    for i in range(3):
        dv = start[i, 0] * v[0] + start[i, 1] * v[1] + start[i, 2] * v[2]
        dp = start[i, 0] * p[0] + start[i, 1] * p[1] + start[i, 2] * p[2]
        T[i, 3] = T_world_imu[i, 3] + velocity[i] * duration + 0.5 * gravity[i] * duration**2 + dp
        new[i] = velocity[i] + gravity[i] * duration + dv
    return T, new
