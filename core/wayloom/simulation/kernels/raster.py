"""Triangle rasterisation: homogeneous half-space test with a 1/z buffer (Olano & Greer 1997).

For a triangle with homogeneous image corners M = [X Y z] (columns), the rows of M^-1 give three functions a x + b y + c of the
pixel that are the barycentric weights divided by z; inside all three are >= 0, and their sum is 1/z. No clipping is needed.
"""

import math

import numpy as np
from numba import njit

from wayloom.simulation.kernels.arrays import Float32, Float64, Int32, TextureStack, Triangles, View
from wayloom.simulation.kernels.options import KERNEL
from wayloom.simulation.kernels.sampling import texel_row

NEAR_M = 0.05
NO_TRIANGLE = -1
DEGENERATE = 1e-12
COARSEST_CUTOUT_LEVELS = 4
"""Holes are not cut from the coarsest levels, where a whole leaf is one texel."""


@njit(**KERNEL)
def image_box(X: Float64, Y: Float64, z: Float64, width: int, height: int, box: Int32) -> None:
    """Pixel box of a triangle cut at the near plane; box is x0, x1, y0, y1, empty when x1 < x0."""
    x0, x1, y0, y1 = 1e9, -1e9, 1e9, -1e9
    for k in range(3):
        n = (k + 1) % 3
        if z[k] > NEAR_M:
            u, v = X[k] / z[k], Y[k] / z[k]
            x0, x1, y0, y1 = min(x0, u), max(x1, u), min(y0, v), max(y1, v)
        if (z[k] > NEAR_M) != (z[n] > NEAR_M):
            s = (NEAR_M - z[k]) / (z[n] - z[k])
            u, v = (X[k] + (X[n] - X[k]) * s) / NEAR_M, (Y[k] + (Y[n] - Y[k]) * s) / NEAR_M
            x0, x1, y0, y1 = min(x0, u), max(x1, u), min(y0, v), max(y1, v)
    box[0], box[1] = 0, -1
    if x1 >= 0 and y1 >= 0 and x0 <= width - 1 and y0 <= height - 1:
        box[0], box[1] = math.ceil(max(x0, 0.0)), math.floor(min(x1, width - 1.0))
        box[2], box[3] = math.ceil(max(y0, 0.0)), math.floor(min(y1, height - 1.0))


@njit(**KERNEL)
def project_triangles(
    corners: Float32, view: View, T_cam_world: Float64, width: int, height: int, edges: Float64, boxes: Int32, scratch: Float64
) -> None:
    """Fill edges (T, 9) float64 (rows of M^-1) and boxes (T, 4) int32 for corners (T, 3, 3). scratch (3, 3) float64."""
    X, Y, z, R = scratch[0], scratch[1], scratch[2], T_cam_world
    for t in range(len(corners)):
        for k in range(3):
            a, b, c = corners[t, k, 0], corners[t, k, 1], corners[t, k, 2]
            z[k] = R[2, 0] * a + R[2, 1] * b + R[2, 2] * c + R[2, 3]
            X[k] = view.fx * (R[0, 0] * a + R[0, 1] * b + R[0, 2] * c + R[0, 3]) + view.cx * z[k]
            Y[k] = view.fy * (R[1, 0] * a + R[1, 1] * b + R[1, 2] * c + R[1, 3]) + view.cy * z[k]
        image_box(X, Y, z, width, height, boxes[t])
        if boxes[t, 1] < boxes[t, 0] or boxes[t, 3] < boxes[t, 2]:
            boxes[t, 1] = boxes[t, 0] - 1
            continue
        det = 0.0
        for k in range(3):  # cofactors; the next and the next but one corner
            n, m = (k + 1) % 3, (k + 2) % 3
            edges[t, 3 * k] = Y[n] * z[m] - Y[m] * z[n]
            edges[t, 3 * k + 1] = X[m] * z[n] - X[n] * z[m]
            edges[t, 3 * k + 2] = X[n] * Y[m] - X[m] * Y[n]
        det = X[0] * edges[t, 0] + Y[0] * edges[t, 1] + z[0] * edges[t, 2]
        if abs(det) < DEGENERATE:
            boxes[t, 1] = boxes[t, 0] - 1
            continue
        for k in range(9):
            edges[t, k] /= det


@njit(**KERNEL)
def is_hole(tex: TextureStack, layer: int, uv: Float32, e: Float64, x: int, y: int, inv_z: float, level: int) -> bool:
    """Whether the texture's coverage is under one half where pixel (x, y) meets the triangle with edge functions e."""
    l1, l2 = (e[3] * x + e[4] * y + e[5]) / inv_z, (e[6] * x + e[7] * y + e[8]) / inv_z
    u = uv[0, 0] + l1 * (uv[1, 0] - uv[0, 0]) + l2 * (uv[2, 0] - uv[0, 0])
    v = uv[0, 1] + l1 * (uv[1, 1] - uv[0, 1]) + l2 * (uv[2, 1] - uv[0, 1])
    size = tex.size >> level
    return tex.texels[texel_row(tex, layer, level, math.floor(u * size), math.floor(v * size)), 3] < 128


