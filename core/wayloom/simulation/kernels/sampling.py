"""Texture look-up: bilinear, mip-mapped, anisotropic."""

import math

import numpy as np
from numba import njit

MAX_TAPS = 8
"""Most samples along the long axis of a pixel's footprint."""
BLEND_FROM = 0.05
"""A finer level's share below which the next coarser level is not read."""
INV_255 = np.float32(1.0 / 255.0)


@njit(cache=True, error_model="numpy", nogil=True, inline="always")
def texel_row(tex, layer, level, x, y):
    """Row of texel (x, y), wrapped around, of one layer and mip level."""
    size = tex.size >> level
    return tex.offsets[level] + (layer * size + (y & (size - 1))) * size + (x & (size - 1))


@njit(cache=True, error_model="numpy", nogil=True)
def bilinear(tex, layer, level, u, v):
    """Linear RGB and fourth channel, 0 to 1, at (u, v) of one mip level."""
    size = tex.size >> level
    fx, fy = u * size - 0.5, v * size - 0.5
    x, y = int(math.floor(fx)), int(math.floor(fy))
    ax, ay = np.float32(fx - x), np.float32(fy - y)
    one = np.float32(1.0)
    w00, w10, w01, w11 = (one - ax) * (one - ay), ax * (one - ay), (one - ax) * ay, ax * ay
    a, b = tex.texels[texel_row(tex, layer, level, x, y)], tex.texels[texel_row(tex, layer, level, x + 1, y)]
    c, d = tex.texels[texel_row(tex, layer, level, x, y + 1)], tex.texels[texel_row(tex, layer, level, x + 1, y + 1)]
    r = (w00 * a[0] + w10 * b[0] + w01 * c[0] + w11 * d[0]) * INV_255
    g = (w00 * a[1] + w10 * b[1] + w01 * c[1] + w11 * d[1]) * INV_255
    bl = (w00 * a[2] + w10 * b[2] + w01 * c[2] + w11 * d[2]) * INV_255
    al = (w00 * a[3] + w10 * b[3] + w01 * c[3] + w11 * d[3]) * INV_255
    return r * r, g * g, bl * bl, al


@njit(cache=True, error_model="numpy", nogil=True)
def anisotropic(tex, layer, u, v, ux, vx, uy, vy):
    """Mean colour over a pixel's footprint: (ux, vx), (uy, vy) are the steps of (u, v) to the right and the lower pixel."""
    long_u, long_v, long_len, short_len = ux, vx, math.sqrt(ux * ux + vx * vx) * tex.size, math.sqrt(uy * uy + vy * vy) * tex.size
    if short_len > long_len:
        long_u, long_v, long_len, short_len = uy, vy, short_len, long_len
    taps = min(max(int(math.ceil(long_len / max(short_len, 1.0))), 1), MAX_TAPS)
    lod = max(math.log2(max(long_len / taps, 1e-3)), 0.0)
    last = len(tex.offsets) - 2
    level = min(int(lod), last)
    blend = np.float32(lod - level) if level < last else np.float32(0.0)
    r = g = b = al = np.float32(0.0)
    for k in range(taps):
        t = (k + 0.5) / taps - 0.5
        r0, g0, b0, a0 = bilinear(tex, layer, level, u + long_u * t, v + long_v * t)
        if blend > BLEND_FROM:
            r1, g1, b1, a1 = bilinear(tex, layer, level + 1, u + long_u * t, v + long_v * t)
            r0, g0, b0, a0 = r0 + (r1 - r0) * blend, g0 + (g1 - g0) * blend, b0 + (b1 - b0) * blend, a0 + (a1 - a0) * blend
        r, g, b, al = r + r0, g + g0, b + b0, al + a0
    scale = np.float32(1.0 / taps)
    return r * scale, g * scale, b * scale, al * scale


@njit(cache=True, error_model="numpy", nogil=True)
def noise(field, u, v):
    """Bilinear value at (u, v) of a tileable square field; 1 = one repeat."""
    size = field.shape[0]
    fx, fy = u * size, v * size
    x, y = int(math.floor(fx)), int(math.floor(fy))
    ax, ay = fx - x, fy - y
    x0, x1, y0, y1 = x & (size - 1), (x + 1) & (size - 1), y & (size - 1), (y + 1) & (size - 1)
    return (field[y0, x0] * (1 - ax) + field[y0, x1] * ax) * (1 - ay) + (field[y1, x0] * (1 - ax) + field[y1, x1] * ax) * ay
