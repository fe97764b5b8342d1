"""Photometric residuals of a patch in one image of a target, their sums, and their Jacobians by pose, inverse depth and bias.

With the host's ray (x, y, 1) and inverse depth rho the point, times rho, is P = R (x, y, 1) + t rho in the target's left camera and
P + t_right_left rho in its right one. So a right image is a target with another translation, whose columns are shifted by the
disparity bias delta: u_right = fx X/Z + cx - delta. The host's own right image is the case R = I, t = 0.

A patch goes through short loops over its pixels (warp, gather, interpolate and weigh, sum) with columns of 8 between them, so that
the arithmetic runs on vectors; float32 holds grey levels and offsets within a patch, float64 everything else.
"""

import math

import numpy as np

from wayloom.odometry.kernels.arrays import PATCH, PATTERN, Scratch
from wayloom.odometry.kernels.compiler import inlined, kernel

f32, int32 = np.float32, np.int32
index = np.uint64
"""Pixels are addressed by unsigned numbers: a signed index is tested for being negative each time."""
ONE, TWO, THREE = index(1), index(2), index(3)
MIN_DEPTH_RATIO = 1e-3
BORDER = 2
ACROSS, DOWN = PATTERN[:, 0].astype(np.float32), PATTERN[:, 1].astype(np.float32)


def make_scratch() -> Scratch:
    """Working space for patch_residual and projection_jacobian."""
    return Scratch(np.zeros((4, 4)), np.zeros(4), np.zeros((2, 8)), np.zeros(48, np.int32), np.zeros(128, np.float32))


@kernel
def fill_patches(image, pixels, scale2, colours, weights):  # type: ignore[no-untyped-def]
    """Grey values of the patches around pixels (n, 2) of image (h, w) into colours (n, 8), and what their gradients g weigh into
    weights (n, 8): scale2 / (scale2 + |g|^2) (Engel et al. 2018, eq. 7)."""
    scale2 = f32(scale2)
    for i in range(pixels.shape[0]):
        for k in range(PATCH):
            x, y = pixels[i, 0] + PATTERN[k, 0], pixels[i, 1] + PATTERN[k, 1]
            gx, gy = f32(image[y, x + 1]) - f32(image[y, x - 1]), f32(image[y + 1, x]) - f32(image[y - 1, x])
            colours[i, k] = f32(image[y, x])
            weights[i, k] = scale2 / (scale2 + f32(0.25) * (gx * gx + gy * gy))


@inlined
def patch_residual(image, T, x, y, rho, rig, shift, colours, weights, gain, offset, robust, scratch):  # type: ignore[no-untyped-def]
    """Photometric residual r = I(project(T p) - (shift, 0)) - (gain colour + offset) over the 8 pixels of a patch.

    image (h, w) uint8; T (4, 4) T_target_host, with the right camera's translation for a right image; x, y ray; shift px.
    Fills scratch's M (4, 4, upper) = sum W d d^T and e (4,) = sum W d r for d = (dI/du, dI/dv, -gain colour, -1), W = gradient
    weight times Huber weight (Engel et al. 2018, eq. 4). Returns the energy and whether the patch is inside the image and in front;
    M and e of an outlier (above max_energy a pixel) are not filled.
    """
    if not gather(image, T, x, y, rho, rig, shift, scratch.words, scratch.columns):
        return 0.0, False
    energy = weigh(f32(gain), f32(offset), f32(robust.huber), colours, weights, scratch.words, scratch.columns)
    if energy <= robust.max_energy * PATCH:
        add_up(scratch.columns, scratch.M, scratch.e)
    return energy, True


@inlined
def four(image, x, y):  # type: ignore[no-untyped-def]
    """Four pixels of a row from (x, y) on as one number, the first one lowest: a single load."""
    low = int32(image[y, x]) | int32(image[y, x + ONE]) << int32(8)
    return low | int32(image[y, x + TWO]) << int32(16) | int32(image[y, x + THREE]) << int32(24)


@inlined
def pixel(word, place):  # type: ignore[no-untyped-def]
    """One of four pixels."""
    return f32(word >> int32(8 * place) & int32(255))


