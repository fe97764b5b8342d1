"""Patch matching by translation and affine warp (Lucas-Kanade), for calibration: to a few hundredths of a pixel.

A patch's pixels lie in rows of 128 in one flat array (`patch_columns`), zero beyond the patch, and are added up sixteen at a time:
a compiler that sees one array and constant distances uses vectors. float32 holds grey values and sums, each of its 16 own.
"""

import math

import numpy as np

from wayloom.odometry.kernels.compiler import inlined, kernel, part
from wayloom.odometry.kernels.linear import cholesky_solve

f32 = np.float32
index = np.uint64
"""Pixels are addressed by unsigned numbers: a signed index is tested for being negative each time."""
ONE, TWO = index(1), index(2)
HALF = 5
SUMS, COLUMNS = 9 * 128, 34 * 128
"""Where the sums begin in a patch's columns, after rows for the Jacobian's seven, grey values and residuals; and their size, with
those for the two fractions and sixteen pixels that are fetched."""
SEARCH_HALF = 3
BORDER = 2.0
"""px between the outermost sample and the image's edge: the cubic's support."""
SMOOTH_STEPS, SHARP_STEPS = 12, 3
SMALL_STEP = 0.02
MAX_STRETCH = 0.5
"""Of the affine warp against its start: beyond it the patch has slipped off its surface."""


@inlined
def bilinear(image, x, y):  # type: ignore[no-untyped-def]
    """The image (h, w) float32 at (x, y) px, inside."""
    ix, iy = index(x), index(y)
    a, b = f32(x - ix), f32(y - iy)
    here, below = image[iy], image[iy + ONE]
    w11 = a * b
    w01, w10, w00 = b - w11, a - w11, f32(1) - a - b + w11
    return w00 * here[ix] + w10 * here[ix + ONE] + w01 * below[ix] + w11 * below[ix + ONE]


@inlined
def cubic_weights(a):  # type: ignore[no-untyped-def]
    """Four weights of the Catmull-Rom cubic (Keys 1981) at fraction a of a pixel, for the pixels -1, 0, 1, 2."""
    half, two, three = f32(0.5), f32(2), f32(3)
    before, after = half * a * (a * (two - a) - f32(1)), half * a * a * (a - f32(1))
    here = f32(1) + half * a * a * (three * a - f32(5))
    return before, here, f32(1) - before - here - after, after


@inlined
def fetch_sixteen(image, x, y, columns, to):  # type: ignore[no-untyped-def]
    """The pixels around (x, y) px of the image (h, w) float32, 2 px inside, and the fractions of that place, to pixel `to`."""
    ix, iy = index(x), index(y)
    columns[2048 + to], columns[2176 + to] = f32(x - ix), f32(y - iy)
    r0, r1, r2, r3 = image[iy - ONE], image[iy], image[iy + ONE], image[iy + TWO]
    columns[2304 + to], columns[2432 + to], columns[2560 + to] = r0[ix - ONE], r0[ix], r0[ix + ONE]
    columns[2816 + to], columns[2944 + to], columns[3072 + to] = r1[ix - ONE], r1[ix], r1[ix + ONE]
    columns[3328 + to], columns[3456 + to], columns[3584 + to] = r2[ix - ONE], r2[ix], r2[ix + ONE]
    columns[3840 + to], columns[3968 + to], columns[4096 + to] = r3[ix - ONE], r3[ix], r3[ix + ONE]
    columns[2688 + to], columns[3200 + to], columns[3712 + to], columns[4224 + to] = (
        r0[ix + TWO],
        r1[ix + TWO],
        r2[ix + TWO],
        r3[ix + TWO],
    )


@inlined
def add_cubics(columns, first, lanes):  # type: ignore[no-untyped-def]
    """Residuals of sixteen pixels from what was fetched."""
    for k in range(lanes):
        i = first + k
        p0, p1, p2, p3 = cubic_weights(columns[2048 + i])
        q0, q1, q2, q3 = cubic_weights(columns[2176 + i])
        r0 = p0 * columns[2304 + i] + p1 * columns[2432 + i] + p2 * columns[2560 + i] + p3 * columns[2688 + i]
        r1 = p0 * columns[2816 + i] + p1 * columns[2944 + i] + p2 * columns[3072 + i] + p3 * columns[3200 + i]
        r2 = p0 * columns[3328 + i] + p1 * columns[3456 + i] + p2 * columns[3584 + i] + p3 * columns[3712 + i]
        r3 = p0 * columns[3840 + i] + p1 * columns[3968 + i] + p2 * columns[4096 + i] + p3 * columns[4224 + i]
        columns[1024 + i] = q0 * r0 + q1 * r1 + q2 * r2 + q3 * r3 - columns[896 + i]


