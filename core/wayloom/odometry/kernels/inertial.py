"""Inertial residuals of the window, between keyframes that follow each other, and their normal equations.

A keyframe's inertial state are velocity v (3,) m/s in the world, gyroscope and accelerometer bias (6,). Gravity is one direction
for the drive, g = G (n + B gamma) / |n + B gamma|. The window's state x (1 + 8F + 9F + 2) is the visual one, then v and biases of
each keyframe, then gamma.
"""

from typing import NamedTuple

import numpy as np

from wayloom.odometry.kernels.compiler import jit
from wayloom.odometry.kernels.linear import solve_spd
from wayloom.odometry.kernels.preintegration import exp_so3, inverse_right_jacobian, log_so3, product, right_jacobian, skew

STANDARD_GRAVITY = 9.81
RESIDUALS = 15
"""Rotation, velocity, position, gyroscope bias, accelerometer bias."""
UNKNOWNS = 32
"""Of a link: pose, velocity and biases of its first keyframe (15), of its second (15), gamma (2)."""


class Inertial(NamedTuple):
    """The inertial state of F keyframes and the links between them; nothing in it (F = 0) where the log has no IMU.

    velocity, velocity_first (F, 3) m/s; bias, bias_first (F, 6); gamma (2,); basis (3, 3) columns n, B;
    T_cam_imu (4, 4); has_link (F,) 1 where link f leads from keyframe f to f + 1; duration (F,) s;
    R (F, 3, 3), v, p (F, 3), J (F, 9, 6), information (F, 9, 9) of the preintegrated motion at bias_at (F, 6);
    walk (2,) information of a change of the gyroscope's and the accelerometer's bias in one second;
    weight: of all this in the energy.
    """

    velocity: np.ndarray
    velocity_first: np.ndarray
    bias: np.ndarray
    bias_first: np.ndarray
    gamma: np.ndarray
    basis: np.ndarray
    T_cam_imu: np.ndarray
    has_link: np.ndarray
    duration: np.ndarray
    R: np.ndarray
    v: np.ndarray
    p: np.ndarray
    J: np.ndarray
    information: np.ndarray
    bias_at: np.ndarray
    walk: np.ndarray
    weight: float


@jit
def gravity(gamma, basis, slope):  # type: ignore[no-untyped-def]
    """g (3,) m/s^2; fills slope (3, 2) = dg / d gamma."""
    q = basis[:, 0] + gamma[0] * basis[:, 1] + gamma[1] * basis[:, 2]
    length = np.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2])
    n = q / length
    for k in range(2):
        along = n[0] * basis[0, 1 + k] + n[1] * basis[1, 1 + k] + n[2] * basis[2, 1 + k]
        for i in range(3):
            slope[i, k] = STANDARD_GRAVITY * (basis[i, 1 + k] - along * n[i]) / length
    return STANDARD_GRAVITY * n


@jit
def imu_pose(T_cam_world, T_cam_imu):  # type: ignore[no-untyped-def]
    """Rotation (3, 3) world from IMU, and the IMU's place (3,) in the world."""
    turn = np.ascontiguousarray(T_cam_world[:3, :3].T)
    R = product(turn, np.ascontiguousarray(T_cam_imu[:3, :3]))
    d, place = T_cam_imu[:3, 3] - T_cam_world[:3, 3], np.empty(3)
    for i in range(3):
        place[i] = turn[i, 0] * d[0] + turn[i, 1] * d[1] + turn[i, 2] * d[2]
    return R, place


@jit
def rotated_back(R, a):  # type: ignore[no-untyped-def]
    """R^T a, R (3, 3), a (3,)."""
    out = np.empty(3)
    for i in range(3):
        out[i] = R[0, i] * a[0] + R[1, i] * a[1] + R[2, i] * a[2]
    return out


