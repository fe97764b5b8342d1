"""Direct image alignment with a keyframe's reference points on one pyramid level, and the reference points themselves."""

import math

import numpy as np

from wayloom.odometry.kernels.compiler import kernel
from wayloom.odometry.kernels.linear import cholesky_solve, fill_exp_se3, fill_product, orthonormalise
from wayloom.odometry.kernels.tracking_equations import MIN_DEPTH_RATIO, tracking_equations, working_space

f32 = np.float32
MARGIN = 2
"""Pixels of a reference's level, to the right and below one more, in which there are no reference points."""
HOPELESS = 1.0
"""As `enough` of minimise_level, of a step that makes things worse: the gradients of an interpolated image are not those of the
energy, so that near the minimum no damping helps."""

STRANGE = 0.3
"""Share of the points beyond the cutoff from which on an image may show something else, and its energy's deviations mean nothing:
then an alignment goes on until its steps are nothing, and shows by where it ends whether it was one."""


def pool(uv, rho, level, image, camera):  # type: ignore[no-untyped-def]
    """Reference points (m, 4) of a level: the points with inverse depths rho (n,) at finite uv (n, 2) px of level 0, those of one
    pixel as one, row by row. image (h, w) and camera (4,) fx fy cx cy of the level; columns: x, y of the ray, mean inverse depth
    1/m, grey value."""
    h, w = image.shape
    x, y = (uv + 0.5).astype(np.int64).T >> level
    inside = (x >= MARGIN) & (x < w - MARGIN - 1) & (y >= MARGIN) & (y < h - MARGIN - 1)
    pixel, rho = (y * w + x)[inside], rho[inside]
    order, out = np.argsort(pixel, kind="stable"), np.empty((len(rho), 4))
    return out[: fill_pooled(pixel[order], rho[order], image, camera, out)]


@kernel
def fill_pooled(pixel, rho, image, camera, out):  # type: ignore[no-untyped-def]
    """Points sorted by their pixel (n,), counted row by row, into out (capacity, 4) as pool's; returns their number."""
    w, n, i = image.shape[1], 0, 0
    while i < pixel.shape[0]:
        total, number, here = f32(0), f32(0), pixel[i]
        while i < pixel.shape[0] and pixel[i] == here:
            total += f32(rho[i])
            number += f32(1)
            i += 1
        x, y = here % w, here // w
        out[n, 0], out[n, 1] = (x - camera[2]) / camera[0], (y - camera[3]) / camera[1]
        out[n, 2], out[n, 3] = total / number, image[y, x]
        n += 1
    return n


def pool_spread(uv, rho, level, image, camera):  # type: ignore[no-untyped-def]
    """As pool, and also pixels beside one with a point are reference points, of the mean depth around."""
    total, count, out = np.zeros(image.shape, np.float32), np.zeros(image.shape, np.float32), np.empty((5 * len(rho), 4))
    add_splats(uv, rho, level, total, count)
    return out[: gather(image, total, count, camera, out)]


@kernel
def add_splats(uv, rho, level, total, count):  # type: ignore[no-untyped-def]
    """Adds to sums and counts (h, w) of inverse depths on the pixels of a level."""
    h, w = total.shape
    for i in range(rho.shape[0]):
        x, y = int(uv[i, 0] + 0.5) >> level, int(uv[i, 1] + 0.5) >> level
        if x < w and y < h:
            total[y, x] += f32(rho[i])
            count[y, x] += f32(1)


@kernel
def gather(image, total, count, camera, out):  # type: ignore[no-untyped-def]
    """Every pixel with a depth, or with a neighbour that has one, into out (capacity, 4) as pool's; returns their number."""
    h, w = count.shape
    n = 0
    for y in range(MARGIN, h - MARGIN - 1):
        for x in range(MARGIN, w - MARGIN - 1):
            number, s = count[y, x], total[y, x]
            if number == 0:
                number = count[y, x - 1] + count[y, x + 1] + count[y - 1, x] + count[y + 1, x]
                s = total[y, x - 1] + total[y, x + 1] + total[y - 1, x] + total[y + 1, x]
            if number > 0 and n < out.shape[0]:
                out[n, 0], out[n, 1] = (x - camera[2]) / camera[0], (y - camera[3]) / camera[1]
                out[n, 2], out[n, 3] = s / number, image[y, x]
                n += 1
    return n


def align_level(image, reference, T, brightness, camera, huber, cutoff, iterations, enough, out):  # type: ignore[no-untyped-def]
    """Levenberg-Marquardt on one level; updates T (4, 4) T_frame_keyframe and brightness (2,) gain, offset in place.

    The cutoff is doubled while over 60 % of the points are beyond it. The alignment ends before a step that is expected to lower
    the energy by less than `enough` times a point's mean energy, which is the square of the step in its standard deviations; but
    not while more than a share STRANGE of the points is beyond the cutoff. Fills out (3,) with energy, points in view, points
    beyond.
    """
    space = np.empty((3, 8, 8)), np.empty((4, 8)), np.empty((2, 4, 4)), *working_space()
    minimise_level(image, reference, T, brightness, camera, huber, cutoff, iterations, enough, *space, out)


