"""Patch matching by translation and affine warp (Lucas-Kanade), for calibration: to a few hundredths of a pixel."""

import math

import numpy as np

from wayloom.odometry.kernels.compiler import kernel, part
from wayloom.odometry.kernels.linear import cholesky_solve

HALF = 5
SEARCH_HALF = 3
BORDER = 2.0
"""px between the outermost sample and the image's edge: the cubic's support."""
SMOOTH_STEPS, SHARP_STEPS = 12, 3
SMALL_STEP = 0.02
MAX_STRETCH = 0.5
"""Of the affine warp against its start: beyond it the patch has slipped off its surface."""


@part
def bilinear(image, x, y):  # type: ignore[no-untyped-def]
    """The image (h, w) float32 at (x, y) px, inside."""
    ix, iy = int(x), int(y)
    a, b = x - ix, y - iy
    top = (1.0 - a) * image[iy, ix] + a * image[iy, ix + 1]
    return (1.0 - b) * top + b * ((1.0 - a) * image[iy + 1, ix] + a * image[iy + 1, ix + 1])


@part
def cubic_weights(a):  # type: ignore[no-untyped-def]
    """Four weights of the Catmull-Rom cubic (Keys 1981) at fraction a of a pixel, for the pixels -1, 0, 1, 2."""
    a2, a3 = a * a, a * a * a
    return 0.5 * (-a3 + 2 * a2 - a), 0.5 * (3 * a3 - 5 * a2 + 2), 0.5 * (-3 * a3 + 4 * a2 + a), 0.5 * (a3 - a2)


@part
def cubic(image, x, y):  # type: ignore[no-untyped-def]
    """The image (h, w) float32 at (x, y) px by cubics, 2 px inside."""
    ix, iy = int(x), int(y)
    p0, p1, p2, p3 = cubic_weights(x - ix)
    q0, q1, q2, q3 = cubic_weights(y - iy)
    value = 0.0
    for k, q in ((-1, q0), (0, q1), (1, q2), (2, q3)):
        r = iy + k
        value += q * (p0 * image[r, ix - 1] + p1 * image[r, ix] + p2 * image[r, ix + 1] + p3 * image[r, ix + 2])
    return value


@part
def stays_inside(image, x, y, reach):  # type: ignore[no-untyped-def]
    """Whether a square of half size `reach` px around (x, y) can be sampled."""
    h, w = image.shape
    margin = reach + BORDER
    return margin < x < w - 1 - margin and margin < y < h - 1 - margin


@part
def template_equations(host, u, v, template, A, j):  # type: ignore[no-untyped-def]
    """The host's patch around (u, v) and the normal matrix of the warp's six steps (translation 2, linear part 4, row by row) and
    of the offset, from its gradients.

    Fills template (n, 3) with grey value and gradient (gx, gy) of each pixel, row by row, and A (7, 7) with the sums over the patch
    of j j^T, j = (gx, gy, gx dx, gx dy, gy dx, gy dy, 1). Returns the least eigenvalue of the structure tensor a pixel with the
    offset eliminated; j (7,) is working space.
    """
    n, i = (2 * HALF + 1) ** 2, 0
    A[:] = 0.0
    for dy in range(-HALF, HALF + 1):
        for dx in range(-HALF, HALF + 1):
            gx = 0.5 * (host[v + dy, u + dx + 1] - host[v + dy, u + dx - 1])
            gy = 0.5 * (host[v + dy + 1, u + dx] - host[v + dy - 1, u + dx])
            template[i, 0], template[i, 1], template[i, 2] = host[v + dy, u + dx], gx, gy
            i += 1
            j[0], j[1], j[2], j[3], j[4], j[5], j[6] = gx, gy, gx * dx, gx * dy, gy * dx, gy * dy, 1.0
            for a in range(7):
                for b in range(a + 1):
                    A[a, b] += j[a] * j[b]
    for a in range(7):
        for b in range(a):
            A[b, a] = A[a, b]
    xx, xy, yy = A[0, 0] - A[0, 6] * A[0, 6] / n, A[0, 1] - A[0, 6] * A[1, 6] / n, A[1, 1] - A[1, 6] * A[1, 6] / n
    return 0.5 * (xx + yy - math.sqrt((xx - yy) ** 2 + 4.0 * xy * xy)) / n


@part
def right_side(template, target, x, y, W, sharp, e):  # type: ignore[no-untyped-def]
    """Fills e (7,) with the sums of j r, r = target(x + W d) - template; W (2, 2). Returns the mean of r^2 without its mean."""
    n, i = (2 * HALF + 1) ** 2, 0
    w00, w01, w10, w11 = W[0, 0], W[0, 1], W[1, 0], W[1, 1]
    e0, e1, e2, e3, e4, e5, e6, square = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for dy in range(-HALF, HALF + 1):
        for dx in range(-HALF, HALF + 1):
            px, py = x + w00 * dx + w01 * dy, y + w10 * dx + w11 * dy
            r = (cubic(target, px, py) if sharp else bilinear(target, px, py)) - template[i, 0]
            x_part, y_part = template[i, 1] * r, template[i, 2] * r
            i += 1
            e0 += x_part
            e1 += y_part
            e2 += x_part * dx
            e3 += x_part * dy
            e4 += y_part * dx
            e5 += y_part * dy
            e6 += r
            square += r * r
    e[0], e[1], e[2], e[3], e[4], e[5], e[6] = e0, e1, e2, e3, e4, e5, e6
    return (square - e6 * e6 / n) / n


