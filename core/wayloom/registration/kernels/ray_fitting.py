"""Likelihood of points along their rays: where on its ray a point lies, given the surfaces that another view saw.

A point's ray is known, where it ends on it is measured. Its likelihood is therefore the density of the other view's surfaces at the
point over the mean density along the ray. The plain density rewards a pose for laying points where the other view has many,
whatever surface they are on: two views from both ends of a street, dense in other places, are drawn together by that.
"""

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy")
def log_density(p, group, S, a, cells, reach2, outlier, v):  # type: ignore[no-untyped-def]
    """log(1 + sum of densities / outlier) of the points a of the same group at p (3,) m with covariance S (3, 3) m^2; v (3,) is
    filled with its gradient. a, cells as in `wayloom.registration.kernels.fitting.fit_equations`; reach2 m^2."""
    xyz, groups, surface = a
    origin, size_m, shape, start, order = cells
    i0 = int(np.floor((p[0] - origin[0]) / size_m))
    j0 = int(np.floor((p[1] - origin[1]) / size_m))
    k0 = int(np.floor((p[2] - origin[2]) / size_m))
    total = outlier
    v[:] = 0.0
    for i in range(max(i0 - 1, 0), min(i0 + 2, shape[0])):
        for j in range(max(j0 - 1, 0), min(j0 + 2, shape[1])):
            for k in range(max(k0 - 1, 0), min(k0 + 2, shape[2])):
                cell = (i * shape[1] + j) * shape[2] + k
                for s in range(start[cell], start[cell + 1]):
                    m = order[s]
                    if groups[m] != group:
                        continue
                    e0, e1, e2 = xyz[m, 0] - p[0], xyz[m, 1] - p[1], xyz[m, 2] - p[2]
                    if e0 * e0 + e1 * e1 + e2 * e2 > reach2:
                        continue
                    xx, xy, xz = S[0, 0] + surface[m, 0, 0], S[0, 1] + surface[m, 0, 1], S[0, 2] + surface[m, 0, 2]
                    yy, yz, zz = S[1, 1] + surface[m, 1, 1], S[1, 2] + surface[m, 1, 2], S[2, 2] + surface[m, 2, 2]
                    ixx, ixy, ixz = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
                    det = xx * ixx + xy * ixy + xz * ixz
                    iyy, iyz, izz = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
                    v0 = (ixx * e0 + ixy * e1 + ixz * e2) / det
                    v1 = (ixy * e0 + iyy * e1 + iyz * e2) / det
                    v2 = (ixz * e0 + iyz * e1 + izz * e2) / det
                    d2 = e0 * v0 + e1 * v1 + e2 * v2
                    if d2 > 25.0:
                        continue
                    density = np.exp(-0.5 * d2) / np.sqrt(det)
                    total += density
                    v[0] += density * v0
                    v[1] += density * v1
                    v[2] += density * v2
    v /= total
    return np.log(total / outlier)


@njit(cache=True, error_model="numpy")
def add_twist_gradient(weight, p, v, out):  # type: ignore[no-untyped-def]
    """Add to out (6,) weight times the gradient by the left perturbation of a point at p whose gradient is v: (v, p x v)."""
    out[0] += weight * v[0]
    out[1] += weight * v[1]
    out[2] += weight * v[2]
    out[3] += weight * (p[1] * v[2] - p[2] * v[1])
    out[4] += weight * (p[2] * v[0] - p[0] * v[2])
    out[5] += weight * (p[0] * v[1] - p[1] * v[0])


@njit(cache=True, error_model="numpy")
def ray_equations(a, b, rays, half_m, offsets, cells, T, reach_m, spread_m, outlier):  # type: ignore[no-untyped-def]
    """Scores of the left perturbation of T_a_b, summed, and their scatter, which is the information of a likelihood.

    a, b, cells, spread_m, outlier as in `wayloom.registration.kernels.fitting.fit_equations`
    rays     (N, 3) unit, from b's cameras to its points
    half_m   (N,) how far before and behind its point each ray is looked at; 0: the plain density counts
    offsets  (K,) from -1 to 1, in units of half_m
    Returns H (6, 6) = sum s s^T, g (6,) = sum s and the cost, minus the sum of log likelihoods.
    """
    xyz_b, group_b, surface_b = b
    H, g = np.zeros((6, 6)), np.zeros(6)
    p, q, d, v = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    score, S, RS = np.empty(6), np.empty((3, 3)), np.empty((3, 3))
    logs, scores = np.empty(len(offsets)), np.empty((len(offsets), 6))
    cost = 0.0
    for n in range(len(xyz_b)):
        for r in range(3):
            p[r], d[r] = T[r, 3], 0.0
            for c in range(3):
                p[r] += T[r, c] * xyz_b[n, c]
                d[r] += T[r, c] * rays[n, c]
                RS[r, c] = T[r, 0] * surface_b[n, 0, c] + T[r, 1] * surface_b[n, 1, c] + T[r, 2] * surface_b[n, 2, c]
        for r in range(3):
            for c in range(3):
                S[r, c] = RS[r, 0] * T[c, 0] + RS[r, 1] * T[c, 1] + RS[r, 2] * T[c, 2]
            S[r, r] += spread_m * spread_m
        score[:] = 0.0
        value = log_density(p, group_b[n], S, a, cells, reach_m * reach_m, outlier, v)
        add_twist_gradient(1.0, p, v, score)
        if half_m[n] > 0.0:
            scores[:] = 0.0
            for k in range(len(offsets)):
                for r in range(3):
                    q[r] = p[r] + offsets[k] * half_m[n] * d[r]
                logs[k] = log_density(q, group_b[n], S, a, cells, reach_m * reach_m, outlier, v)
                add_twist_gradient(1.0, q, v, scores[k])
            most = logs.max()
            total = np.exp(logs - most).sum()
            value -= most + np.log(total / len(offsets))
            for k in range(len(offsets)):
                share = np.exp(logs[k] - most) / total
                for r in range(6):
                    score[r] -= share * scores[k, r]
        cost -= value
        for r in range(6):
            g[r] += score[r]
            for c in range(6):
                H[r, c] += score[r] * score[c]
    return H, g, cost