@inlined
def gather(image, T, x, y, rho, rig, shift, words, columns):  # type: ignore[no-untyped-def]
    """Find a patch's pixels in image (h, w): fractions of their place into columns 0 and 1, 4 x 4 pixels around each into words.

    The patch is taken as a plane that faces its host, its warp as linear around the centre. Returns whether it is inside the image.
    """
    h, w = image.shape
    Z = T[2, 0] * x + T[2, 1] * y + T[2, 2] + T[2, 3] * rho
    if not Z > MIN_DEPTH_RATIO:
        return False
    iz, aspect = 1.0 / Z, rig.fx / rig.fy
    xn = (T[0, 0] * x + T[0, 1] * y + T[0, 2] + T[0, 3] * rho) * iz
    yn = (T[1, 0] * x + T[1, 1] * y + T[1, 2] + T[1, 3] * rho) * iz
    u, v = rig.fx * xn + rig.cx - shift, rig.fy * yn + rig.cy
    uu, uv = (T[0, 0] - xn * T[2, 0]) * iz, (T[0, 1] - xn * T[2, 1]) * iz * aspect
    vu, vv = (T[1, 0] - yn * T[2, 0]) * iz / aspect, (T[1, 1] - yn * T[2, 1]) * iz
    reach_u, reach_v = 2.0 * max(abs(uu), abs(uv)), 2.0 * max(abs(vu), abs(vv))  # |dx| + |dy| is at most 2
    if not (u - reach_u > BORDER and v - reach_v > BORDER and u + reach_u < w - BORDER - 1 and v + reach_v < h - BORDER - 1):
        return False
    left, top = int(u - reach_u), int(v - reach_v)
    a, b, au, av, bu, bv = f32(u - left), f32(v - top), f32(uu), f32(uv), f32(vu), f32(vv)
    for k in range(columns.shape[0] // 16):  # not a constant: the compiler would unroll the loop instead of using vectors
        dx, dy = ACROSS[k], DOWN[k]
        p, q = a + au * dx + av * dy, b + bu * dx + bv * dy
        ip, iq = int32(p), int32(q)
        columns[k], columns[8 + k] = p - f32(ip), q - f32(iq)
        words[32 + k], words[40 + k] = ip, iq
    for k in range(PATCH):
        x0, y0 = index(left + words[32 + k]), index(top + words[40 + k])
        words[k], words[8 + k] = four(image, x0 - ONE, y0 - ONE), four(image, x0 - ONE, y0)
        words[16 + k], words[24 + k] = four(image, x0 - ONE, y0 + ONE), four(image, x0 - ONE, y0 + ONE + ONE)
    return True


@inlined
def weigh(gain, offset, huber, colours, weights, words, columns):  # type: ignore[no-untyped-def]
    """Residuals and gradients of the gathered pixels: columns become energy, r, dI/du, dI/dv, prediction, the last three times
    their weight, and the weight. Returns the energy."""
    half, one, two = f32(0.5), f32(1), f32(2)
    for k in range(weights.shape[0]):  # not a constant
        a, b = columns[k], columns[8 + k]
        w11 = a * b
        w01, w10, w00 = b - w11, a - w11, one - a - b + w11
        up, here, below, down = words[k], words[8 + k], words[16 + k], words[24 + k]
        i00, i10, i01, i11 = pixel(here, 1), pixel(here, 2), pixel(below, 1), pixel(below, 2)
        gx = w00 * (i10 - pixel(here, 0)) + w10 * (pixel(here, 3) - i00)
        gx = half * (gx + w01 * (i11 - pixel(below, 0)) + w11 * (pixel(below, 3) - i01))
        gy = w00 * (i01 - pixel(up, 1)) + w10 * (i11 - pixel(up, 2))
        gy = half * (gy + w01 * (pixel(down, 1) - i00) + w11 * (pixel(down, 2) - i10))
        predicted = gain * colours[k]
        r = w00 * i00 + w10 * i10 + w01 * i01 + w11 * i11 - (predicted + offset)
        share = huber / max(abs(r), huber)
        weight = weights[k] * share
        columns[k], columns[8 + k] = weight * r * r * (two - share), r
        columns[16 + k], columns[24 + k], columns[32 + k] = gx, gy, predicted
        columns[40 + k], columns[48 + k], columns[56 + k], columns[64 + k] = weight * gx, weight * gy, weight * predicted, weight
    energy = f32(0)
    for k in range(PATCH):
        energy += columns[k]
    return np.float64(energy)


@inlined
def looks_alike(columns, least):  # type: ignore[no-untyped-def]
    """Whether a patch's grey values correlate by at least so much with its host's, from weigh's columns.

    The energy alone says nothing of a patch with little contrast, which fits any wall.
    """
    zero, centre = f32(0), columns[36]
    seen, told, both, of_seen, of_told = zero, zero, zero, zero, zero
    for k in range(PATCH):
        predicted = columns[32 + k] - centre  # numbers near zero, for float32's sake
        found = columns[8 + k] + predicted
        seen, told = seen + found, told + predicted
        both, of_seen, of_told = both + found * predicted, of_seen + found * found, of_told + predicted * predicted
    share = f32(1.0 / PATCH)
    both, of_seen, of_told = both - share * seen * told, of_seen - share * seen * seen, of_told - share * told * told
    return both >= f32(least) * math.sqrt(of_seen * of_told) and both > zero


@inlined
def add_up(columns, M, e):  # type: ignore[no-untyped-def]
    """Fill M (4, 4, upper) and e (4,) of patch_residual from weigh's columns."""
    for k in range(columns.shape[0] // 32):  # pairs of pixels, then sums of four
        columns[72 + k] = columns[40 + k] * columns[16 + k] + columns[44 + k] * columns[20 + k]
        columns[76 + k] = columns[40 + k] * columns[24 + k] + columns[44 + k] * columns[28 + k]
        columns[80 + k] = columns[40 + k] * columns[32 + k] + columns[44 + k] * columns[36 + k]
        columns[84 + k] = columns[40 + k] + columns[44 + k]
        columns[88 + k] = columns[48 + k] * columns[24 + k] + columns[52 + k] * columns[28 + k]
        columns[92 + k] = columns[48 + k] * columns[32 + k] + columns[52 + k] * columns[36 + k]
        columns[96 + k] = columns[48 + k] + columns[52 + k]
        columns[100 + k] = columns[56 + k] * columns[32 + k] + columns[60 + k] * columns[36 + k]
        columns[104 + k] = columns[56 + k] + columns[60 + k]
        columns[108 + k] = columns[64 + k] + columns[68 + k]
        columns[112 + k] = columns[40 + k] * columns[8 + k] + columns[44 + k] * columns[12 + k]
        columns[116 + k] = columns[48 + k] * columns[8 + k] + columns[52 + k] * columns[12 + k]
        columns[120 + k] = columns[56 + k] * columns[8 + k] + columns[60 + k] * columns[12 + k]
        columns[124 + k] = columns[64 + k] * columns[8 + k] + columns[68 + k] * columns[12 + k]
    M[0, 0] = (columns[72] + columns[74]) + (columns[73] + columns[75])
    M[0, 1] = (columns[76] + columns[78]) + (columns[77] + columns[79])
    M[0, 2] = -((columns[80] + columns[82]) + (columns[81] + columns[83]))
    M[0, 3] = -((columns[84] + columns[86]) + (columns[85] + columns[87]))
    M[1, 1] = (columns[88] + columns[90]) + (columns[89] + columns[91])
    M[1, 2] = -((columns[92] + columns[94]) + (columns[93] + columns[95]))
    M[1, 3] = -((columns[96] + columns[98]) + (columns[97] + columns[99]))
    M[2, 2] = (columns[100] + columns[102]) + (columns[101] + columns[103])
    M[2, 3] = (columns[104] + columns[106]) + (columns[105] + columns[107])
    M[3, 3] = (columns[108] + columns[110]) + (columns[109] + columns[111])
    e[0] = (columns[112] + columns[114]) + (columns[113] + columns[115])
    e[1] = (columns[116] + columns[118]) + (columns[117] + columns[119])
    e[2] = -((columns[120] + columns[122]) + (columns[121] + columns[123]))
    e[3] = -((columns[124] + columns[126]) + (columns[125] + columns[127]))


@inlined
def projection_jacobian(S, x, y, rho, rig, right, J):  # type: ignore[no-untyped-def]
    """Fills J (2, 8) = d(u, v)/d(v, omega, delta, rho) of a point's projection into the target's left (right = 0) or right image.

    S (4, 4) T_target_host at the first estimates. The target moves as exp(xi) S: dP = rho v + omega x P, with P in the left camera
    whichever image is looked at. Returns whether the point is in front.
    """
    X = S[0, 0] * x + S[0, 1] * y + S[0, 2] + S[0, 3] * rho
    Y = S[1, 0] * x + S[1, 1] * y + S[1, 2] + S[1, 3] * rho
    Z = S[2, 0] * x + S[2, 1] * y + S[2, 2] + S[2, 3] * rho
    depth = Z + right * rig.tz * rho
    if not depth > MIN_DEPTH_RATIO:
        return False
    iz = 1.0 / depth
    xn, yn = (X + right * rig.tx * rho) * iz, (Y + right * rig.ty * rho) * iz
    fu, fv = rig.fx * iz, rig.fy * iz
    J[0, 0], J[0, 1], J[0, 2] = fu * rho, 0.0, -fu * rho * xn
    J[1, 0], J[1, 1], J[1, 2] = 0.0, fv * rho, -fv * rho * yn
    J[0, 3], J[0, 4], J[0, 5] = -fu * xn * Y, fu * (Z + xn * X), -fu * Y
    J[1, 3], J[1, 4], J[1, 5] = -fv * (Z + yn * Y), fv * yn * X, fv * X
    J[0, 6], J[1, 6] = -right, 0.0
    t2 = S[2, 3] + right * rig.tz
    J[0, 7] = fu * (S[0, 3] + right * rig.tx - xn * t2)
    J[1, 7] = fv * (S[1, 3] + right * rig.ty - yn * t2)
    return True


@inlined
def gain_between(affine_host, affine_target):  # type: ignore[no-untyped-def]
    """exp(a_target - a_host) of two rows (a, b)."""
    return math.exp(affine_target[0] - affine_host[0])