@part
def stays_inside(image, x, y, reach):  # type: ignore[no-untyped-def]
    """Whether a square of half size `reach` px around (x, y) can be sampled."""
    h, w = image.shape
    margin = reach + BORDER
    return margin < x < w - 1 - margin and margin < y < h - 1 - margin


@part
def template_equations(host, u, v, columns, A):  # type: ignore[no-untyped-def]
    """The host's patch around (u, v) and the normal matrix of the warp's six steps (translation 2, linear part 4, row by row) and
    of the offset, from its gradients.

    Fills columns' first eight rows of 128 with j = (gx, gy, gx dx, gx dy, gy dx, gy dy, 1) and the grey value of each pixel, row by
    row, and A (7, 7) with the sums over the patch of j j^T. Returns the least eigenvalue of the structure tensor a pixel with the
    offset eliminated.
    """
    n, i, lanes = (2 * HALF + 1) ** 2, 0, columns.shape[0] // 272  # not a constant: vectors
    for dy in range(-HALF, HALF + 1):
        above, here, below = host[v + dy - 1], host[v + dy], host[v + dy + 1]
        for dx in range(-HALF, HALF + 1):
            gx, gy = f32(0.5) * (here[u + dx + 1] - here[u + dx - 1]), f32(0.5) * (below[u + dx] - above[u + dx])
            columns[i], columns[128 + i], columns[896 + i] = gx, gy, here[u + dx]
            columns[256 + i], columns[384 + i] = gx * f32(dx), gx * f32(dy)
            columns[512 + i], columns[640 + i] = gy * f32(dx), gy * f32(dy)
            i += 1
    for k in range(SUMS, SUMS + 16 * 28):
        columns[k] = 0
    for first in range(0, 128, 16):
        add_products(columns, first, lanes)
    row = 0
    for a in range(7):
        for b in range(a + 1):
            A[a, b] = A[b, a] = total(columns, row)
            row += 1
    xx, xy, yy = A[0, 0] - A[0, 6] * A[0, 6] / n, A[0, 1] - A[0, 6] * A[1, 6] / n, A[1, 1] - A[1, 6] * A[1, 6] / n
    return 0.5 * (xx + yy - math.sqrt((xx - yy) ** 2 + 4.0 * xy * xy)) / n


@inlined
def add_products(columns, first, lanes):  # type: ignore[no-untyped-def]
    """j j^T of sixteen pixels, to the sums."""
    for k in range(lanes):
        i = first + k
        j0, j1, j2, j3 = columns[i], columns[128 + i], columns[256 + i], columns[384 + i]
        j4, j5, j6 = columns[512 + i], columns[640 + i], columns[768 + i]
        columns[1152 + k] += j0 * j0
        columns[1168 + k] += j1 * j0
        columns[1184 + k] += j1 * j1
        columns[1200 + k] += j2 * j0
        columns[1216 + k] += j2 * j1
        columns[1232 + k] += j2 * j2
        columns[1248 + k] += j3 * j0
        columns[1264 + k] += j3 * j1
        columns[1280 + k] += j3 * j2
        columns[1296 + k] += j3 * j3
        columns[1312 + k] += j4 * j0
        columns[1328 + k] += j4 * j1
        columns[1344 + k] += j4 * j2
        columns[1360 + k] += j4 * j3
        columns[1376 + k] += j4 * j4
        columns[1392 + k] += j5 * j0
        columns[1408 + k] += j5 * j1
        columns[1424 + k] += j5 * j2
        columns[1440 + k] += j5 * j3
        columns[1456 + k] += j5 * j4
        columns[1472 + k] += j5 * j5
        columns[1488 + k] += j6 * j0
        columns[1504 + k] += j6 * j1
        columns[1520 + k] += j6 * j2
        columns[1536 + k] += j6 * j3
        columns[1552 + k] += j6 * j4
        columns[1568 + k] += j6 * j5
        columns[1584 + k] += j6 * j6


@inlined
def total(columns, row):  # type: ignore[no-untyped-def]
    """One of the sums, over its sixteen."""
    s = 0.0
    for k in range(16):
        s += columns[SUMS + 16 * row + k]
    return s


