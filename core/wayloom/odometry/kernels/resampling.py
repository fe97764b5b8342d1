"""Bicubic resampling of an image that is displaced smoothly: by a few pixels, and by nearly as much next door.

The displacement is known at the corners of cells and bilinear between them. Neighbours are displaced by the same number of whole
pixels for most of a row, so that a row is a few runs, in each of which the sixteen pixels around come from four rows at fixed
offsets: the arithmetic runs on vectors, which a look-up a pixel does not. Near the border pixels go one by one.
"""

import numpy as np

from wayloom.odometry.kernels.compiler import inlined, kernel, part

f32 = np.float32
STEP = 8
"""px, edge of a cell."""
A = -0.75
"""Slope of the cubic at one pixel from its middle (Keys, Cubic Convolution Interpolation, 1981, eq. 15, with a free a)."""


def resample(image, corners, first_row):  # type: ignore[no-untyped-def]
    """The pixels (h - first_row, w) uint8 of an image (h, w) uint8 at where each one of it is displaced to, from one row on.

    corners (at least h // STEP + 2, at least w // STEP + 2, 2) float32 px, finite: displacement in u and v at the multiples of
    STEP. Beyond the border the outermost pixels repeat.
    """
    h, w = image.shape
    out = np.empty((h - first_row, w), np.uint8)
    fill_resampled(image, corners, first_row, np.empty((4, (w // STEP + 1) * STEP), np.float32), out)
    return out


@kernel
def fill_resampled(image, corners, first_row, moved, out):  # type: ignore[no-untyped-def]
    """resample into out, with working space moved (4, at least w)."""
    h, w = image.shape
    for row in range(out.shape[0]):
        y = first_row + row
        share = f32(y % STEP) / f32(STEP)
        if row == 0 or y % STEP == 0:
            spread(corners[y // STEP], corners[y // STEP + 1], moved)
        x = 0
        while x < w:
            du, dv = np.floor(displacement(moved, 0, x, share)), np.floor(displacement(moved, 2, x, share))
            end = end_of_run(moved, share, x, w, du, dv)
            right, top = int(du), y + int(dv) - 1
            low, high = max(x, 1 - right), min(end, w - 2 - right)
            if low >= high or top < 0 or top + 3 >= h:
                low = high = end
            for k in range(x, low):
                out[row, k] = one_pixel(
                    image, k + right, top + 1, displacement(moved, 0, k, share) - du, displacement(moved, 2, k, share) - dv
                )
            if low < high:
                first, last = low + right - 1, high + right + 2
                fill_run(
                    image[top, first:last], image[top + 1, first:last], image[top + 2, first:last], image[top + 3, first:last],
                    moved[0, low:high], moved[1, low:high], moved[2, low:high], moved[3, low:high], share, du, dv,
                    out[row, low:high],
                )  # fmt: skip
            for k in range(high, end):
                out[row, k] = one_pixel(
                    image, k + right, top + 1, displacement(moved, 0, k, share) - du, displacement(moved, 2, k, share) - dv
                )
            x = end


@inlined
def displacement(moved, axis, x, share):  # type: ignore[no-untyped-def]
    """Displacement of a pixel along an axis (0 or 2), `share` of a cell below the cell's upper edge."""
    return moved[axis, x] + share * moved[axis + 1, x]


@part
def spread(upper, lower, moved):  # type: ignore[no-untyped-def]
    """Of a row of cells, by its upper and lower corners (n, 2): fills moved (4, w) with each column's displacement at the upper
    edge, and what is added to it on the way to the lower one; for u, then for v."""
    for axis in range(2):
        for cell in range(moved.shape[1] // STEP):
            here, below = upper[cell, axis], lower[cell, axis]
            slope, slope_below = (upper[cell + 1, axis] - here) / f32(STEP), (lower[cell + 1, axis] - below) / f32(STEP)
            for k in range(STEP):
                value = here + f32(k) * slope
                moved[2 * axis, cell * STEP + k] = value
                moved[2 * axis + 1, cell * STEP + k] = below + f32(k) * slope_below - value


@part
def end_of_run(moved, share, x, w, du, dv):  # type: ignore[no-untyped-def]
    """The first pixel behind x that is displaced by other whole pixels than du, dv. A cell whose ends are alike is all alike."""
    x += 1
    while x < w:
        if (
            x % STEP == 0
            and x + STEP <= w
            and is_displaced_by(moved, share, x, du, dv)
            and is_displaced_by(moved, share, x + STEP - 1, du, dv)
        ):
            x += STEP
        elif is_displaced_by(moved, share, x, du, dv):
            x += 1
        else:
            break
    return x


@inlined
def is_displaced_by(moved, share, x, du, dv):  # type: ignore[no-untyped-def]
    """Whether a pixel is displaced by the whole pixels du, dv."""
    return np.floor(displacement(moved, 0, x, share)) == du and np.floor(displacement(moved, 2, x, share)) == dv


@inlined
def cubic(t):  # type: ignore[no-untyped-def]
    """Weights of the pixels at -1, 0, 1 and 2 for a place t between 0 and 1."""
    one, a, rest = f32(1), f32(A), f32(1) - t
    w0 = a * t * rest * rest
    w1 = ((a + f32(2)) * t - (a + f32(3))) * t * t + one
    w2 = ((a + f32(2)) * rest - (a + f32(3))) * rest * rest + one
    return w0, w1, w2, one - w0 - w1 - w2


@inlined
def grey(value):  # type: ignore[no-untyped-def]
    """The nearest grey level."""
    return np.uint8(np.int32(min(max(value, f32(0)), f32(255)) + f32(0.5)))


@part
def fill_run(r0, r1, r2, r3, u, u_down, v, v_down, share, du, dv, out):  # type: ignore[no-untyped-def]
    """A run's pixels (n,): r0 to r3 (n + 3,) the rows around from one column before on, u to v_down (n,) parts of `moved`."""
    for k in range(out.shape[0]):
        a0, a1, a2, a3 = cubic(u[k] + share * u_down[k] - du)
        b0, b1, b2, b3 = cubic(v[k] + share * v_down[k] - dv)
        s = b0 * (a0 * f32(r0[k]) + a1 * f32(r0[k + 1]) + a2 * f32(r0[k + 2]) + a3 * f32(r0[k + 3]))
        s += b1 * (a0 * f32(r1[k]) + a1 * f32(r1[k + 1]) + a2 * f32(r1[k + 2]) + a3 * f32(r1[k + 3]))
        s += b2 * (a0 * f32(r2[k]) + a1 * f32(r2[k + 1]) + a2 * f32(r2[k + 2]) + a3 * f32(r2[k + 3]))
        s += b3 * (a0 * f32(r3[k]) + a1 * f32(r3[k + 1]) + a2 * f32(r3[k + 2]) + a3 * f32(r3[k + 3]))
        out[k] = grey(s)


@part
def one_pixel(image, x, y, tu, tv):  # type: ignore[no-untyped-def]
    """The pixel at (x + tu, y + tv) of an image (h, w), whose outermost pixels repeat."""
    h, w = image.shape
    (a0, a1, a2, a3), weights = cubic(tu), cubic(tv)
    x0, x1, x2, x3 = min(max(x - 1, 0), w - 1), min(max(x, 0), w - 1), min(max(x + 1, 0), w - 1), min(max(x + 2, 0), w - 1)
    s = f32(0)
    for k in range(4):
        around = image[min(max(y - 1 + k, 0), h - 1)]
        s += weights[k] * (a0 * f32(around[x0]) + a1 * f32(around[x1]) + a2 * f32(around[x2]) + a3 * f32(around[x3]))
    return grey(s)
