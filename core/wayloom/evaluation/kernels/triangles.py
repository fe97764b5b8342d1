"""Distance of points to triangles."""

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy")
def distance2(p, a, b, c):  # type: ignore[no-untyped-def]
    """m^2 from p (3,) to the triangle a, b, c (Ericson, Real-Time Collision Detection, 5.1.5)."""
    ab, ac, ap = b - a, c - a, p - a
    d1, d2 = _dot(ab, ap), _dot(ac, ap)
    if d1 <= 0.0 and d2 <= 0.0:
        return _dot(ap, ap)
    bp = p - b
    d3, d4 = _dot(ab, bp), _dot(ac, bp)
    if d3 >= 0.0 and d4 <= d3:
        return _dot(bp, bp)
    cp = p - c
    d5, d6 = _dot(ab, cp), _dot(ac, cp)
    if d6 >= 0.0 and d5 <= d6:
        return _dot(cp, cp)
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        foot = ap - d1 / (d1 - d3) * ab
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        foot = ap - d2 / (d2 - d6) * ac
    elif va <= 0.0 and d4 >= d3 and d5 >= d6:
        foot = bp - (d4 - d3) / ((d4 - d3) + (d5 - d6)) * (c - b)
    elif va + vb + vc == 0.0:
        foot = ap
    else:
        foot = ap - (vb * ab + vc * ac) / (va + vb + vc)
    return _dot(foot, foot)


@njit(cache=True, error_model="numpy")
def _dot(a, b):  # type: ignore[no-untyped-def]
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True, error_model="numpy")
def nearest(points, corners, start, triangle, low, shape, cell_m, most_m, out):  # type: ignore[no-untyped-def]
    """out (N,) m from each point (N, 3) to the nearest of the triangles (T, 3, 3), at most most_m, in place.

    start (X * Y + 1,) into triangle: those that come within most_m of each cell of a plan of `shape` (2,) from `low` (2,) on.
    """
    for i in range(len(points)):
        out[i] = most_m
        x, y = int(np.floor((points[i, 0] - low[0]) / cell_m)), int(np.floor((points[i, 1] - low[1]) / cell_m))
        if x < 0 or y < 0 or x >= shape[0] or y >= shape[1]:
            continue
        best = most_m * most_m
        for k in range(start[x * shape[1] + y], start[x * shape[1] + y + 1]):
            t = triangle[k]
            below = min(corners[t, 0, 2], corners[t, 1, 2], corners[t, 2, 2])
            above = max(corners[t, 0, 2], corners[t, 1, 2], corners[t, 2, 2])
            if below - most_m <= points[i, 2] <= above + most_m:
                best = min(best, distance2(points[i], corners[t, 0], corners[t, 1], corners[t, 2]))
        out[i] = np.sqrt(best)
