"""Robust plane of disparities."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Float64 = NDArray[np.float64]


@njit(cache=True, error_model="numpy", nogil=True)
def robust_plane(u: Float64, v: Float64, disparity: Float64, scales: Float64) -> tuple[float, float, float]:
    """Slopes along u and v, and offset, of the plane of disparities (N,) px at pixels u, v (N,); NaN where they lie on a line.

    One round of least squares, then one for each of the scales (R,) px, by weights of Cauchy around the plane of the last one.
    """
    a, b, c = 0.0, 0.0, 0.0
    for n in range(scales.shape[0]):
        total = mu = mv = md = suu = suv = svv = sud = svd = 0.0
        per_px2 = 1.0 / scales[n - 1] ** 2 if n > 0 else 0.0
        for k in range(u.shape[0]):
            rest = a * u[k] + b * v[k] + c - disparity[k]
            w = 1.0 / (1.0 + rest * rest * per_px2)
            total += w
            wu, wv = w * u[k], w * v[k]
            mu += wu
            mv += wv
            md += w * disparity[k]
            suu += wu * u[k]
            suv += wu * v[k]
            svv += wv * v[k]
            sud += wu * disparity[k]
            svd += wv * disparity[k]
        mu, mv, md = mu / total, mv / total, md / total
        suu, suv, svv = suu - total * mu * mu, suv - total * mu * mv, svv - total * mv * mv
        sud, svd = sud - total * mu * md, svd - total * mv * md
        det = suu * svv - suv * suv
        if not det > 0.0:
            return np.nan, np.nan, np.nan
        a, b = (sud * svv - svd * suv) / det, (svd * suu - sud * suv) / det
        c = md - a * mu - b * mv
    return a, b, c
