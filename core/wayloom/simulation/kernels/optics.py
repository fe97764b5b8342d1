"""Lens resampling, point-spread blur and motion blur of a rendered image.

Weights are those of Mitchell and Netravali (1988) on their line B + 2C = 1, on which the filter's first and second moments do not
depend on where between the texels it falls: mean 0, variance B/3. So an image that is resampled by fractions of a pixel is neither
moved nor more or less blurred than one that is not.
"""

import math

import numpy as np
from numba import njit

from wayloom.simulation.kernels.arrays import Float32, Float64, Int32, Number, View
from wayloom.simulation.kernels.options import INLINE, KERNEL

MOST_TAPS = 24
"""Most samples along the way of a point while the shutter is open."""
STILL_PX = 0.3
"""A shorter way is not smeared."""


@njit(**INLINE)
def filter_weight(x: Number, b: Number) -> Number:
    """Weight at distance x >= 0 from the sample's place."""
    c = np.float32(0.5) * (np.float32(1.0) - b)
    if x < np.float32(1.0):
        return ((12 - 9 * b - 6 * c) * x * x * x + (12 * b + 6 * c - 18) * x * x + (6 - 2 * b)) * np.float32(1.0 / 6.0)
    return (((-b - 6 * c) * x + (6 * b + 30 * c)) * x * x + (-12 * b - 48 * c) * x + (8 * b + 24 * c)) * np.float32(1.0 / 6.0)


@njit(**KERNEL)
def add_sample(image: Float32, u: float, v: float, b: float, share: float, out: Float32) -> None:
    """Add share times the filtered image (H, W, 3) at (u, v) to out (3,). Outside, the border goes on."""
    height, width = image.shape[0], image.shape[1]
    x0, y0 = math.floor(u), math.floor(v)
    fx, fy = np.float32(u - x0), np.float32(v - y0)
    one, two = np.float32(1.0), np.float32(2.0)
    wx0, wx1, wx2, wx3 = filter_weight(one + fx, b), filter_weight(fx, b), filter_weight(one - fx, b), filter_weight(two - fx, b)
    xa, xb = min(max(x0 - 1, 0), width - 1), min(max(x0, 0), width - 1)
    xc, xd = min(max(x0 + 1, 0), width - 1), min(max(x0 + 2, 0), width - 1)
    for j in range(4):
        y = min(max(y0 + j - 1, 0), height - 1)
        w = filter_weight(abs(fy - np.float32(j - 1)), b) * share
        for k in range(3):
            out[k] += w * (wx0 * image[y, xa, k] + wx1 * image[y, xb, k] + wx2 * image[y, xc, k] + wx3 * image[y, xd, k])


@njit(**INLINE)
def moved_pixel(view: View, x: float, y: float, depth: float, M: Float64) -> tuple[float, float]:
    """Where the point of normalised coordinates (x, y) and depth m (0: infinitely far) is seen after M (3, 4): p -> M p."""
    px, py, pz = M[0, 0] * x + M[0, 1] * y + M[0, 2], M[1, 0] * x + M[1, 1] * y + M[1, 2], M[2, 0] * x + M[2, 1] * y + M[2, 2]
    if depth > 0.0:
        px, py, pz = px + M[0, 3] / depth, py + M[1, 3] / depth, pz + M[2, 3] / depth
    if pz < 0.1:  # it passes the camera while the shutter is open: as far as is seen
        return view.fx * x + view.cx, view.fy * y + view.cy
    return view.fx * px / pz + view.cx, view.fy * py / pz + view.cy


@njit(**KERNEL)
def through_lens(
    image: Float32, lens_uv: Float32, depth: Float32, view: View, opening: Float64, closing: Float64, b: float, out: Float32
) -> None:
    """Fill out (H, W, 3) with what a camera makes of a drawn image (Hd, Wd, 3), both linear.

    lens_uv           (H, W, 2) where each pixel lies in the drawn image, or (0, 0, 2) where it lies in its own place
    depth             (H, W) m along z, 0 infinitely far, or (0, 0): nothing moves
    view              the drawn camera; its pose is not used
    opening, closing  (3, 4): the camera's frame in the middle of the exposure to those when the shutter opens and closes
    """
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            u, v = np.float64(x), np.float64(y)
            if lens_uv.shape[0] > 0:
                u, v = np.float64(lens_uv[y, x, 0]), np.float64(lens_uv[y, x, 1])
            out[y, x, 0] = out[y, x, 1] = out[y, x, 2] = 0.0
            taps, du, dv = 1, 0.0, 0.0
            if depth.shape[0] > 0:
                nx, ny, d = (u - view.cx) / view.fx, (v - view.cy) / view.fy, np.float64(depth[y, x])
                u0, v0 = moved_pixel(view, nx, ny, d, opening)
                u1, v1 = moved_pixel(view, nx, ny, d, closing)
                du, dv = u1 - u0, v1 - v0
                way = math.sqrt(du * du + dv * dv)
                if way > STILL_PX:
                    taps = min(math.ceil(way) + 1, MOST_TAPS)
            share = np.float32(1.0 / taps)
            for k in range(taps):
                s = (k + 0.5) / taps - 0.5
                add_sample(image, u + s * du if taps > 1 else u, v + s * dv if taps > 1 else v, b, share, out[y, x])


@njit(**KERNEL)
def depth_along(ids: Int32, u: Float32, v: Float32, view: View, corners: Float32, depth: Float32) -> None:
    """Fill depth (N,) m along z where the rays through pixels u, v (N,) meet the planes of triangles ids (N,); 0 for -1."""
    T = view.T_world_cam
    for i in range(len(ids)):
        depth[i] = 0.0
        if ids[i] < 0:
            continue
        a, b = (u[i] - view.cx) / view.fx, (v[i] - view.cy) / view.fy
        dx, dy = T[0, 0] * a + T[0, 1] * b + T[0, 2], T[1, 0] * a + T[1, 1] * b + T[1, 2]
        dz = T[2, 0] * a + T[2, 1] * b + T[2, 2]
        c = corners[ids[i]]
        x0, y0, z0 = np.float64(c[0, 0]), np.float64(c[0, 1]), np.float64(c[0, 2])
        ux, uy, uz = c[1, 0] - x0, c[1, 1] - y0, c[1, 2] - z0
        vx, vy, vz = c[2, 0] - x0, c[2, 1] - y0, c[2, 2] - z0
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        above = (x0 - T[0, 3]) * nx + (y0 - T[1, 3]) * ny + (z0 - T[2, 3]) * nz
        depth[i] = above / (dx * nx + dy * ny + dz * nz)
