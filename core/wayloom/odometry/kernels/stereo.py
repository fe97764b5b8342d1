"""Static stereo matching: a pixel of the left image found in the same row of the right one, to a fraction of a pixel."""

import math

import numpy as np

from wayloom.odometry.kernels.compiler import inlined, kernel, part

f32, int16 = np.float32, np.int16
NO_MATCH = 1e9
"""The sigma of a pixel without a match, px."""
BEHIND_INFINITY = 2
"""px: the search starts a little behind infinity, because of the disparity bias."""
HALF_W, HALF_H = 3, 2
PATCH_PIXELS = (2 * HALF_W + 1) * (2 * HALF_H + 1)
SLOPES, SUMS, COUNTED = 40, 80, 120
"""Where in `refinement_columns` the slopes begin, the sums, and what says which pixels count."""


@inlined
def distance(value, other):  # type: ignore[no-untyped-def]
    """|value - other| of int16, as int16: wider numbers would halve what a vector holds."""
    d = int16(value - other)
    return max(d, int16(-d))


@kernel
def sobel_rows(image, cap, out):  # type: ignore[no-untyped-def]
    """(h, w) uint8 to out (h, w) int16: horizontal Sobel capped to +-cap, a quarter of it, 0 in the outermost pixels."""
    h, w = image.shape
    out[0], out[h - 1] = int16(0), int16(0)
    low, high = int16(-cap), int16(cap)
    for y in range(1, h - 1):
        above, here, below, row = image[y - 1], image[y], image[y + 1], out[y]
        row[0] = row[w - 1] = 0
        for x in range(w - 2):
            sides = int16(int16(above[x + 2]) - int16(above[x])) + int16(int16(below[x + 2]) - int16(below[x]))
            slope = int16(int16(sides) + int16(int16(2) * int16(int16(here[x + 2]) - int16(here[x]))))
            row[x + 1] = int16(min(max(slope, low), high) >> int16(2))


@part
def best_column(template, image, u, v, x_low, x_high, costs):  # type: ignore[no-untyped-def]
    """Sum of absolute differences of template's patch at (u, v) against image's at (x, v), x_low <= x <= x_high, both int16.

    Returns the best x (-1: range too short), its cost a pixel and the least cost a pixel more than 2 px away from it. The innermost
    loops run over x, so that they vectorise; a row's seven columns are summed at once.
    """
    x_low, x_high = max(HALF_W, x_low), min(image.shape[1] - 1 - HALF_W, x_high)
    n = x_high - x_low + 1
    if n < 3:
        return -1, NO_MATCH, NO_MATCH
    for k in range(n):
        costs[k] = 0
    for y in range(v - HALF_H, v + HALF_H + 1):
        row = image[y, x_low - 3 : x_low + 3 + n]
        t0, t1, t2, t3 = template[y, u - 3], template[y, u - 2], template[y, u - 1], template[y, u]
        t4, t5, t6 = template[y, u + 1], template[y, u + 2], template[y, u + 3]
        for k in range(n):
            near = int16(distance(t2, row[k + 2]) + distance(t3, row[k + 3])) + distance(t4, row[k + 4])
            far = int16(distance(t0, row[k]) + distance(t1, row[k + 1]))
            far = int16(int16(far + distance(t5, row[k + 5])) + distance(t6, row[k + 6]))
            costs[k] = int16(int16(costs[k] + int16(near)) + far)
    best, second, at = int16(32767), int16(32767), 0
    for k in range(n):
        best = min(best, costs[k])
    while costs[at] != best:
        at += 1
    for k in range(at - 2):
        second = min(second, costs[k])
    for k in range(at + 3, n):
        second = min(second, costs[k])
    return x_low + at, best / PATCH_PIXELS, second / PATCH_PIXELS


