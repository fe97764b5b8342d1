"""Inertial residuals of the window, between keyframes that follow each other, and their normal equations.

A keyframe's inertial state are velocity v (3,) m/s in the world, gyroscope and accelerometer bias (6,). Gravity is one direction
for the drive, g = G (n + B gamma) / |n + B gamma|. The window's state x (1 + 8F + 9F + 2) is the visual one, then v and biases of
each keyframe, then gamma.
"""

from typing import NamedTuple

import numpy as np

from wayloom.odometry.kernels.compiler import kernel, part
from wayloom.odometry.kernels.linear import solve_spd_rows
from wayloom.odometry.kernels.preintegration import (
    fill_exp_so3,
    fill_log_so3,
    inverse_right_jacobian,
    product,
    right_jacobian,
    skew,
    transposed_product,
)

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


class LinkSpace(NamedTuple):
    """Working space of one link, and what its residual and its Jacobian share.

    g (3,) m/s^2 and slope (3, 2) = dg / d gamma; Ra, Rb (3, 3) world from IMU at its ends and pa, pb (3,) the IMU's places;
    R (3, 3), v, p (3,) its motion at the present bias, change (9,) of that since it was integrated (theta first);
    speed, place (3,) what is left of velocity and position in the IMU's frame at its start; turns (4, 3, 3), right (9, 12),
    chain (6, 6), part (9, 6): of link_jacobian; W (15, 15) weight.
    """

    g: np.ndarray
    slope: np.ndarray
    Ra: np.ndarray
    pa: np.ndarray
    Rb: np.ndarray
    pb: np.ndarray
    R: np.ndarray
    v: np.ndarray
    p: np.ndarray
    change: np.ndarray
    speed: np.ndarray
    place: np.ndarray
    turns: np.ndarray
    right: np.ndarray
    chain: np.ndarray
    part: np.ndarray
    W: np.ndarray


def make_link_space() -> LinkSpace:
    """Working space for the kernels of a link."""
    shapes = ((3,), (3, 2), (3, 3), (3,), (3, 3), (3,), (3, 3), (3,), (3,), (9,), (3,), (3,), (4, 3, 3), (9, 12), (6, 6), (9, 6))
    return LinkSpace(*(np.zeros(shape) for shape in (*shapes, (RESIDUALS, RESIDUALS))))


def gravity(gamma, basis, slope):  # type: ignore[no-untyped-def]
    """g (3,) m/s^2; fills slope (3, 2) = dg / d gamma."""
    g = np.empty(3)
    fill_gravity(gamma, basis, g, slope)
    return g


@kernel
def fill_gravity(gamma, basis, g, slope):  # type: ignore[no-untyped-def]
    """gravity into g (3,)."""
    for i in range(3):
        g[i] = basis[i, 0] + gamma[0] * basis[i, 1] + gamma[1] * basis[i, 2]
    length = np.sqrt(g[0] * g[0] + g[1] * g[1] + g[2] * g[2])
    for i in range(3):
        g[i] /= length
    for k in range(2):
        along = g[0] * basis[0, 1 + k] + g[1] * basis[1, 1 + k] + g[2] * basis[2, 1 + k]
        for i in range(3):
            slope[i, k] = STANDARD_GRAVITY * (basis[i, 1 + k] - along * g[i]) / length
    for i in range(3):
        g[i] = STANDARD_GRAVITY * g[i]


@part
def imu_pose(T_cam_world, T_cam_imu, R, place):  # type: ignore[no-untyped-def]
    """Fills R (3, 3) world from IMU, and the IMU's place (3,) in the world."""
    d0, d1, d2 = (T_cam_imu[0, 3] - T_cam_world[0, 3], T_cam_imu[1, 3] - T_cam_world[1, 3], T_cam_imu[2, 3] - T_cam_world[2, 3])
    for i in range(3):
        for j in range(3):
            s = 0.0
            for k in range(3):
                s += T_cam_world[k, i] * T_cam_imu[k, j]
            R[i, j] = s
        place[i] = T_cam_world[0, i] * d0 + T_cam_world[1, i] * d1 + T_cam_world[2, i] * d2


@part
def rotate_back(R, a):  # type: ignore[no-untyped-def]
    """R^T a into a (3,), R (3, 3)."""
    a0, a1, a2 = a[0], a[1], a[2]
    for i in range(3):
        a[i] = R[0, i] * a0 + R[1, i] * a1 + R[2, i] * a2