@part
def right_side(columns, target, x, y, W, sharp, e):  # type: ignore[no-untyped-def]
    """Fills e (7,) with the sums of j r, r = target(x + W d) - template; W (2, 2). Returns the mean of r^2 without its mean."""
    n, i, lanes = (2 * HALF + 1) ** 2, 0, columns.shape[0] // 272  # not a constant: vectors
    w00, w01, w10, w11 = W[0, 0], W[0, 1], W[1, 0], W[1, 1]
    for dy in range(-HALF, HALF + 1):
        row_x, row_y = x + w01 * dy, y + w11 * dy
        if sharp:
            for dx in range(-HALF, HALF + 1):
                fetch_sixteen(target, row_x + w00 * dx, row_y + w10 * dx, columns, i)
                i += 1
        else:
            for dx in range(-HALF, HALF + 1):
                columns[1024 + i] = bilinear(target, row_x + w00 * dx, row_y + w10 * dx) - columns[896 + i]
                i += 1
    if sharp:
        for first in range(0, 128, 16):
            add_cubics(columns, first, lanes)
    for k in range(SUMS, SUMS + 16 * 8):
        columns[k] = 0
    for first in range(0, 128, 16):
        add_residuals(columns, first, lanes)
    for k in range(7):
        e[k] = total(columns, k)
    return (total(columns, 7) - e[6] * e[6] / n) / n


@inlined
def add_residuals(columns, first, lanes):  # type: ignore[no-untyped-def]
    """j r and r^2 of sixteen pixels, to the sums."""
    for k in range(lanes):
        i = first + k
        r = columns[1024 + i]
        columns[1152 + k] += columns[i] * r
        columns[1168 + k] += columns[128 + i] * r
        columns[1184 + k] += columns[256 + i] * r
        columns[1200 + k] += columns[384 + i] * r
        columns[1216 + k] += columns[512 + i] * r
        columns[1232 + k] += columns[640 + i] * r
        columns[1248 + k] += columns[768 + i] * r
        columns[1264 + k] += r * r


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
def refine_warp(columns, target, x, y, W, A, vectors, L):  # type: ignore[no-untyped-def]
    """Inverse compositional alignment (Baker, Matthews 2004) of the host's patch from (x, y) and the warp W (2, 2), which is
    updated; columns and A (7, 7) of `template_equations`, vectors (3, 7) and L (7, 7) working space. Returns x, y and the
    rms residual, negative where it fails."""
    n, start00, start11 = (2 * HALF + 1) ** 2, W[0, 0], W[1, 1]
    x0, y0, variance, length, smooth, k = x, y, 0.0, 0.0, SMOOTH_STEPS, 0
    step, e = vectors[0], vectors[1]
    while k < smooth + SHARP_STEPS:
        reach = HALF * (max(abs(W[0, 0]), abs(W[1, 1])) + max(abs(W[0, 1]), abs(W[1, 0])))
        if not stays_inside(target, x, y, reach):
            return x, y, -1.0
        variance = right_side(columns, target, x, y, W, k >= smooth, e)
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


def patch_columns():  # type: ignore[no-untyped-def]
    """Working space for a patch of 121 pixels."""
    columns = np.zeros(COLUMNS, np.float32)
    columns[768 : 768 + (2 * HALF + 1) ** 2] = 1
    return columns


def match_patches(host, target, pixels, start, scale, directions, reach, min_eigenvalue, out):  # type: ignore[no-untyped-def]
    """Where patches around pixels (n, 2) int64 of `host` lie in `target`, both (h, w) float32.

    start (n, 2) px, NaN for those to leave out; scale (n,) of the patch in the target; directions (n, 2) unit vectors along which
    it is first looked for within +-reach (n,) px. Fills out (n, 3): u, v in the target and the rms residual, NaN where there is no
    match.
    """
    working_space = patch_columns(), np.empty((2, 7, 7)), np.empty((3, 7)), np.empty((2, 2))
    match_each(host, target, pixels, start, scale, directions, reach, min_eigenvalue, *working_space, out)


@kernel
def match_each(  # type: ignore[no-untyped-def]
    host, target, pixels, start, scale, directions, reach, min_eigenvalue, columns, matrices, vectors, W, out
):
    """match_patches with working space `patch_columns`, matrices (2, 7, 7), vectors (3, 7), W (2, 2)."""
    A, L = matrices[0], matrices[1]
    for i in range(pixels.shape[0]):
        out[i, 0] = out[i, 1] = out[i, 2] = np.nan
        u, v, x, y = pixels[i, 0], pixels[i, 1], start[i, 0], start[i, 1]
        if not (math.isfinite(x) and math.isfinite(y)) or not stays_inside(host, float(u), float(v), float(HALF)):
            continue
        if template_equations(host, u, v, columns, A) < min_eigenvalue:
            continue
        W[0, 0] = W[1, 1] = scale[i]
        W[0, 1] = W[1, 0] = 0.0
        if reach[i] > 0.7:
            x, y = search(host, target, u, v, x, y, W, directions[i], reach[i])
            if not math.isfinite(x):
                continue
        x, y, rms = refine_warp(columns, target, x, y, W, A, vectors, L)
        if rms >= 0.0:
            out[i, 0], out[i, 1], out[i, 2] = x, y, rms