@part
def refine_column(left, right, u, v, x_start, columns):  # type: ignore[no-untyped-def]
    """Sub-pixel column of left's patch at (u, v) in right, both (h, w) uint8; columns (128,) of `refinement_columns`.

    Gauss-Newton on sum (R(x) - L - offset)^2 with the offset eliminated and the gradient averaged over both images. Returns x and
    its sigma = sqrt(residual variance / information), NO_MATCH where it does not converge.
    """
    lanes = columns.shape[0] // 16  # not a constant: the compiler would unroll instead of using vectors
    for row in range(2 * HALF_H + 1):
        here = left[v - HALF_H + row]
        for k in range(2 * HALF_W + 1):
            columns[8 * row + k] = here[u - HALF_W + k]
            columns[SLOPES + 8 * row + k] = f32(here[u - HALF_W + k + 1]) - f32(here[u - HALF_W + k - 1])
    x, information, variance = float(x_start), 0.0, 0.0
    for _ in range(6):
        if not (x - HALF_W >= 1.0 and x + HALF_W < right.shape[1] - 3):
            return x, NO_MATCH
        ix = int(x)
        for k in range(SUMS, COUNTED):
            columns[k] = f32(0)
        for row in range(2 * HALF_H + 1):
            add_row(right[v - HALF_H + row, ix - HALF_W - 1 : ix - HALF_W + 10], f32(x - ix), 8 * row, columns, lanes)
        sr, sj, srj, sjj, srr = 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(8):
            sr += columns[SUMS + k]
            sj += columns[SUMS + 8 + k]
            srj += columns[SUMS + 16 + k]
            sjj += columns[SUMS + 24 + k]
            srr += columns[SUMS + 32 + k]
        information, variance = sjj - sj * sj / PATCH_PIXELS, (srr - sr * sr / PATCH_PIXELS) / PATCH_PIXELS
        if information < 1.0:
            return x, NO_MATCH
        step = max(-0.7, min(0.7, -(srj - sr * sj / PATCH_PIXELS) / information))
        x += step
        if abs(x - x_start) > 1.5:
            return x, NO_MATCH
        if abs(step) < 0.01:
            break
    return x, math.sqrt(max(variance, 4.0) / information)


@inlined
def add_row(row, share, first, columns, lanes):  # type: ignore[no-untyped-def]
    """Adds a row of the patch, in columns from `first` on, to the sums of r, j, r j, j^2 and r^2; row (11,) uint8 of the right
    image from a pixel before on, share of a pixel to the right."""
    rest = f32(1) - share
    for k in range(lanes):
        before, r0, r1, after = f32(row[k]), f32(row[k + 1]), f32(row[k + 2]), f32(row[k + 3])
        counted = columns[COUNTED + k]
        r = counted * (rest * r0 + share * r1 - columns[first + k])
        j = counted * f32(0.25) * (rest * (r1 - before) + share * (after - r0) + columns[SLOPES + first + k])
        columns[SUMS + k] += r
        columns[SUMS + 8 + k] += j
        columns[SUMS + 16 + k] += r * j
        columns[SUMS + 24 + k] += j * j
        columns[SUMS + 32 + k] += r * r


def refinement_columns():  # type: ignore[no-untyped-def]
    """Working space of refine_column: rows of eight for the patch's grey levels and slopes and for five sums, and which of the
    eight are in the patch."""
    columns = np.zeros(128, np.float32)
    columns[COUNTED : COUNTED + 2 * HALF_W + 1] = 1
    return columns


def match_rows(slope_left, slope_right, left, right, pixels, max_disparity, uniqueness, max_cost, out):  # type: ignore[no-untyped-def]
    """Disparity u_left - u_right of pixels (n, 2) int64 along rows.

    Search on capped horizontal slopes (h, w) int16, tests of cost, uniqueness (best < uniqueness * second) and left-right agreement
    within 1 px, then sub-pixel on the images (h, w) uint8. Fills out (n, 2): disparity and its sigma, px; sigma is NO_MATCH for a
    pixel that fails a test.
    """
    costs = np.empty(max(max_disparity, 80) + 8, np.int16)
    search_rows(
        slope_left, slope_right, left, right, pixels, max_disparity, uniqueness, max_cost, costs, refinement_columns(), out
    )  # fmt: skip


