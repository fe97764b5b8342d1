"""Local planes from moments over the cells of a grid, and the fusion of points with them.

A cell's plane is fitted to the points of its own and of the neighbouring cells, weights 1, 1/2, 1/4, 1/8 for 0 to 3 axes apart.
Points and cells have a group (ground, upright, none); planes are of one group. All sums run in the order of the rows, and over the
neighbours in one fixed order, so equal neighbourhoods give equal bits.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from wayloom.stitching.kernels.cells import CELLS_PER_AXIS, find

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
MOMENTS = 11  # weight, 3 of x, 6 of x x^T (upper triangle), robust count
SWEEPS = 8
LEAST_SINE = 0.05


@njit(cache=True, error_model="numpy")
def normal_variance(sigma2, across2, ray, common, n):  # type: ignore[no-untyped-def]
    """m^2 along the unit normal n (3,) of a point: sigma2 along its ray (3,), across2 across it, and common (3, 3)."""
    along = n[0] * ray[0] + n[1] * ray[1] + n[2] * ray[2]
    total = across2 + (sigma2 - across2) * along * along
    for i in range(3):
        for j in range(3):
            total += n[i] * common[i, j] * n[j]
    return total


@njit(cache=True, error_model="numpy")
def add_moments(cell, local, sigma2, across2, ray, common, plane, moments):  # type: ignore[no-untyped-def]
    """Add the points' moments to those of their cells, in place.

    cell (P,) row, -1: not counted; local (P, 3) m from the corner of the cell; sigma2, across2 (P,) m^2; ray (P, 3); common
    (P, 3, 3) m^2; plane (C, 7) of an earlier sweep (offset from the cell's corner), support 0: none; moments (C, MOMENTS).

    Without a plane a point weighs 1 / variance. With one, variance is that along the normal, and the weight that of Geman and
    McClure, 1 / (1 + r^2 / 4 v)^2 with r the distance and v the variance of point and surface.
    """
    for p in range(len(cell)):
        c = cell[p]
        if c < 0:
            continue
        variance, robust = sigma2[p] + (common[p, 0, 0] + common[p, 1, 1] + common[p, 2, 2]) / 3.0, 1.0
        if plane[c, 6] > 0.0:
            n = plane[c, 0:3]
            variance = normal_variance(sigma2[p], across2[p], ray[p], common[p], n)
            r = local[p, 0] * n[0] + local[p, 1] * n[1] + local[p, 2] * n[2] - plane[c, 3]
            ratio = 1.0 + r * r / (4.0 * (variance + plane[c, 4]))
            robust = 1.0 / (ratio * ratio)
        w = robust / variance
        moments[c, 0] += w
        k = 4
        for i in range(3):
            moments[c, 1 + i] += w * local[p, i]
            for j in range(i, 3):
                moments[c, k] += w * local[p, i] * local[p, j]
                k += 1
        moments[c, 10] += robust


@njit(cache=True, error_model="numpy")
def smallest_direction(A, values, V):  # type: ignore[no-untyped-def]
    """Eigenvalues (3,), increasing, and eigenvectors (3, 3), columns, of a symmetric A (3, 3), overwritten, by cyclic Jacobi."""
    V[:] = 0.0
    for i in range(3):
        V[i, i] = 1.0
    for _ in range(SWEEPS):
        off = abs(A[0, 1]) + abs(A[0, 2]) + abs(A[1, 2])
        if off <= 1e-15 * (abs(A[0, 0]) + abs(A[1, 1]) + abs(A[2, 2])):
            break
        for i in range(2):
            for j in range(i + 1, 3):
                if A[i, j] == 0.0:
                    continue
                theta = 0.5 * (A[j, j] - A[i, i]) / A[i, j]
                t = 1.0 / (abs(theta) + np.sqrt(theta * theta + 1.0))
                if theta < 0.0:
                    t = -t
                c = 1.0 / np.sqrt(t * t + 1.0)
                s = t * c
                for k in range(3):
                    a, b = A[k, i], A[k, j]
                    A[k, i], A[k, j] = c * a - s * b, s * a + c * b
                for k in range(3):
                    a, b = A[i, k], A[j, k]
                    A[i, k], A[j, k] = c * a - s * b, s * a + c * b
                for k in range(3):
                    a, b = V[k, i], V[k, j]
                    V[k, i], V[k, j] = c * a - s * b, s * a + c * b
    for i in range(3):
        values[i] = A[i, i]
    for i in range(2):
        for j in range(2 - i):
            if values[j] > values[j + 1]:
                values[j], values[j + 1] = values[j + 1], values[j]
                for k in range(3):
                    V[k, j], V[k, j + 1] = V[k, j + 1], V[k, j]


@njit(cache=True, error_model="numpy")
def fit_planes(key, table, steps, moments, cell_m, least_points, floor2, plane):  # type: ignore[no-untyped-def]
    """The plane of each cell, in place.

    key (C,) packed cells; steps (27, 4) int64: packed difference to each neighbour, and its axes, the cell itself first; moments
    (C, MOMENTS); plane (C, 7): normal, offset from the cell's corner, scatter of the surface m^2 (at least floor2), m^2 of its own
    place, robust count (0: no plane).
    """
    total = np.empty(MOMENTS)
    A, V, values = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    for c in range(len(key)):
        total[:] = 0.0
        for s in range(len(steps)):
            other = c if s == 0 else find(key[c] + steps[s, 0], key, table)
            if other < 0:
                continue
            _add_shifted(moments[other], steps[s], cell_m, total)
        plane[c] = 0.0
        if total[10] < least_points or total[0] <= 0.0:
            continue
        _covariance(total, A)
        smallest_direction(A, values, V)
        if values[1] < 4.0 * values[0] or values[1] < (0.25 * cell_m) ** 2:
            continue
        w = total[0]
        expected = total[10] / w  # the mean variance: each weight is a robust one over a variance
        for i in range(3):
            plane[c, i] = V[i, 0]
        plane[c, 3] = (V[0, 0] * total[1] + V[1, 0] * total[2] + V[2, 0] * total[3]) / w
        plane[c, 4] = max(values[0] - expected, 0.0) + floor2
        plane[c, 5] = values[0] / total[10] + 1.0 / w
        plane[c, 6] = total[10]


@njit(cache=True, error_model="numpy")
def _add_shifted(m, step, cell_m, total):  # type: ignore[no-untyped-def]
    """Add moments about a neighbour's corner as moments about this cell's corner."""
    k, weight = 4, 0.5 ** (abs(step[1]) + abs(step[2]) + abs(step[3]))
    for i in range(3):
        di = step[1 + i] * cell_m
        total[1 + i] += weight * (m[1 + i] + m[0] * di)
        for j in range(i, 3):
            dj = step[1 + j] * cell_m
            total[k] += weight * (m[k] + m[1 + i] * dj + m[1 + j] * di + m[0] * di * dj)
            k += 1
    total[0] += weight * m[0]
    total[10] += weight * m[10]


@njit(cache=True, error_model="numpy")
def _covariance(total, A):  # type: ignore[no-untyped-def]
    k, w = 4, total[0]
    for i in range(3):
        for j in range(i, 3):
            A[i, j] = total[k] / w - total[1 + i] * total[1 + j] / (w * w)
            A[j, i] = A[i, j]
            k += 1


@njit(cache=True, error_model="numpy")
def fuse(xyz, group, sigma2, across2, ray, common, key, table, low, steps, plane, cell_m, reach_m, gate2, fused, variance, surface):  # type: ignore[no-untyped-def]
    """Move points onto the surfaces that they see within their uncertainty, in place.

    xyz (P, 3) m; group (P,) 0: no surface is looked for; low (3,) int64 the cell that packs to 0; steps as in `fit_planes`, its own
    and its six faces' first; reach_m how far along its ray a surface is looked for, and a point moved along an axis; gate2: largest
    squared distance in units of the variance. fused (P, 3) m; variance (P,) m^2 along the normal; surface (P,) row of the plane's
    cell, -1: none.

    The plane is a measurement n^T x = d of variance v_s (scatter and place). With the point's covariance S, the Kalman update is
    x + S n (d - n^T x) / (n^T S n + v_s): along the ray where the ray's uncertainty rules. Of all planes that of the largest
    density, support exp(-r^2 / 2 v) / sqrt(v), is taken; it reaches half a cell beyond its own.
    """
    half = 0.5 * cell_m
    corner, moved, best, gain = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for p in range(len(xyz)):
        if group[p] == 0:
            continue
        length = min(reach_m, np.sqrt(gate2 * sigma2[p]))
        count = int(np.ceil(length / half))
        most = 0.0
        for i in range(-count, count + 1):
            for s in range(7):
                c = _cell_at(xyz[p], ray[p], i * half, group[p], steps[s], cell_m, corner, key, table, low)
                if c < 0 or plane[c, 6] <= 0.0:
                    continue
                n = plane[c, 0:3]
                v = normal_variance(sigma2[p], across2[p], ray[p], common[p], n)
                total = v + plane[c, 4] + plane[c, 5]
                r = plane[c, 3]
                for k in range(3):
                    r -= n[k] * (xyz[p, k] - corner[k])
                if r * r > gate2 * total:
                    continue
                density = plane[c, 6] * np.exp(-0.5 * r * r / total) / np.sqrt(total)
                if density <= most:
                    continue
                _times_normal(sigma2[p], across2[p], ray[p], common[p], n, gain)
                inside = True
                for k in range(3):
                    moved[k] = xyz[p, k] + gain[k] * r / total
                    inside &= -half <= moved[k] - corner[k] <= cell_m + half
                    inside &= abs(moved[k] - xyz[p, k]) <= reach_m
                if inside:
                    most = density
                    for k in range(3):
                        best[k] = moved[k]
                    surface[p] = c
                    variance[p] = v * (plane[c, 4] + plane[c, 5]) / total
        if most > 0.0:
            for k in range(3):
                fused[p, k] = best[k]


@njit(cache=True, error_model="numpy")
def crossing(rows, xyz, group, ray, key, table, low, steps, plane, cell_m, reach_m, out):  # type: ignore[no-untyped-def]
    """out (R,): whether the ray of each of these points crosses a surface of its group within reach_m of it, in place.

    Arrays as in `fuse`. A plane reaches half a cell beyond its own, and is crossed where the ray meets it at more than 3 degrees.
    """
    half = 0.5 * cell_m
    corner = np.empty(3)
    for row in range(len(rows)):
        p = rows[row]
        count = int(np.ceil(reach_m / half))
        for i in range(-count, count + 1):
            c = _cell_at(xyz[p], ray[p], i * half, group[p], steps[0], cell_m, corner, key, table, low)
            if c < 0 or plane[c, 6] <= 0.0:
                continue
            into, r = 0.0, plane[c, 3]
            for k in range(3):
                into += plane[c, k] * ray[p, k]
                r -= plane[c, k] * (xyz[p, k] - corner[k])
            inside = abs(into) > LEAST_SINE and abs(r) <= reach_m * abs(into)
            for k in range(3):
                at = xyz[p, k] + r / into * ray[p, k] - corner[k]
                inside &= -half <= at <= cell_m + half
            out[row] |= inside


@njit(cache=True, error_model="numpy")
def _cell_at(x, ray, t, group, step, cell_m, corner, key, table, low):  # type: ignore[no-untyped-def]
    """Row of the cell `step` from that at x + t ray; its corner is left in `corner`."""
    packed = int(group)
    for k in range(3):
        q = int(np.floor((x[k] + t * ray[k]) / cell_m)) + step[1 + k]
        corner[k] = q * cell_m
        packed = packed * CELLS_PER_AXIS + q - low[k]
    return find(packed, key, table)


@njit(cache=True, error_model="numpy")
def _times_normal(sigma2, across2, ray, common, n, out):  # type: ignore[no-untyped-def]
    """S n (3,) with S as in `normal_variance`."""
    along = n[0] * ray[0] + n[1] * ray[1] + n[2] * ray[2]
    for i in range(3):
        out[i] = across2 * n[i] + (sigma2 - across2) * along * ray[i]
        for j in range(3):
            out[i] += common[i, j] * n[j]