@part
def link_motion(inertial, T_a, T_b, f, link):  # type: ignore[no-untyped-def]
    """Fills of link what residual and Jacobian share, between T_cam_world T_a and T_b: gravity, the IMU's poses, the motion of link
    f at the present bias of its first keyframe to first order, and what is left of velocity and position."""
    fill_gravity(inertial.gamma, inertial.basis, link.g, link.slope)
    imu_pose(T_a, inertial.T_cam_imu, link.Ra, link.pa)
    imu_pose(T_b, inertial.T_cam_imu, link.Rb, link.pb)
    for i in range(9):
        link.change[i] = 0.0
        for k in range(6):
            link.change[i] += inertial.J[f, i, k] * (inertial.bias[f, k] - inertial.bias_at[f, k])
    fill_exp_so3(link.change, link.turns[0])
    product(inertial.R[f], link.turns[0], link.R)
    dt = inertial.duration[f]
    for i in range(3):
        link.v[i], link.p[i] = inertial.v[f, i] + link.change[3 + i], inertial.p[f, i] + link.change[6 + i]
        va, vb, g = inertial.velocity[f, i], inertial.velocity[f + 1, i], link.g[i]
        link.speed[i] = vb - va - g * dt
        link.place[i] = link.pb[i] - link.pa[i] - va * dt - 0.5 * g * dt * dt
    rotate_back(link.Ra, link.speed)
    rotate_back(link.Ra, link.place)


@part
def link_residual(inertial, T_a, T_b, f, link, r):  # type: ignore[no-untyped-def]
    """Fills r (15,) of link f between T_cam_world T_a and T_b (Forster et al. 2017, eq. 45, and the biases' change)."""
    link_motion(inertial, T_a, T_b, f, link)
    transposed_product(link.Ra, link.Rb, link.turns[0])
    transposed_product(link.R, link.turns[0], link.turns[1])
    fill_log_so3(link.turns[1], r)
    for i in range(3):
        r[3 + i], r[6 + i] = link.speed[i] - link.v[i], link.place[i] - link.p[i]
    for k in range(6):
        r[9 + k] = inertial.bias[f + 1, k] - inertial.bias[f, k]


@part
def link_jacobian(inertial, f, link, r, J):  # type: ignore[no-untyped-def]
    """Fills J (15, 32) = dr / d(pose a, v a, bias a, pose b, v b, bias b, gamma), poses left perturbations of T_cam_world; link and
    r as link_residual leaves them."""
    J[:] = 0.0
    dt, right, part, Ra = inertial.duration[f], link.right, link.part, link.Ra
    Ji, turn, block, turned = link.turns[0], link.turns[1], link.turns[2], link.turns[3]
    inverse_right_jacobian(r, Ji)
    right[:] = 0.0  # by the IMU's own motion: p a, theta a, p b, theta b
    transposed_product(link.Rb, Ra, turn)
    product(Ji, turn, block)
    for i in range(3):
        for j in range(3):
            right[i, 3 + j], right[i, 9 + j] = -block[i, j], Ji[i, j]
    skew(link.speed, turn)
    skew(link.place, block)
    for i in range(3):
        right[6 + i, i] = -1.0
        for j in range(3):
            right[3 + i, 3 + j], right[6 + i, 3 + j] = turn[i, j], block[i, j]
    transposed_product(Ra, link.Rb, turn)
    for i in range(3):
        for j in range(3):
            right[6 + i, 6 + j] = turn[i, j]
    camera_to_imu(inertial.T_cam_imu, turn, link.chain)
    for side in range(2):
        for i in range(9):
            for j in range(6):
                part[i, j] = right[i, 6 * side + j]
        for i in range(9):
            for j in range(6):
                s = 0.0
                for k in range(6):
                    s += part[i, k] * link.chain[k, j]
                J[i, 15 * side + j] = s
    fill_exp_so3(r, turn)
    right_jacobian(link.change, block)
    transposed_product(turn, block, turned)
    product(Ji, turned, turn)
    for i in range(3):
        for j in range(3):
            back = Ra[j, i]
            J[3 + i, 6 + j], J[3 + i, 21 + j], J[6 + i, 6 + j] = -back, back, -dt * back
        for j in range(6):
            s = 0.0
            for k in range(3):
                s += turn[i, k] * inertial.J[f, k, j]
            J[i, 9 + j], J[3 + i, 9 + j], J[6 + i, 9 + j] = -s, -inertial.J[f, 3 + i, j], -inertial.J[f, 6 + i, j]
        for j in range(2):
            s = 0.0
            for k in range(3):
                s += Ra[k, i] * link.slope[k, j]
            J[3 + i, 30 + j], J[6 + i, 30 + j] = -dt * s, -0.5 * dt * dt * s
    for k in range(6):
        J[9 + k, 9 + k], J[9 + k, 24 + k] = -1.0, 1.0


