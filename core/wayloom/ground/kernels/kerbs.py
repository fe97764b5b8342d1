"""Steps of the ground's height across a line: two parallel slopes with a smeared step between them, its place chosen."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Float64 = NDArray[np.float64]


@njit(cache=True, error_model="numpy", nogil=True)
def best_step(
    across: Float64, height: Float64, weight: Float64, shifts: Float64, smears: Float64, least: int, out: Float64
) -> None:
    """Fill out (6,) with the step of heights (N,) at places across (N,), weighted (N,).

    They are its shift, its height h, the sigma of that by the residuals, the cost, the cost before, and its smear.

    For each shift and smear the model is z = a + b x + h Phi((x - shift) / smear), Phi the normal distribution; the least weighted
    mean square wins. cost before is that of a slope alone. sigma is of h, by the residuals. All NaN where no shift has `least`
    heights with a weight on both sides, further than a smear from it. weight: larger for more certain heights, 0 for none.
    """
    best = math.inf
    for k in range(6):
        out[k] = math.nan
    a00, a01, a11, r0, r1, szz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for n in range(across.shape[0]):
        x, z, w = across[n], height[n], weight[n]
        if w > 0:
            a00 += w
            a01 += w * x
            a11 += w * x * x
            r0 += w * z
            r1 += w * x * z
            szz += w * z * z
    for s in range(shifts.shape[0]):
        for q in range(smears.shape[0]):
            low, high = 0, 0
            for n in range(across.shape[0]):
                if weight[n] > 0:
                    low += 1 if across[n] < shifts[s] - smears[q] else 0
                    high += 1 if across[n] > shifts[s] + smears[q] else 0
            if low < least or high < least:
                continue
            a02, a12, a22, r2 = 0.0, 0.0, 0.0, 0.0
            for n in range(across.shape[0]):
                x, z, w = across[n], height[n], weight[n]
                if w > 0:
                    u = 0.5 * (1.0 + math.erf((x - shifts[s]) / smears[q] * 0.7071067811865476))
                    a02 += w * u
                    a12 += w * x * u
                    a22 += w * u * u
                    r2 += w * u * z
            c00, c01, c02 = a11 * a22 - a12 * a12, a02 * a12 - a01 * a22, a01 * a12 - a02 * a11
            c11, c12, c22 = a00 * a22 - a02 * a02, a01 * a02 - a00 * a12, a00 * a11 - a01 * a01
            det = a00 * c00 + a01 * c01 + a02 * c02
            if abs(det) < 1e-12 * a00**3:
                continue
            a, b = (c00 * r0 + c01 * r1 + c02 * r2) / det, (c01 * r0 + c11 * r1 + c12 * r2) / det
            h = (c02 * r0 + c12 * r1 + c22 * r2) / det
            cost = max(szz - a * r0 - b * r1 - h * r2, 0.0) / a00
            if cost < best:
                best = cost
                out[0], out[1], out[3], out[5] = shifts[s], h, cost, smears[q]
                out[2] = math.sqrt(max(c22 / det, 0.0) * a00 * cost / max(low + high - 3, 1))
                mean = r0 / a00
                slope = (r1 - mean * a01) / max(a11 - a01 * a01 / a00, 1e-12)
                out[4] = max(szz / a00 - mean * mean - slope * (r1 - mean * a01) / a00, 0.0)


@njit(cache=True, error_model="numpy", nogil=True)
def steps_along(
    stations: Float64,
    normals: Float64,
    height: Float64,
    weight: Float64,
    half_along: float,
    reach: float,
    shifts: Float64,
    smears: Float64,
    least: int,
    across: Float64,
    found: Float64,
    found_weight: Float64,
    out: Float64,
) -> None:
    """Fill out (S, 6) with `best_step` at each station, of the cells within half_along of it along and reach across, all in cells.

    stations (S, 2) column and row of places; normals (S, 2) unit vectors; height, weight (H, W), a cell counts where its weight is
    positive; shifts (K,), smears (Q,) cells. across, found, found_weight (M,) are scratch
    for as many cells as lie in a station's window.
    """  # fmt: skip
    rows, columns = height.shape
    far = math.sqrt(half_along * half_along + reach * reach)
    for s in range(stations.shape[0]):
        u, v, nx, ny = stations[s, 0], stations[s, 1], normals[s, 0], normals[s, 1]
        count, level = 0, 0.0  # heights are told from the first one: sums of squares keep their digits
        for y in range(max(0, math.floor(v - far)), min(rows, math.ceil(v + far) + 1)):
            for x in range(max(0, math.floor(u - far)), min(columns, math.ceil(u + far) + 1)):
                if weight[y, x] <= 0:
                    continue
                a, b = (x - u) * nx + (y - v) * ny, (y - v) * nx - (x - u) * ny
                if abs(a) <= reach and abs(b) <= half_along and count < across.shape[0]:
                    level = height[y, x] if count == 0 else level
                    across[count], found[count], found_weight[count] = a, height[y, x] - level, weight[y, x]
                    count += 1
        best_step(across[:count], found[:count], found_weight[:count], shifts, smears, least, out[s])
