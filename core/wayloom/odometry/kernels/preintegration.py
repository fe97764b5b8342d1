"""IMU preintegration: samples between two keyframes as one measurement, with its covariance and its change with the biases.

After Forster, Carlone, Dellaert, Scaramuzza, On-Manifold Preintegration for Real-Time Visual-Inertial Odometry, T-RO 2017.
Rows and columns of nine are (theta, v, p), of six (gyroscope bias, accelerometer bias).
"""

import math

import numpy as np

from wayloom.odometry.kernels.compiler import kernel, part
from wayloom.odometry.kernels.linear import SMALL_ANGLE


@part
def skew(w, out):  # type: ignore[no-untyped-def]
    """Fills out (3, 3) with the matrix of w x."""
    out[0, 0] = out[1, 1] = out[2, 2] = 0.0
    out[0, 1], out[0, 2], out[1, 0], out[1, 2], out[2, 0], out[2, 1] = -w[2], w[1], w[2], -w[0], -w[1], w[0]


@part
def product(A, B, out):  # type: ignore[no-untyped-def]
    """A (m, n) times B (n, k) into out (m, k), always in the same order of summation."""
    for i in range(A.shape[0]):
        for j in range(B.shape[1]):
            s = 0.0
            for k in range(A.shape[1]):
                s += A[i, k] * B[k, j]
            out[i, j] = s


@part
def transposed_product(A, B, out):  # type: ignore[no-untyped-def]
    """A^T B into out (m, k), A (n, m), B (n, k), summed as in product."""
    for i in range(A.shape[1]):
        for j in range(B.shape[1]):
            s = 0.0
            for k in range(A.shape[0]):
                s += A[k, i] * B[k, j]
            out[i, j] = s


@part
def product_with_transposed(A, B, out):  # type: ignore[no-untyped-def]
    """A B^T into out (m, k), A (m, n), B (k, n), summed as in product."""
    for i in range(A.shape[0]):
        for j in range(B.shape[0]):
            s = 0.0
            for k in range(A.shape[1]):
                s += A[i, k] * B[j, k]
            out[i, j] = s


@part
def fill_exp_so3(w, R):  # type: ignore[no-untyped-def]
    """w (3,) rad to R (3, 3)."""
    angle2 = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    angle, a, b = math.sqrt(angle2), 1.0, 0.5
    if angle >= SMALL_ANGLE:
        a, b = math.sin(angle) / angle, (1.0 - math.cos(angle)) / angle2
    skew(w, R)
    for i in range(3):
        for j in range(3):
            identity = 1.0 if i == j else 0.0
            R[i, j] = identity * (1.0 - b * angle2) + a * R[i, j] + b * w[i] * w[j]


def log_so3(R):  # type: ignore[no-untyped-def]
    """R (3, 3) to w (3,) rad, for angles under about 3 rad."""
    w = np.empty(3)
    fill_log_so3(np.ascontiguousarray(R), w)
    return w


@kernel
def fill_log_so3(R, w):  # type: ignore[no-untyped-def]
    """log_so3 into w (3,)."""
    w[0], w[1], w[2] = 0.5 * (R[2, 1] - R[1, 2]), 0.5 * (R[0, 2] - R[2, 0]), 0.5 * (R[1, 0] - R[0, 1])
    sine = math.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    angle = math.atan2(sine, 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1.0))
    if angle >= SMALL_ANGLE:
        scale = angle / sine
        for i in range(3):
            w[i] *= scale


@part
def right_jacobian(w, J):  # type: ignore[no-untyped-def]
    """Jr (3, 3) of exp(w + d) = exp(w) exp(Jr d): I - (1 - cos a)/a^2 W + (a - sin a)/a^3 W^2, into J."""
    angle2 = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    angle, b, c = math.sqrt(angle2), 0.5, 1.0 / 6.0
    if angle >= 1e-4:
        b, c = (1.0 - math.cos(angle)) / angle2, (angle - math.sin(angle)) / (angle2 * angle)
    skew(w, J)
    for i in range(3):
        for j in range(3):
            identity = 1.0 if i == j else 0.0
            J[i, j] = identity * (1.0 - c * angle2) - b * J[i, j] + c * w[i] * w[j]


@part
def inverse_right_jacobian(w, J):  # type: ignore[no-untyped-def]
    """The inverse (3, 3) of right_jacobian: I + W / 2 + (1/a^2 - (1 + cos a) / (2 a sin a)) W^2, into J."""
    angle2 = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    angle, c = math.sqrt(angle2), 1.0 / 12.0
    if angle >= 1e-4:
        c = 1.0 / angle2 - (1.0 + math.cos(angle)) / (2.0 * angle * math.sin(angle))
    skew(w, J)
    for i in range(3):
        for j in range(3):
            identity = 1.0 if i == j else 0.0
            J[i, j] = identity * (1.0 - c * angle2) + 0.5 * J[i, j] + c * w[i] * w[j]


def preintegrate(t, force, rate, start, stop, bias, density, R, v, p, J, C):  # type: ignore[no-untyped-def]
    """Integrate the samples from start to stop, linear in between, by the midpoint rule, in the IMU's frame at start.

    t (M,) s increasing, of samples that enclose start to stop; force (M, 3) m/s^2; rate (M, 3) rad/s;
    bias (6,) gyroscope, accelerometer; density (2,): noise of rate (rad/s/sqrt Hz) and force (m/s^2/sqrt Hz).
    Fills R (3, 3), v (3,), p (3,), J (9, 6) their derivative by the biases, C (9, 9) their covariance (eqs. A.7 to A.9 and B).
    """
    R[:], v[:], p[:], J[:], C[:] = np.eye(3), 0.0, 0.0, 0.0, 0.0
    first = max(int(np.searchsorted(t, start, side="right")) - 1, 0)
    working_space = np.empty((5, 3)), np.empty((9, 3, 3)), np.empty((3, 9, 9)), np.empty((3, 9, 6))
    integrate(t, force, rate, first, float(start), float(stop), bias, density, *working_space, R, v, p, J, C)