@part
def camera_to_imu(T_cam_imu, block, out):  # type: ignore[no-untyped-def]
    """Fills out (6, 6) from a left perturbation of T_cam_world to the right one of T_world_imu that it is: -Ad(T_imu_cam);
    block (3, 3) is working space."""
    for i in range(3):
        for j in range(3):
            block[i, j] = 0.0
    t0 = -(T_cam_imu[0, 0] * T_cam_imu[0, 3] + T_cam_imu[1, 0] * T_cam_imu[1, 3] + T_cam_imu[2, 0] * T_cam_imu[2, 3])
    t1 = -(T_cam_imu[0, 1] * T_cam_imu[0, 3] + T_cam_imu[1, 1] * T_cam_imu[1, 3] + T_cam_imu[2, 1] * T_cam_imu[2, 3])
    t2 = -(T_cam_imu[0, 2] * T_cam_imu[0, 3] + T_cam_imu[1, 2] * T_cam_imu[1, 3] + T_cam_imu[2, 2] * T_cam_imu[2, 3])
    block[0, 1], block[0, 2], block[1, 0], block[1, 2], block[2, 0], block[2, 1] = -t2, t1, t2, -t0, -t1, t0
    for i in range(3):
        for j in range(3):
            s = 0.0
            for k in range(3):
                s += block[i, k] * T_cam_imu[j, k]
            out[i, j], out[3 + i, 3 + j], out[3 + i, j], out[i, 3 + j] = -T_cam_imu[j, i], -T_cam_imu[j, i], 0.0, -s


@part
def link_information(inertial, f, W):  # type: ignore[no-untyped-def]
    """Fills W (15, 15), the weight of a link's residuals in the energy."""
    W[:] = 0.0
    for i in range(9):
        for j in range(9):
            W[i, j] = inertial.information[f, i, j] * inertial.weight
    for k in range(6):
        W[9 + k, 9 + k] = inertial.weight * inertial.walk[k // 3] / inertial.duration[f]


def add_links(frames, inertial, H, g):  # type: ignore[no-untyped-def]
    """Add the links' normal equations to H and g (1 + 17F + 2); returns their energy. Poses that the prior knows are taken at their
    first estimates in the Jacobians, as those of the photometric residuals are."""
    T_jacobian = np.where(frames.has_first[:, None, None] == 1, frames.T_first, frames.T_cam_world)
    working_space = np.empty((3, RESIDUALS)), np.empty((2, RESIDUALS, UNKNOWNS)), np.empty(UNKNOWNS, np.int64)
    return add_each_link(frames.T_cam_world, T_jacobian, inertial, make_link_space(), *working_space, H, g)


@kernel
def add_each_link(T_cam_world, T_jacobian, inertial, link, vectors, matrices, index, H, g):  # type: ignore[no-untyped-def]
    """add_links with the poses T_jacobian (F, 4, 4) at which Jacobians are taken, and working space vectors (3, 15),
    matrices (2, 15, 32), index (32,)."""
    F, total, W = T_cam_world.shape[0], 0.0, link.W
    r, at_first, Wr, J, WJ = vectors[0], vectors[1], vectors[2], matrices[0], matrices[1]
    for f in range(F - 1):
        if not inertial.has_link[f]:
            continue
        link_residual(inertial, T_cam_world[f], T_cam_world[f + 1], f, link, r)
        link_residual(inertial, T_jacobian[f], T_jacobian[f + 1], f, link, at_first)
        link_jacobian(inertial, f, link, at_first, J)
        link_information(inertial, f, W)
        for side in range(2):
            for k in range(6):
                index[15 * side + k] = 1 + 8 * (f + side) + k
            for k in range(9):
                index[15 * side + 6 + k] = 1 + 8 * F + 9 * (f + side) + k
        index[30], index[31] = 1 + 17 * F, 2 + 17 * F
        product(W, J, WJ)
        for i in range(RESIDUALS):
            s = 0.0
            for k in range(RESIDUALS):
                s += W[i, k] * r[k]
            Wr[i] = s
        for i in range(RESIDUALS):
            total += r[i] * Wr[i]
        for a in range(UNKNOWNS):
            for i in range(RESIDUALS):
                g[index[a]] -= J[i, a] * Wr[i]
                for b in range(UNKNOWNS):
                    H[index[a], index[b]] += J[i, a] * WJ[i, b]
    return total


def links_energy(frames, inertial):  # type: ignore[no-untyped-def]
    """The energy of all links at the present state."""
    return energy_of_each_link(frames.T_cam_world, inertial, make_link_space(), np.empty(RESIDUALS))


@kernel
def energy_of_each_link(T_cam_world, inertial, link, r):  # type: ignore[no-untyped-def]
    """links_energy of T_cam_world (F, 4, 4), with working space r (15,)."""
    total, W = 0.0, link.W
    for f in range(inertial.has_link.shape[0] - 1):
        if inertial.has_link[f]:
            link_residual(inertial, T_cam_world[f], T_cam_world[f + 1], f, link, r)
            link_information(inertial, f, W)
            for i in range(RESIDUALS):
                for k in range(RESIDUALS):
                    total += r[i] * W[i, k] * r[k]
    return total


def inverse_covariance(C):  # type: ignore[no-untyped-def]
    """The inverse (n, n) of a covariance; zeros where it is not positive definite."""
    n = len(C)
    rows = np.empty((n, n))
    return rows.T.copy() if solve_spd_rows(C, np.eye(n), rows) else np.zeros((n, n))
