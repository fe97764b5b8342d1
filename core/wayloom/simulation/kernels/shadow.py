"""Orthographic depth maps: sun shadows and ambient sky visibility."""

import math

from numba import njit

from wayloom.simulation.kernels.arrays import DepthMap, Float32, Float64, TextureStack, Triangles
from wayloom.simulation.kernels.options import KERNEL
from wayloom.simulation.kernels.sampling import texel_row

EMPTY_M = -1e9
CUTOUT_LEVEL = 3
"""Mip level from which shadows of leaves and fences are cut."""
DIRECTIONS = 8
STEPS = 9
FIRST_STEP_M = 0.35
STEP_GROWTH = 1.6
DARKEST = 0.12
OPENNESS_POWER = 1.2


@njit(**KERNEL)
def draw_depth(
    tri: Triangles, tex: TextureStack, axes: Float32, x0: float, y0: float, texels_per_m: float, values: Float32, scratch: Float64
) -> None:
    """Raise values (H, W) float32 to the largest coordinate along axes[2] of the triangles, seen along -axes[2].

    scratch (3, 3) float64.
    """
    height, width = values.shape
    X, Y, Z = scratch[0], scratch[1], scratch[2]
    for t in range(len(tri.corners)):
        for k in range(3):
            a, b, c = tri.corners[t, k, 0], tri.corners[t, k, 1], tri.corners[t, k, 2]
            X[k] = (axes[0, 0] * a + axes[0, 1] * b + axes[0, 2] * c - x0) * texels_per_m - 0.5
            Y[k] = (axes[1, 0] * a + axes[1, 1] * b + axes[1, 2] * c - y0) * texels_per_m - 0.5
            Z[k] = axes[2, 0] * a + axes[2, 1] * b + axes[2, 2] * c
        area = (X[1] - X[0]) * (Y[2] - Y[0]) - (X[2] - X[0]) * (Y[1] - Y[0])
        x_lo, x_hi = max(0, math.ceil(min(X[0], X[1], X[2]))), min(width - 1, math.floor(max(X[0], X[1], X[2])))
        y_lo, y_hi = max(0, math.ceil(min(Y[0], Y[1], Y[2]))), min(height - 1, math.floor(max(Y[0], Y[1], Y[2])))
        if abs(area) < 1e-9 or x_lo > x_hi:
            continue
        cut, uv = tex.cutout[tri.material[t]] == 1, tri.uv[t]
        for y in range(y_lo, y_hi + 1):
            for x in range(x_lo, x_hi + 1):
                l1 = ((x - X[0]) * (Y[2] - Y[0]) - (X[2] - X[0]) * (y - Y[0])) / area
                l2 = ((X[1] - X[0]) * (y - Y[0]) - (x - X[0]) * (Y[1] - Y[0])) / area
                if l1 < 0.0 or l2 < 0.0 or l1 + l2 > 1.0:
                    continue
                z = Z[0] + l1 * (Z[1] - Z[0]) + l2 * (Z[2] - Z[0])
                if z <= values[y, x]:
                    continue
                if cut:
                    size = tex.size >> CUTOUT_LEVEL
                    u = uv[0, 0] + l1 * (uv[1, 0] - uv[0, 0]) + l2 * (uv[2, 0] - uv[0, 0])
                    v = uv[0, 1] + l1 * (uv[1, 1] - uv[0, 1]) + l2 * (uv[2, 1] - uv[0, 1])
                    row = texel_row(tex, tri.material[t], CUTOUT_LEVEL, math.floor(u * size), math.floor(v * size))
                    if tex.texels[row, 3] < 128:
                        continue
                values[y, x] = z


@njit(**KERNEL)
def lit_share(shadow: DepthMap, axes: Float32, px: float, py: float, pz: float, bias_m: float) -> float:
    """Share of light at a point, from the four nearest texels of a depth map; -1 where the map does not reach."""
    x = (axes[0, 0] * px + axes[0, 1] * py + axes[0, 2] * pz - shadow.x0) * shadow.texels_per_m - 0.5
    y = (axes[1, 0] * px + axes[1, 1] * py + axes[1, 2] * pz - shadow.y0) * shadow.texels_per_m - 0.5
    z = axes[2, 0] * px + axes[2, 1] * py + axes[2, 2] * pz + bias_m
    xi, yi = math.floor(x), math.floor(y)
    height, width = shadow.values.shape
    if xi < 0 or yi < 0 or xi >= width - 1 or yi >= height - 1:
        return -1.0
    ax, ay = x - xi, y - yi
    s00 = 1.0 if shadow.values[yi, xi] < z else 0.0
    s10 = 1.0 if shadow.values[yi, xi + 1] < z else 0.0
    s01 = 1.0 if shadow.values[yi + 1, xi] < z else 0.0
    s11 = 1.0 if shadow.values[yi + 1, xi + 1] < z else 0.0
    return (s00 * (1 - ax) + s10 * ax) * (1 - ay) + (s01 * (1 - ax) + s11 * ax) * ay


@njit(**KERNEL)
def measure_openness(surface: Float32, ground: Float32, texels_per_m: float, openness: Float32) -> None:
    """Fill openness (H, W) float32 with the share of the sky above the ground that surface (H, W) m leaves free."""
    height, width = surface.shape
    for y in range(height):
        for x in range(width):
            total = 0.0
            for d in range(DIRECTIONS):
                c, s = math.cos(d * 2 * math.pi / DIRECTIONS), math.sin(d * 2 * math.pi / DIRECTIONS)
                steepest, step = 0.0, FIRST_STEP_M
                for _ in range(STEPS):
                    xx, yy = int(x + c * step * texels_per_m), int(y + s * step * texels_per_m)
                    if xx < 0 or yy < 0 or xx >= width or yy >= height:
                        break
                    steepest = max(steepest, (surface[yy, xx] - ground[y, x]) / step)
                    step *= STEP_GROWTH
                total += 1.0 / math.sqrt(1.0 + steepest * steepest)
            openness[y, x] = max(DARKEST, (total / DIRECTIONS) ** OPENNESS_POWER)