@kernel
def search_rows(  # type: ignore[no-untyped-def]
    slope_left, slope_right, left, right, pixels, max_disparity, uniqueness, max_cost, costs, columns, out
):
    """match_rows with working space costs, int16, for each column that is searched, and `refinement_columns`."""
    h, w = left.shape
    for i in range(pixels.shape[0]):
        u, v = pixels[i, 0], pixels[i, 1]
        out[i, 0], out[i, 1] = 0.0, NO_MATCH
        if u - HALF_W < 1 or u + HALF_W >= w - 1 or v - HALF_H < 1 or v + HALF_H >= h - 1:
            continue
        x, cost, second = best_column(slope_left, slope_right, u, v, u - max_disparity, u + BEHIND_INFINITY, costs)
        if x - HALF_W < 1 or x + HALF_W > w - 3 or cost > max_cost or uniqueness * second < cost:
            continue
        low, high = x + max(-BEHIND_INFINITY, u - x - 40), x + min(max_disparity, u - x + 40)
        back = best_column(slope_right, slope_left, x, v, low, high, costs)[0]
        if abs(back - u) > 1:
            continue
        x_fine, sigma = refine_column(left, right, u, v, x, columns)
        out[i, 0], out[i, 1] = u - x_fine, sigma


def refine_both_axes(left, right, pixels, disparity, half, min_eigenvalue, out):  # type: ignore[no-untyped-def]
    """2D Lucas-Kanade of (2 half + 1)^2 patches with the intensity offset eliminated, for the rows' misalignment.

    left, right (h, w) uint8, pixels (n, 2) int64, disparity (n,) px to start from; min_eigenvalue of the structure tensor, a pixel.
    Fills out (n, 3): disparity, row offset v_right - v_left, 1 if converged else 0.
    """
    track_patches(left, right, pixels, disparity, half, min_eigenvalue, np.empty(8), out)


@kernel
def track_patches(left, right, pixels, disparity, half, min_eigenvalue, s, out):  # type: ignore[no-untyped-def]
    """refine_both_axes with working space s (8,)."""
    h, w = left.shape
    n, border = (2 * half + 1) ** 2, half + 3
    for i in range(pixels.shape[0]):
        u, v = pixels[i, 0], pixels[i, 1]
        out[i, 2] = 0.0
        x_start = u - disparity[i]
        x, y = x_start, float(v)
        if not (border < u < w - border - 1 and border < v < h - border - 1):
            continue
        for _ in range(10):
            if not (border < x < w - border - 1 and border < y < h - border - 1):
                break
            patch_sums(left, right, u, v, x, y, half, s)
            a00, a01, a11 = s[0] - s[5] * s[5] / n, s[1] - s[5] * s[6] / n, s[2] - s[6] * s[6] / n
            b0, b1 = s[3] - s[5] * s[7] / n, s[4] - s[6] * s[7] / n
            det, trace = a00 * a11 - a01 * a01, a00 + a11
            if 0.5 * (trace - math.sqrt(max(trace * trace - 4.0 * det, 0.0))) < n * min_eigenvalue:
                break
            step_x = max(-1.0, min(1.0, -(a11 * b0 - a01 * b1) / det))
            step_y = max(-1.0, min(1.0, -(a00 * b1 - a01 * b0) / det))
            x += step_x
            y += step_y
            if abs(x - x_start) > 2.0 or abs(y - v) > 2.5:
                break
            if abs(step_x) + abs(step_y) < 0.01:
                out[i, 0], out[i, 1], out[i, 2] = u - x, y - v, 1.0
                break


@part
def patch_sums(left, right, u, v, x, y, half, s):  # type: ignore[no-untyped-def]
    """Fills s (8,) with the sums over a patch of gx gx, gx gy, gy gy, gx r, gy r, gx, gy, r: left's gradient,
    r = right(x, y) - left(u, v)."""
    s[:] = 0.0
    ix, iy = int(x), int(y)
    a, b = x - ix, y - iy
    for dy in range(-half, half + 1):
        for dx in range(-half, half + 1):
            row, c = iy + dy, ix + dx
            value = (1.0 - b) * ((1.0 - a) * right[row, c] + a * right[row, c + 1])
            value += b * ((1.0 - a) * right[row + 1, c] + a * right[row + 1, c + 1])
            r = value - left[v + dy, u + dx]
            gx = 0.5 * (float(left[v + dy, u + dx + 1]) - float(left[v + dy, u + dx - 1]))
            gy = 0.5 * (float(left[v + dy + 1, u + dx]) - float(left[v + dy - 1, u + dx]))
            s[0] += gx * gx
            s[1] += gx * gy
            s[2] += gy * gy
            s[3] += gx * r
            s[4] += gy * r
            s[5] += gx
            s[6] += gy
            s[7] += r