@jit
def corrected(inertial, f):  # type: ignore[no-untyped-def]
    """The motion of link f at the present bias of its first keyframe: R (3, 3), v (3,), p (3,) to first order, and theta (3,)."""
    change, d = np.zeros(9), inertial.bias[f] - inertial.bias_at[f]
    for i in range(9):
        for k in range(6):
            change[i] += inertial.J[f, i, k] * d[k]
    R = product(inertial.R[f], exp_so3(change[:3]))
    return R, inertial.v[f] + change[3:6], inertial.p[f] + change[6:], change[:3]


@jit
def link_residual(inertial, T_a, T_b, f, r):  # type: ignore[no-untyped-def]
    """Fills r (15,) of link f between T_cam_world T_a and T_b (Forster et al. 2017, eq. 45, and the biases' change)."""
    slope = np.empty((3, 2))
    g, dt = gravity(inertial.gamma, inertial.basis, slope), inertial.duration[f]
    Ra, pa = imu_pose(T_a, inertial.T_cam_imu)
    Rb, pb = imu_pose(T_b, inertial.T_cam_imu)
    R, v, p, _ = corrected(inertial, f)
    r[:3] = log_so3(product(np.ascontiguousarray(R.T), product(np.ascontiguousarray(Ra.T), Rb)))
    va, vb = inertial.velocity[f], inertial.velocity[f + 1]
    r[3:6] = rotated_back(Ra, vb - va - g * dt) - v
    r[6:9] = rotated_back(Ra, pb - pa - va * dt - 0.5 * g * dt * dt) - p
    r[9:] = inertial.bias[f + 1] - inertial.bias[f]


@jit
def link_jacobian(inertial, T_a, T_b, f, r, J):  # type: ignore[no-untyped-def]
    """Fills J (15, 32) = dr / d(pose a, v a, bias a, pose b, v b, bias b, gamma), poses left perturbations of T_cam_world."""
    J[:] = 0.0
    slope = np.empty((3, 2))
    g, dt = gravity(inertial.gamma, inertial.basis, slope), inertial.duration[f]
    Ra, pa = imu_pose(T_a, inertial.T_cam_imu)
    Rb, pb = imu_pose(T_b, inertial.T_cam_imu)
    _, _, _, theta = corrected(inertial, f)
    back, Ji = np.ascontiguousarray(Ra.T), inverse_right_jacobian(r[:3])
    right = np.zeros((9, 12))  # by the IMU's own motion: p a, theta a, p b, theta b
    right[:3, 3:6] = -product(Ji, product(np.ascontiguousarray(Rb.T), Ra))
    right[:3, 9:12] = Ji
    va, vb, block = inertial.velocity[f], inertial.velocity[f + 1], np.empty((3, 3))
    skew(rotated_back(Ra, vb - va - g * dt), block)
    right[3:6, 3:6] = block
    skew(rotated_back(Ra, pb - pa - va * dt - 0.5 * g * dt * dt), block)
    right[6:9, 3:6] = block
    right[6:9, 0:3] = -np.eye(3)
    right[6:9, 6:9] = product(back, Rb)
    chain = camera_to_imu(inertial.T_cam_imu)
    J[:9, 0:6], J[:9, 15:21] = (
        product(np.ascontiguousarray(right[:, :6]), chain),
        product(np.ascontiguousarray(right[:, 6:]), chain),
    )
    J[3:6, 6:9], J[3:6, 21:24], J[6:9, 6:9] = -back, back, -dt * back
    turned = product(Ji, product(np.ascontiguousarray(exp_so3(r[:3]).T), right_jacobian(theta)))
    J[:3, 9:15] = -product(turned, np.ascontiguousarray(inertial.J[f, :3]))
    J[3:9, 9:15] = -inertial.J[f, 3:]
    J[3:6, 30:], J[6:9, 30:] = -dt * product(back, slope), -0.5 * dt * dt * product(back, slope)
    for k in range(6):
        J[9 + k, 9 + k], J[9 + k, 24 + k] = -1.0, 1.0


