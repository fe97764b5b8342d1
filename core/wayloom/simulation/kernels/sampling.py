"""Texture sampling: bilinear, mip-mapped, anisotropic."""

import math

import numpy as np
from numba import njit

from wayloom.simulation.kernels.arrays import Float32, Rgba, TextureStack, UInt8
from wayloom.simulation.kernels.options import INLINE, KERNEL

MAX_TAPS = 8
"""Most samples along the long axis of a pixel's footprint."""
BLEND_FROM = 0.05
"""A finer level's share below which the next coarser level is not read."""
INV_255 = np.float32(1.0 / 255.0)


@njit(**INLINE)
def texel_row(tex: TextureStack, layer: int, level: int, x: int, y: int) -> int:
    """Row of texel (x, y), wrapped around, of one layer and mip level."""
    size = tex.size >> level
    return tex.offsets[level] + (layer * size + (y & (size - 1))) * size + (x & (size - 1))


@njit(**KERNEL)
def bilinear(texels: UInt8, first_row: int, size: int, u: float, v: float) -> Rgba:
    """Linear RGB and fourth channel, 0 to 1, at (u, v) of the layer and mip level whose texels begin at first_row."""
    fx, fy = u * size - 0.5, v * size - 0.5
    x, y = math.floor(fx), math.floor(fy)
    ax, ay = np.float32(fx - x), np.float32(fy - y)
    bx, by = np.float32(1.0) - ax, np.float32(1.0) - ay
    mask = size - 1
    upper, lower = first_row + (y & mask) * size, first_row + ((y + 1) & mask) * size
    left, right = x & mask, (x + 1) & mask
    i, j, k, m = upper + left, upper + right, lower + left, lower + right
    w00, w10, w01, w11 = bx * by * INV_255, ax * by * INV_255, bx * ay * INV_255, ax * ay * INV_255
    r = w00 * texels[i, 0] + w10 * texels[j, 0] + w01 * texels[k, 0] + w11 * texels[m, 0]
    g = w00 * texels[i, 1] + w10 * texels[j, 1] + w01 * texels[k, 1] + w11 * texels[m, 1]
    b = w00 * texels[i, 2] + w10 * texels[j, 2] + w01 * texels[k, 2] + w11 * texels[m, 2]
    al = w00 * texels[i, 3] + w10 * texels[j, 3] + w01 * texels[k, 3] + w11 * texels[m, 3]
    return r * r, g * g, b * b, al


@njit(**KERNEL)
def anisotropic(tex: TextureStack, layer: int, u: float, v: float, ux: float, vx: float, uy: float, vy: float) -> Rgba:
    """Mean colour over a pixel's footprint: (ux, vx), (uy, vy) are the steps of (u, v) to the right and the lower pixel."""
    long_u, long_v, long_len, short_len = ux, vx, math.sqrt(ux * ux + vx * vx) * tex.size, math.sqrt(uy * uy + vy * vy) * tex.size
    if short_len > long_len:
        long_u, long_v, long_len, short_len = uy, vy, short_len, long_len
    taps = min(max(math.ceil(long_len / max(short_len, 1.0)), 1), MAX_TAPS)
    lod = max(math.log2(max(long_len / taps, 1e-3)), 0.0)
    last = len(tex.offsets) - 2
    level = min(int(lod), last)
    blend = np.float32(lod - level) if level < last else np.float32(0.0)
    size = tex.size >> level
    first_row, next_row = tex.offsets[level] + layer * size * size, tex.offsets[min(level + 1, last)] + layer * (size >> 1) ** 2
    r = g = b = al = np.float32(0.0)
    for k in range(taps):
        t = (k + 0.5) / taps - 0.5
        r0, g0, b0, a0 = bilinear(tex.texels, first_row, size, u + long_u * t, v + long_v * t)
        if blend > BLEND_FROM:
            r1, g1, b1, a1 = bilinear(tex.texels, next_row, size >> 1, u + long_u * t, v + long_v * t)
            r0, g0, b0, a0 = r0 + (r1 - r0) * blend, g0 + (g1 - g0) * blend, b0 + (b1 - b0) * blend, a0 + (a1 - a0) * blend
        r, g, b, al = r + r0, g + g0, b + b0, al + a0
    scale = np.float32(1.0 / taps)
    return r * scale, g * scale, b * scale, al * scale


@njit(**KERNEL)
def noise(field: Float32, u: float, v: float) -> float:
    """Bilinear value at (u, v) of a tileable square field; 1 = one repeat."""
    size = field.shape[0]
    fx, fy = u * size, v * size
    x, y = math.floor(fx), math.floor(fy)
    ax, ay = fx - x, fy - y
    x0, x1, y0, y1 = x & (size - 1), (x + 1) & (size - 1), y & (size - 1), (y + 1) & (size - 1)
    return (field[y0, x0] * (1 - ax) + field[y0, x1] * ax) * (1 - ay) + (field[y1, x0] * (1 - ax) + field[y1, x1] * ax) * ay