@kernel
def integrate(  # type: ignore[no-untyped-def]
    t, force, rate, first, start, stop, bias, density, vectors, turns, squares, halves, R, v, p, J, C
):
    """preintegrate from the sample `first` on, with working space vectors (5, 3), turns (9, 3, 3), squares (3, 9, 9),
    halves (3, 9, 6)."""
    w, f = vectors[0], vectors[1]
    k, begin = first, start
    while begin < stop and k + 1 < t.shape[0]:
        end = min(stop, t[k + 1])
        step = end - begin
        if step > 0.0:
            middle = (0.5 * (begin + end) - t[k]) / (t[k + 1] - t[k])
            for i in range(3):
                w[i] = rate[k, i] + middle * (rate[k + 1, i] - rate[k, i]) - bias[i]
                f[i] = force[k, i] + middle * (force[k + 1, i] - force[k, i]) - bias[3 + i]
            advance(w, f, step, density, vectors, turns, squares, halves, R, v, p, J, C)
        begin = end
        k += 1


@part
def advance(w, f, step, density, vectors, turns, squares, halves, R, v, p, J, C):  # type: ignore[no-untyped-def]
    """One step (s) of preintegrate at constant rate w and force f (3,)."""
    turn, half, forward = vectors[2], vectors[3], vectors[4]
    ahead, middle, D, Jr, F = turns[0], turns[1], turns[2], turns[3], turns[4]
    lever, lean, Jr_half, own = turns[5], turns[6], turns[7], turns[8]
    for i in range(3):
        turn[i], half[i] = w[i] * step, 0.5 * step * w[i]
    fill_exp_so3(half, ahead)
    product(R, ahead, middle)
    for i in range(3):
        forward[i] = ahead[i, 0] * f[0] + ahead[i, 1] * f[1] + ahead[i, 2] * f[2]
    fill_exp_so3(turn, D)
    right_jacobian(turn, Jr)
    skew(forward, F)
    product(R, F, lever)
    skew(f, F)
    product(middle, F, lean)
    right_jacobian(half, Jr_half)
    product(lean, Jr_half, own)
    A, AC, noise = squares[0], squares[1], squares[2]
    B, AJ, N = halves[0], halves[1], halves[2]
    for i in range(9):
        for j in range(9):
            A[i, j] = 1.0 if i == j else 0.0
    B[:] = 0.0
    for i in range(3):
        A[6 + i, 3 + i] = step
        for j in range(3):
            of_rate = 0.5 * step * own[i, j]  # of the rate's error within the step
            A[i, j] = D[j, i]
            A[3 + i, j], A[6 + i, j] = -lever[i, j] * step, -0.5 * lever[i, j] * step * step
            B[i, j], B[3 + i, j], B[6 + i, j] = -Jr[i, j] * step, of_rate * step, 0.5 * of_rate * step * step
            B[3 + i, 3 + j], B[6 + i, 3 + j] = -middle[i, j] * step, -0.5 * middle[i, j] * step * step
    product(A, J, AJ)
    for i in range(9):
        for j in range(6):
            J[i, j] = AJ[i, j] + B[i, j]
            N[i, j] = B[i, j] * (density[j // 3] * density[j // 3] / step)
    product(A, C, AC)
    product_with_transposed(AC, A, C)
    product_with_transposed(N, B, noise)
    for i in range(9):
        for j in range(9):
            C[i, j] += noise[i, j]
    for i in range(3):
        a = middle[i, 0] * f[0] + middle[i, 1] * f[1] + middle[i, 2] * f[2]
        p[i] += v[i] * step + 0.5 * a * step * step
        v[i] += a * step
    product(R, D, middle)
    for i in range(3):
        for j in range(3):
            R[i, j] = middle[i, j]


def predict(T_world_imu, velocity, gravity, duration, R, v, p):  # type: ignore[no-untyped-def]
    """T_world_imu (4, 4) and velocity (3,) `duration` s later, by gravity (3,) m/s^2 and a preintegrated motion."""
    T, new = np.eye(4), np.empty(3)
    fill_prediction(T_world_imu, velocity, gravity, duration, R, v, p, T, new)
    return T, new


@kernel
def fill_prediction(T_world_imu, velocity, gravity, duration, R, v, p, T, new):  # type: ignore[no-untyped-def]
    """predict into T (4, 4), the identity before, and new (3,)."""
    for i in range(3):
        for j in range(3):
            s = 0.0
            for k in range(3):
                s += T_world_imu[i, k] * R[k, j]
            T[i, j] = s
        dv = T_world_imu[i, 0] * v[0] + T_world_imu[i, 1] * v[1] + T_world_imu[i, 2] * v[2]
        dp = T_world_imu[i, 0] * p[0] + T_world_imu[i, 1] * p[1] + T_world_imu[i, 2] * p[2]
        T[i, 3] = T_world_imu[i, 3] + velocity[i] * duration + 0.5 * gravity[i] * duration**2 + dp
        new[i] = velocity[i] + gravity[i] * duration + dv
