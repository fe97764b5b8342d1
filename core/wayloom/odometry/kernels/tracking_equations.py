"""Normal equations of direct image alignment: reference points in blocks of 16, so that the arithmetic runs on vectors.

A block goes through three short loops (project, interpolate and weigh, add up) with columns of 16 between them in one flat array: a
compiler that sees one array and constant distances knows that nothing overlaps. float64 holds places in the image, float32 grey
values, derivatives and sums, each of its 16 own.
"""

import numpy as np

from wayloom.odometry.kernels.compiler import inlined, part

f32 = np.float32
index = np.uint64
"""Pixels are addressed by unsigned numbers: a signed index is tested for being negative each time."""
ONE, TWO = index(1), index(2)
MIN_DEPTH_RATIO = 1e-3
BORDER = 2
LANES = 16
PLACES, COLUMNS, SUMS = 5 * LANES, 64 * LANES, 18 * LANES
"""Sizes of working space, and where the sums begin: 36 of H's lower triangle row by row, 8 of g, energy, points beyond."""


def working_space():  # type: ignore[no-untyped-def]
    """places, float64, and columns, float32, of tracking_equations."""
    return np.empty(PLACES), np.zeros(COLUMNS, np.float32)


@part
def tracking_equations(  # type: ignore[no-untyped-def]
    image, reference, T, gain, offset, camera, huber, cutoff, H, g, places, columns
):
    """Normal equations of r = I(project(T p)) - (gain I_ref + offset) with Huber weight, constant energy beyond cutoff.

    image (h, w) uint8 or float32, its gradient by central differences; reference (n, 4) x, y, rho, grey; T (4, 4) T_frame_keyframe;
    camera (4,) px. Fills H (8, 8) = J^T W J and g (8,) = -J^T W r for (v, omega, gain, offset); places and columns are
    `working_space`; returns energy, points in view, points beyond cutoff.
    """
    h, w = image.shape
    fx, fy = f32(camera[0]), f32(camera[1])
    seen, filled, lanes = 0, 0, columns.shape[0] // 64  # not a constant: the compiler would unroll instead of using vectors
    for k in range(SUMS, columns.shape[0]):
        columns[k] = 0
    for first in range(0, reference.shape[0], LANES):
        points = reference[first : first + LANES]
        project(points, T, camera, h, w, places)
        for k in range(points.shape[0]):
            if not places[k] >= 0.0:
                continue
            fetch(image, places, k, points[k, 3], columns, filled)
            seen, filled = seen + 1, filled + 1
            if filled == LANES:
                weigh(f32(gain), f32(offset), fx, fy, f32(huber), f32(cutoff), columns, lanes)
                add_up(columns, lanes)
                filled = 0
    if filled:
        weigh(f32(gain), f32(offset), fx, fy, f32(huber), f32(cutoff), columns, lanes)
        for column in range(12):
            for k in range(filled, LANES):
                columns[16 * column + k] = 0
        add_up(columns, lanes)
    for k in range(8):
        g[k] = -total(columns, 36 + k)
        for m in range(k + 1):
            H[k, m] = H[m, k] = total(columns, k * (k + 1) // 2 + m)
    return total(columns, 44), seen, int(total(columns, 45))


@inlined
def project(points, T, camera, h, w, places):  # type: ignore[no-untyped-def]
    """Reference points (16 or fewer, 4) to places: u and v px, x and y of the ray, rho, in the frame; u is -1 out of view."""
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    for k in range(points.shape[0]):
        x, y, rho = points[k, 0], points[k, 1], points[k, 2]
        Z = T[2, 0] * x + T[2, 1] * y + T[2, 2] + T[2, 3] * rho
        iz = 1.0 / Z
        xn = (T[0, 0] * x + T[0, 1] * y + T[0, 2] + T[0, 3] * rho) * iz
        yn = (T[1, 0] * x + T[1, 1] * y + T[1, 2] + T[1, 3] * rho) * iz
        u, v = fx * xn + cx, fy * yn + cy
        inside = (Z > MIN_DEPTH_RATIO) & (u > BORDER) & (v > BORDER) & (u < w - BORDER - 1) & (v < h - BORDER - 1)
        places[k], places[16 + k] = (u if inside else -1.0), v
        places[32 + k], places[48 + k], places[64 + k] = xn, yn, rho * iz


@inlined
def fetch(image, places, k, grey, columns, to):  # type: ignore[no-untyped-def]
    """Place k and the pixels around it into row `to` of the columns: fractions, ray, rho, grey of the reference; the four pixels
    around; those left and right of them, above and below."""
    u, v = places[k], places[16 + k]
    x, y = index(u), index(v)
    columns[to], columns[16 + to] = u - x, v - y
    columns[32 + to], columns[48 + to], columns[64 + to] = places[32 + k], places[48 + k], places[64 + k]
    up, here, below, down = image[y - ONE], image[y], image[y + ONE], image[y + TWO]
    columns[80 + to] = grey
    columns[96 + to], columns[112 + to], columns[128 + to], columns[144 + to] = here[x], here[x + ONE], below[x], below[x + ONE]
    columns[160 + to], columns[176 + to] = here[x - ONE], here[x + TWO]
    columns[192 + to], columns[208 + to] = below[x - ONE], below[x + TWO]
    columns[224 + to], columns[240 + to], columns[256 + to], columns[272 + to] = up[x], up[x + ONE], down[x], down[x + ONE]


@inlined
def weigh(gain, offset, fx, fy, huber, cutoff, columns, lanes):  # type: ignore[no-untyped-def]
    """What was fetched to the Jacobian's eight columns, weight and residual (zero beyond cutoff), energy, and 1 beyond cutoff."""
    half, one, two, zero = f32(0.5), f32(1), f32(2), f32(0)
    most = huber * (two * cutoff - huber)
    for k in range(lanes):
        a, b, xn, yn, q, grey = columns[k], columns[16 + k], columns[32 + k], columns[48 + k], columns[64 + k], columns[80 + k]
        i00, i10, i01, i11 = columns[96 + k], columns[112 + k], columns[128 + k], columns[144 + k]
        left0, right0, left1, right1 = columns[160 + k], columns[176 + k], columns[192 + k], columns[208 + k]
        up0, up1, down0, down1 = columns[224 + k], columns[240 + k], columns[256 + k], columns[272 + k]
        w11 = a * b
        w01, w10, w00 = b - w11, a - w11, one - a - b + w11
        r = w00 * i00 + w10 * i10 + w01 * i01 + w11 * i11 - (gain * grey + offset)
        size = abs(r)
        share, fits = huber / max(size, huber), size <= cutoff
        gx = fx * half * (w00 * (i10 - left0) + w10 * (right0 - i00) + w01 * (i11 - left1) + w11 * (right1 - i01))
        gy = fy * half * (w00 * (i01 - up0) + w10 * (i11 - up1) + w01 * (down0 - i00) + w11 * (down1 - i10))
        along = xn * gx + yn * gy
        columns[k], columns[16 + k], columns[32 + k] = q * gx, q * gy, -q * along
        columns[48 + k], columns[64 + k], columns[80 + k] = -(yn * along + gy), xn * along + gx, xn * gy - yn * gx
        columns[96 + k], columns[112 + k] = -grey, -one
        columns[128 + k], columns[144 + k] = share if fits else zero, r if fits else zero
        columns[160 + k], columns[176 + k] = share * r * r * (two - share) if fits else most, zero if fits else one


@inlined
def add_up(columns, lanes):  # type: ignore[no-untyped-def]
    """Add weigh's columns to the sums."""
    for k in range(lanes):
        j0, j1, j2, j3 = columns[k], columns[16 + k], columns[32 + k], columns[48 + k]
        j4, j5, j6, j7 = columns[64 + k], columns[80 + k], columns[96 + k], columns[112 + k]
        w, r = columns[128 + k], columns[144 + k]
        c0, c1, c2, c3, c4, c5, c6, c7 = w * j0, w * j1, w * j2, w * j3, w * j4, w * j5, w * j6, w * j7
        columns[288 + k] += c0 * j0
        columns[304 + k] += c1 * j0
        columns[320 + k] += c1 * j1
        columns[336 + k] += c2 * j0
        columns[352 + k] += c2 * j1
        columns[368 + k] += c2 * j2
        columns[384 + k] += c3 * j0
        columns[400 + k] += c3 * j1
        columns[416 + k] += c3 * j2
        columns[432 + k] += c3 * j3
        columns[448 + k] += c4 * j0
        columns[464 + k] += c4 * j1
        columns[480 + k] += c4 * j2
        columns[496 + k] += c4 * j3
        columns[512 + k] += c4 * j4
        columns[528 + k] += c5 * j0
        columns[544 + k] += c5 * j1
        columns[560 + k] += c5 * j2
        columns[576 + k] += c5 * j3
        columns[592 + k] += c5 * j4
        columns[608 + k] += c5 * j5
        columns[624 + k] += c6 * j0
        columns[640 + k] += c6 * j1
        columns[656 + k] += c6 * j2
        columns[672 + k] += c6 * j3
        columns[688 + k] += c6 * j4
        columns[704 + k] += c6 * j5
        columns[720 + k] += c6 * j6
        columns[736 + k] += c7 * j0
        columns[752 + k] += c7 * j1
        columns[768 + k] += c7 * j2
        columns[784 + k] += c7 * j3
        columns[800 + k] += c7 * j4
        columns[816 + k] += c7 * j5
        columns[832 + k] += c7 * j6
        columns[848 + k] += c7 * j7
        columns[864 + k] += c0 * r
        columns[880 + k] += c1 * r
        columns[896 + k] += c2 * r
        columns[912 + k] += c3 * r
        columns[928 + k] += c4 * r
        columns[944 + k] += c5 * r
        columns[960 + k] += c6 * r
        columns[976 + k] += c7 * r
        columns[992 + k] += columns[160 + k]
        columns[1008 + k] += columns[176 + k]


@inlined
def total(columns, row):  # type: ignore[no-untyped-def]
    """One of the sums, over its sixteen."""
    s = 0.0
    for k in range(LANES):
        s += columns[SUMS + LANES * row + k]
    return s
