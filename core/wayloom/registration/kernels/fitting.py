"""Expectation maximisation of points on surfaces: soft assignment within classes, Gauss-Newton equations of the pose."""

import numpy as np
from numba import njit

MOST_PARTNERS = 128
"""Points of a that share one point of b, at most; more are left out, in the order of the cells."""


@njit(cache=True, error_model="numpy")
def fit_equations(a, b, cells, T, reach_m, spread_m, outlier):  # type: ignore[no-untyped-def]
    """Normal equations of the left perturbation of T_a_b, and how well each point of b fits.

    a, b     points, groups and covariances: xyz (N, 3) m, group (N,) int8, surface (N, 3, 3) m^2
    cells    a's points by cells: origin (3,) m, size_m no smaller than the reach, shape (3,), start (C + 1,), order (N,)
    spread_m standard deviation that is added to each covariance, for a wide basin
    outlier  density of points that belong to nothing, 1/m^3 (times (2 pi)^1.5)
    Returns H (6, 6), g (6,) with H xi = g, the cost -sum log(outlier + sum of densities), and the sum of weights.
    """
    xyz_a, group_a, surface_a = a
    xyz_b, group_b, surface_b = b
    origin, size_m, shape, start, order = cells
    H, g = np.zeros((6, 6)), np.zeros(6)
    W = np.empty((MOST_PARTNERS, 6))
    v = np.empty((MOST_PARTNERS, 3))
    density = np.empty(MOST_PARTNERS)
    S = np.empty((3, 3))
    RS = np.empty((3, 3))
    A = np.empty((3, 3))
    e = np.empty(3)
    p = np.empty(3)
    J = np.empty((3, 6))
    cost, weight_sum = 0.0, 0.0
    extra, reach2 = spread_m * spread_m, reach_m * reach_m
    for n in range(len(xyz_b)):
        for r in range(3):
            p[r] = T[r, 0] * xyz_b[n, 0] + T[r, 1] * xyz_b[n, 1] + T[r, 2] * xyz_b[n, 2] + T[r, 3]
        i0 = int(np.floor((p[0] - origin[0]) / size_m))
        j0 = int(np.floor((p[1] - origin[1]) / size_m))
        k0 = int(np.floor((p[2] - origin[2]) / size_m))
        for r in range(3):
            for c in range(3):
                RS[r, c] = T[r, 0] * surface_b[n, 0, c] + T[r, 1] * surface_b[n, 1, c] + T[r, 2] * surface_b[n, 2, c]
        for r in range(3):
            for c in range(3):
                S[r, c] = RS[r, 0] * T[c, 0] + RS[r, 1] * T[c, 1] + RS[r, 2] * T[c, 2]
            S[r, r] += extra
        count, total = 0, outlier
        for i in range(max(i0 - 1, 0), min(i0 + 2, shape[0])):
            for j in range(max(j0 - 1, 0), min(j0 + 2, shape[1])):
                for k in range(max(k0 - 1, 0), min(k0 + 2, shape[2])):
                    cell = (i * shape[1] + j) * shape[2] + k
                    for s in range(start[cell], start[cell + 1]):
                        m = order[s]
                        if group_a[m] != group_b[n] or count >= MOST_PARTNERS:
                            continue
                        e[0], e[1], e[2] = xyz_a[m, 0] - p[0], xyz_a[m, 1] - p[1], xyz_a[m, 2] - p[2]
                        if e[0] * e[0] + e[1] * e[1] + e[2] * e[2] > reach2:
                            continue
                        xx, xy, xz = S[0, 0] + surface_a[m, 0, 0], S[0, 1] + surface_a[m, 0, 1], S[0, 2] + surface_a[m, 0, 2]
                        yy, yz, zz = S[1, 1] + surface_a[m, 1, 1], S[1, 2] + surface_a[m, 1, 2], S[2, 2] + surface_a[m, 2, 2]
                        ixx, ixy, ixz = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
                        det = xx * ixx + xy * ixy + xz * ixz
                        iyy, iyz, izz = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
                        v0 = (ixx * e[0] + ixy * e[1] + ixz * e[2]) / det
                        v1 = (ixy * e[0] + iyy * e[1] + iyz * e[2]) / det
                        v2 = (ixz * e[0] + iyz * e[1] + izz * e[2]) / det
                        d2 = e[0] * v0 + e[1] * v1 + e[2] * v2
                        if d2 > 25.0:
                            continue
                        density[count] = np.exp(-0.5 * d2) / np.sqrt(det)
                        W[count, 0], W[count, 1], W[count, 2] = ixx / det, ixy / det, ixz / det
                        W[count, 3], W[count, 4], W[count, 5] = iyy / det, iyz / det, izz / det
                        v[count, 0], v[count, 1], v[count, 2] = v0, v1, v2
                        total += density[count]
                        count += 1
        cost -= np.log(total / outlier)
        if count == 0:
            continue
        A[:] = 0.0
        e[:] = 0.0
        for s in range(count):
            w = density[s] / total
            weight_sum += w
            A[0, 0] += w * W[s, 0]
            A[0, 1] += w * W[s, 1]
            A[0, 2] += w * W[s, 2]
            A[1, 1] += w * W[s, 3]
            A[1, 2] += w * W[s, 4]
            A[2, 2] += w * W[s, 5]
            for r in range(3):
                e[r] += w * v[s, r]
        A[1, 0], A[2, 0], A[2, 1] = A[0, 1], A[0, 2], A[1, 2]
        # exp(xi) p = p + v + omega x p: the columns of J are the unit vectors and -hat(p).
        J[:] = 0.0
        J[0, 0] = J[1, 1] = J[2, 2] = 1.0
        J[0, 4], J[0, 5], J[1, 3], J[1, 5], J[2, 3], J[2, 4] = p[2], -p[1], -p[2], p[0], p[1], -p[0]
        for r in range(6):
            for d in range(3):
                g[r] += J[d, r] * e[d]
            for c in range(6):
                for d in range(3):
                    for f in range(3):
                        H[r, c] += J[d, r] * A[d, f] * J[f, c]
    return H, g, cost, weight_sum