@jit
def camera_to_imu(T_cam_imu):  # type: ignore[no-untyped-def]
    """(6, 6) from a left perturbation of T_cam_world to the right one of T_world_imu that it is: -Ad(T_imu_cam)."""
    R, out, t = np.ascontiguousarray(T_cam_imu[:3, :3].T), np.zeros((6, 6)), np.empty((3, 3))
    skew(-rotated_back(T_cam_imu[:3, :3], T_cam_imu[:3, 3]), t)
    out[:3, :3], out[3:, 3:], out[:3, 3:] = -R, -R, -product(t, R)
    return out


@jit
def link_information(inertial, f, W):  # type: ignore[no-untyped-def]
    """Fills W (15, 15), the weight of a link's residuals in the energy."""
    W[:] = 0.0
    W[:9, :9] = inertial.information[f] * inertial.weight
    for k in range(6):
        W[9 + k, 9 + k] = inertial.weight * inertial.walk[k // 3] / inertial.duration[f]


@jit
def add_links(frames, inertial, H, g):  # type: ignore[no-untyped-def]
    """Add the links' normal equations to H and g (1 + 17F + 2); returns their energy. Poses that the prior knows are taken at their
    first estimates in the Jacobians, as those of the photometric residuals are."""
    F, total = frames.slot.shape[0], 0.0
    r, J, W, index = (
        np.zeros(RESIDUALS),
        np.zeros((RESIDUALS, UNKNOWNS)),
        np.zeros((RESIDUALS, RESIDUALS)),
        np.empty(UNKNOWNS, np.int64),
    )
    at_first = np.zeros(RESIDUALS)
    for f in range(F - 1):
        if not inertial.has_link[f]:
            continue
        T_a = frames.T_first[f] if frames.has_first[f] == 1 else frames.T_cam_world[f]
        T_b = frames.T_first[f + 1] if frames.has_first[f + 1] == 1 else frames.T_cam_world[f + 1]
        link_residual(inertial, frames.T_cam_world[f], frames.T_cam_world[f + 1], f, r)
        link_residual(inertial, T_a, T_b, f, at_first)
        link_jacobian(inertial, T_a, T_b, f, at_first, J)
        link_information(inertial, f, W)
        for side in range(2):
            for k in range(6):
                index[15 * side + k] = 1 + 8 * (f + side) + k
            for k in range(9):
                index[15 * side + 6 + k] = 1 + 8 * F + 9 * (f + side) + k
        index[30], index[31] = 1 + 17 * F, 2 + 17 * F
        WJ, Wr = product(W, J), product(W, r.reshape(-1, 1))
        for i in range(RESIDUALS):
            total += r[i] * Wr[i, 0]
        for a in range(UNKNOWNS):
            for i in range(RESIDUALS):
                g[index[a]] -= J[i, a] * Wr[i, 0]
                for b in range(UNKNOWNS):
                    H[index[a], index[b]] += J[i, a] * WJ[i, b]
    return total


@jit
def links_energy(frames, inertial):  # type: ignore[no-untyped-def]
    """The energy of all links at the present state."""
    total, r, W = 0.0, np.zeros(RESIDUALS), np.zeros((RESIDUALS, RESIDUALS))
    for f in range(inertial.has_link.shape[0] - 1):
        if inertial.has_link[f]:
            link_residual(inertial, frames.T_cam_world[f], frames.T_cam_world[f + 1], f, r)
            link_information(inertial, f, W)
            for i in range(RESIDUALS):
                for k in range(RESIDUALS):
                    total += r[i] * W[i, k] * r[k]
    return total


@jit
def inverse_covariance(C):  # type: ignore[no-untyped-def]
    """The inverse (n, n) of a covariance; zeros where it is not positive definite."""
    n = C.shape[0]
    out, unit, column = np.zeros((n, n)), np.zeros(n), np.zeros(n)
    for k in range(n):
        unit[:] = 0.0
        unit[k] = 1.0
        if not solve_spd(C, unit, column):
            out[:] = 0.0
            return out
        out[:, k] = column
    return out