@kernel
def minimise_level(  # type: ignore[no-untyped-def]
    image, reference, T, brightness, camera, huber, cutoff, iterations, enough, matrices, vectors, poses, places, columns, out
):
    """align_level with working space matrices (3, 8, 8), vectors (4, 8), poses (2, 4, 4), and places and columns of
    tracking_equations."""
    H, H_new, L = matrices[0], matrices[1], matrices[2]
    g, g_new, x, step, T_new, damping = vectors[0], vectors[1], vectors[2], poses[0], poses[1], 0.01
    gain, offset = brightness[0], brightness[1]
    energy, count, beyond = tracking_equations(image, reference, T, gain, offset, camera, huber, cutoff, H, g, places, columns)
    for _ in range(5):
        if beyond <= 0.6 * count:
            break
        cutoff *= 2.0
        energy, count, beyond = tracking_equations(image, reference, T, gain, offset, camera, huber, cutoff, H, g, places, columns)
    for _ in range(iterations):
        for k in range(8):
            for m in range(8):
                H_new[k, m] = H[k, m]
            H_new[k, k] *= 1.0 + damping
        if not cholesky_solve(H_new, g, x, vectors[3], L):
            break
        decrease, step2 = 0.0, 0.0
        for k in range(8):
            decrease += x[k] * (g[k] + damping * H[k, k] * x[k])
        for k in range(6):
            step2 += x[k] * x[k]
        decrease *= count / energy
        fits = beyond <= STRANGE * count
        if fits and decrease < enough:
            break
        fill_exp_se3(x, step)
        fill_product(step, T, T_new)
        gain, offset = brightness[0] + x[6], brightness[1] + x[7]
        e, c, s = tracking_equations(image, reference, T_new, gain, offset, camera, huber, cutoff, H_new, g_new, places, columns)
        if c > 0.5 * count and e / c < energy / count:
            for k in range(4):
                for m in range(4):
                    T[k, m] = T_new[k, m]
            H, H_new = H_new, H
            g, g_new = g_new, g
            brightness[0], brightness[1], energy, count, beyond, damping = gain, offset, e, c, s, damping * 0.3
        elif fits and decrease < HOPELESS:
            break
        else:
            damping = max(damping * 6.0, 1e-3)
        if damping > 1e3 or step2 < 1e-9:
            break
    orthonormalise(T)
    out[0], out[1], out[2] = energy, count, beyond


@kernel
def mean_flow(reference, T, camera):  # type: ignore[no-untyped-def]
    """Root mean square flow in px of reference points (n, 4) under T (4, 4), and under T's translation alone."""
    full, shifted, n = 0.0, 0.0, 0
    for i in range(reference.shape[0]):
        x, y, rho = reference[i, 0], reference[i, 1], reference[i, 2]
        Z = T[2, 0] * x + T[2, 1] * y + T[2, 2] + T[2, 3] * rho
        Zt = 1.0 + T[2, 3] * rho
        if Z > MIN_DEPTH_RATIO and Zt > MIN_DEPTH_RATIO:
            du = (T[0, 0] * x + T[0, 1] * y + T[0, 2] + T[0, 3] * rho) / Z - x
            dv = (T[1, 0] * x + T[1, 1] * y + T[1, 2] + T[1, 3] * rho) / Z - y
            full += (camera[0] * du) ** 2 + (camera[1] * dv) ** 2
            du, dv = (x + T[0, 3] * rho) / Zt - x, (y + T[1, 3] * rho) / Zt - y
            shifted += (camera[0] * du) ** 2 + (camera[1] * dv) ** 2
            n += 1
    return math.sqrt(full / max(n, 1)), math.sqrt(shifted / max(n, 1))


@kernel
def project_points(host, uv, rho, T_target_host, rig, h, w, border, out):  # type: ignore[no-untyped-def]
    """Points (N) into a target: T_target_host (F, 4, 4) by host. Fills out (N, 3) with u, v px and inverse depth 1/m in the target,
    u = NaN where the point is behind it or less than border px inside (h, w)."""
    for i in range(host.shape[0]):
        T = T_target_host[host[i]]
        x, y = (uv[i, 0] - rig.cx) / rig.fx, (uv[i, 1] - rig.cy) / rig.fy
        Z = T[2, 0] * x + T[2, 1] * y + T[2, 2] + T[2, 3] * rho[i]
        out[i, 0] = math.nan
        if Z > MIN_DEPTH_RATIO:
            u = rig.fx * (T[0, 0] * x + T[0, 1] * y + T[0, 2] + T[0, 3] * rho[i]) / Z + rig.cx
            v = rig.fy * (T[1, 0] * x + T[1, 1] * y + T[1, 2] + T[1, 3] * rho[i]) / Z + rig.cy
            if border < u < w - 1 - border and border < v < h - 1 - border:
                out[i, 0], out[i, 1], out[i, 2] = u, v, rho[i] / Z