@part
def search(host, target, u, v, x, y, W, direction, reach):  # type: ignore[no-untyped-def]
    """The place within +-reach px of (x, y) along `direction` (2,) whose patch is most like the host's, in steps of 1 px; x is NaN
    where none of them is inside."""
    n = (2 * SEARCH_HALF + 1) ** 2
    best, best_x, best_y = np.inf, np.nan, np.nan
    steps = math.ceil(reach)
    for k in range(-steps, steps + 1):
        cx, cy = x + k * direction[0], y + k * direction[1]
        if not stays_inside(target, cx, cy, 1.5 * SEARCH_HALF * max(W[0, 0], W[1, 1])):
            continue
        total, square = 0.0, 0.0
        for dy in range(-SEARCH_HALF, SEARCH_HALF + 1):
            for dx in range(-SEARCH_HALF, SEARCH_HALF + 1):
                r = bilinear(target, cx + W[0, 0] * dx + W[0, 1] * dy, cy + W[1, 0] * dx + W[1, 1] * dy) - host[v + dy, u + dx]
                total += r
                square += r * r
        cost = square - total * total / n
        if cost < best:
            best, best_x, best_y = cost, cx, cy
    return best_x, best_y


@part
def refine_warp(template, target, x, y, W, A, vectors, L):  # type: ignore[no-untyped-def]
    """Inverse compositional alignment (Baker, Matthews 2004) of the host's patch from (x, y) and the warp W (2, 2), which is
    updated; template (n, 3) and A (7, 7) of `template_equations`, vectors (3, 7) and L (7, 7) working space. Returns x, y and the
    rms residual, negative where it fails."""
    n, start00, start11 = (2 * HALF + 1) ** 2, W[0, 0], W[1, 1]
    x0, y0, variance, length, smooth, k = x, y, 0.0, 0.0, SMOOTH_STEPS, 0
    step, e = vectors[0], vectors[1]
    while k < smooth + SHARP_STEPS:
        reach = HALF * (max(abs(W[0, 0]), abs(W[1, 1])) + max(abs(W[0, 1]), abs(W[1, 0])))
        if not stays_inside(target, x, y, reach):
            return x, y, -1.0
        variance = right_side(template, target, x, y, W, k >= smooth, e)
        if not cholesky_solve(A, e, step, vectors[2], L):
            return x, y, -1.0
        a, b, c, d = 1.0 + step[2], step[3], step[4], 1.0 + step[5]  # the template's warp: W <- W D^-1
        det = a * d - b * c
        if not (0.25 < det < 4.0):
            return x, y, -1.0
        w00, w01, w10, w11 = W[0, 0], W[0, 1], W[1, 0], W[1, 1]
        W[0, 0], W[0, 1] = (w00 * d - w01 * c) / det, (w01 * a - w00 * b) / det
        W[1, 0], W[1, 1] = (w10 * d - w11 * c) / det, (w11 * a - w10 * b) / det
        move_x, move_y = W[0, 0] * step[0] + W[0, 1] * step[1], W[1, 0] * step[0] + W[1, 1] * step[1]
        length = math.sqrt(move_x * move_x + move_y * move_y)
        if not length < 3.0:
            return x, y, -1.0
        x -= move_x
        y -= move_y
        if k < smooth and length < SMALL_STEP:
            smooth = k + 1  # near enough: the rest with cubics
        elif k >= smooth and length < 0.1 * SMALL_STEP:
            break
        k += 1
    slipped = max(abs(W[0, 0] - start00), abs(W[1, 1] - start11), abs(W[0, 1]), abs(W[1, 0])) > MAX_STRETCH
    if slipped or abs(x - x0) > 3.0 or abs(y - y0) > 3.0 or length > 0.1:
        return x, y, -1.0
    return x, y, math.sqrt(max(variance, 0.0) * n / (n - 7.0))


def match_patches(host, target, pixels, start, scale, directions, reach, min_eigenvalue, out):  # type: ignore[no-untyped-def]
    """Where patches around pixels (n, 2) int64 of `host` lie in `target`, both (h, w) float32.

    start (n, 2) px, NaN for those to leave out; scale (n,) of the patch in the target; directions (n, 2) unit vectors along which
    it is first looked for within +-reach (n,) px. Fills out (n, 3): u, v in the target and the rms residual, NaN where there is no
    match.
    """
    working_space = np.empty(((2 * HALF + 1) ** 2, 3)), np.empty((2, 7, 7)), np.empty((3, 7)), np.empty((2, 2))
    match_each(host, target, pixels, start, scale, directions, reach, min_eigenvalue, *working_space, out)


@kernel
def match_each(  # type: ignore[no-untyped-def]
    host, target, pixels, start, scale, directions, reach, min_eigenvalue, template, matrices, vectors, W, out
):
    """match_patches with working space template (n, 3), matrices (2, 7, 7), vectors (3, 7), W (2, 2)."""
    A, L = matrices[0], matrices[1]
    for i in range(pixels.shape[0]):
        out[i, 0] = out[i, 1] = out[i, 2] = np.nan
        u, v, x, y = pixels[i, 0], pixels[i, 1], start[i, 0], start[i, 1]
        if not (math.isfinite(x) and math.isfinite(y)) or not stays_inside(host, float(u), float(v), float(HALF)):
            continue
        if template_equations(host, u, v, template, A, vectors[0]) < min_eigenvalue:
            continue
        W[0, 0] = W[1, 1] = scale[i]
        W[0, 1] = W[1, 0] = 0.0
        if reach[i] > 0.7:
            x, y = search(host, target, u, v, x, y, W, directions[i], reach[i])
            if not math.isfinite(x):
                continue
        x, y, rms = refine_warp(template, target, x, y, W, A, vectors, L)
        if rms >= 0.0:
            out[i, 0], out[i, 1], out[i, 2] = x, y, rms