@njit(**KERNEL)
def cutout_level(tex: TextureStack, uv: Float32, e: Float64, box: Int32) -> int:
    """Mip level at which a triangle's holes are cut: from the texels that a pixel step spans in the middle of its box."""
    x, y = 0.5 * (box[0] + box[1]), 0.5 * (box[2] + box[3])
    w = (e[0] + e[3] + e[6]) * x + (e[1] + e[4] + e[7]) * y + (e[2] + e[5] + e[8])
    if w <= 0.0:
        return 0
    area_uv = abs((uv[1, 0] - uv[0, 0]) * (uv[2, 1] - uv[0, 1]) - (uv[2, 0] - uv[0, 0]) * (uv[1, 1] - uv[0, 1]))
    # d(l1, l2)/d(x, y) is det of the normalised edge functions: det(M^-1) / w^3.
    det = e[0] * (e[4] * e[8] - e[5] * e[7]) - e[1] * (e[3] * e[8] - e[5] * e[6]) + e[2] * (e[3] * e[7] - e[4] * e[6])
    texels_per_pixel = math.sqrt(area_uv * abs(det) / (w * w * w)) * tex.size
    level = math.floor(math.log2(max(texels_per_pixel, 1.0)) + 0.5)
    return min(level, len(tex.offsets) - 1 - COARSEST_CUTOUT_LEVELS)


@njit(**KERNEL)
def rasterise(edges: Float64, boxes: Int32, tri: Triangles, tex: TextureStack, inv_z: Float32, ids: Int32) -> None:
    """Fill inv_z (H, W) float32 1/m (0 where nothing is seen) and ids (H, W) int32 (NO_TRIANGLE there)."""
    inv_z[:] = 0.0
    ids[:] = NO_TRIANGLE
    for t in range(len(edges)):
        if boxes[t, 1] < boxes[t, 0]:
            continue
        e = edges[t]
        cut = tex.cutout[tri.material[t]] == 1
        level = cutout_level(tex, tri.uv[t], e, boxes[t]) if cut else 0
        step = e[0] + e[3] + e[6]
        for y in range(boxes[t, 2], boxes[t, 3] + 1):
            lo, hi = boxes[t, 0], boxes[t, 1]
            for k in range(3):
                a, c = e[3 * k], e[3 * k + 1] * y + e[3 * k + 2]
                if a > 0.0:
                    q = min(max(-c / a, lo), hi + 1.0)  # an edge along the row crosses it beyond all integers
                    lo = math.ceil(q)
                elif a < 0.0:
                    q = max(min(-c / a, hi), lo - 1.0)
                    hi = math.floor(q)
                elif c < 0.0:
                    hi = lo - 1
            base = (e[1] + e[4] + e[7]) * y + e[2] + e[5] + e[8]
            for x in range(lo, hi + 1):
                w = np.float32(step * x + base)
                if w > inv_z[y, x] and not (cut and is_hole(tex, tri.material[t], tri.uv[t], e, x, y, step * x + base, level)):
                    inv_z[y, x] = w
                    ids[y, x] = t


@njit(**KERNEL)
def depth_of(ids: Int32, view: View, corners: Float32, depth: Float32) -> None:
    """Fill depth (H, W) float32 m along z: the exact meeting of each pixel's ray with its triangle's plane; 0 where none."""
    T = view.T_world_cam
    for y in range(ids.shape[0]):
        for x in range(ids.shape[1]):
            t = ids[y, x]
            depth[y, x] = 0.0
            if t == NO_TRIANGLE:
                continue
            a, b = (x - view.cx) / view.fx, (y - view.cy) / view.fy
            dx, dy, dz = (
                T[0, 0] * a + T[0, 1] * b + T[0, 2],
                T[1, 0] * a + T[1, 1] * b + T[1, 2],
                T[2, 0] * a + T[2, 1] * b + T[2, 2],
            )
            c = corners[t]
            x0, y0, z0 = np.float64(c[0, 0]), np.float64(c[0, 1]), np.float64(c[0, 2])
            ux, uy, uz = c[1, 0] - x0, c[1, 1] - y0, c[1, 2] - z0
            vx, vy, vz = c[2, 0] - x0, c[2, 1] - y0, c[2, 2] - z0
            nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
            above = (x0 - T[0, 3]) * nx + (y0 - T[1, 3]) * ny + (z0 - T[2, 3]) * nz
            depth[y, x] = above / (dx * nx + dy * ny + dz * nz)
