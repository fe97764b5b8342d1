"""Slow, obvious twins of the kernels."""

import numpy as np

from wayloom.geometry import se3
from wayloom.odometry.kernels.arrays import PATTERN


def sample(image, u, v):
    """Value and gradient at (u, v): bilinear interpolation of the image and of its central differences."""
    image = image.astype(float)
    ix, iy = int(u), int(v)
    a, b = u - ix, v - iy
    out = np.zeros(3)
    for y, wy in ((iy, 1 - b), (iy + 1, b)):
        for x, wx in ((ix, 1 - a), (ix + 1, a)):
            gx, gy = (image[y, x + 1] - image[y, x - 1]) / 2, (image[y + 1, x] - image[y - 1, x]) / 2
            out += wx * wy * np.array([image[y, x], gx, gy])
    return out


def project(T, x, y, rho, rig, right=0.0, delta=0.0):
    """u, v of a point by its ray and inverse depth, in the target's left or right image."""
    p = T[:3, :3] @ np.array([x, y, 1.0]) + rho * (T[:3, 3] + right * np.array([rig.tx, rig.ty, rig.tz]))
    return np.array([rig.fx * p[0] / p[2] + rig.cx - right * delta, rig.fy * p[1] / p[2] + rig.cy])


def patch_terms(image, T, x, y, rho, rig, shift, colours, weights, gain, offset, robust):
    """M, e, energy of patch_residual, pixel by pixel; None outside."""
    h, w = image.shape
    M, e, energy = np.zeros((4, 4)), np.zeros(4), 0.0
    for (dx, dy), colour, weight in zip(PATTERN, colours, weights, strict=True):
        u, v = project(T, x + dx / rig.fx, y + dy / rig.fy, rho, rig) - (shift, 0)
        if not (2 < u < w - 3 and 2 < v < h - 3):
            return None
        value, gx, gy = sample(image, u, v)
        r = value - (gain * colour + offset)
        huber = min(1.0, robust.huber / max(abs(r), 1e-12))
        energy += weight * (r * r if huber == 1.0 else robust.huber * (2 * abs(r) - robust.huber))
        d = np.array([gx, gy, -gain * colour, -1.0])
        M += weight * huber * np.outer(d, d)
        e += weight * huber * d * r
    return M, e, energy


def correlation(image, T, x, y, rho, rig, shift, colours):
    """Of a patch's grey values in a target with those of its host."""
    found = []
    for dx, dy in PATTERN:
        u, v = project(T, x + dx / rig.fx, y + dy / rig.fy, rho, rig) - (shift, 0)
        found.append(sample(image, u, v)[0])
    return np.corrcoef(found, colours)[0, 1]


def tracking_equations(image, reference, T, gain, offset, camera, huber, cutoff):
    """H, g, energy, count, beyond of the tracking kernel; image (h, w)."""
    dy, dx = np.gradient(image.astype(float))
    image = np.dstack([image, dx, dy])
    fx, fy, cx, cy = camera
    h, w = image.shape[:2]
    H, g, energy, count, beyond = np.zeros((8, 8)), np.zeros(8), 0.0, 0, 0
    for x, y, rho, grey in reference:
        p = T[:3, :3] @ np.array([x, y, 1.0]) + rho * T[:3, 3]
        u, v = fx * p[0] / p[2] + cx, fy * p[1] / p[2] + cy
        if p[2] <= 1e-3 or not (2 < u < w - 3 and 2 < v < h - 3):
            continue
        ix, iy = int(u), int(v)
        a, b = u - ix, v - iy
        value = (1 - b) * ((1 - a) * image[iy, ix] + a * image[iy, ix + 1])
        value = value + b * ((1 - a) * image[iy + 1, ix] + a * image[iy + 1, ix + 1])
        r = value[0] - (gain * grey + offset)
        count += 1
        if abs(r) > cutoff:
            energy, beyond = energy + huber * (2 * cutoff - huber), beyond + 1
            continue
        weight = min(1.0, huber / max(abs(r), 1e-12))
        energy += weight * r * r * (2 - weight)
        d_uv = np.array([[fx / p[2], 0, -fx * p[0] / p[2] ** 2], [0, fy / p[2], -fy * p[1] / p[2] ** 2]])
        d_xi = np.column_stack([rho * np.eye(3), -se3.hat(p)])
        J = np.append(value[1:] @ d_uv @ d_xi, [-grey, -1.0])
        H += weight * np.outer(J, J)
        g -= weight * J * r
    return H, g, energy, count, beyond


def schur(H_all, g_all, states):
    """Dense elimination of everything after the first `states` unknowns."""
    A, B, C = H_all[:states, :states], H_all[:states, states:], H_all[states:, states:]
    inverse = np.linalg.inv(C)
    return A - B @ inverse @ B.T, g_all[:states] - B @ inverse @ g_all[states:]
