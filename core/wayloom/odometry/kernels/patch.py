"""One patch of a host in one image of a target: its residuals, their sums, and how they depend on pose, inverse depth and bias.

With the host's ray (x, y, 1) and inverse depth rho the point, times rho, is P = R (x, y, 1) + t rho in the target's left camera and
P + t_right_left rho in its right one. So a right image is a target with another translation, whose columns are shifted by the
disparity bias delta: u_right = fx X/Z + cx - delta. The host's own right image is the case R = I, t = 0.
"""

import math

import numpy as np

from wayloom.odometry.kernels.arrays import PATCH, PATTERN
from wayloom.odometry.kernels.compiler import inlined

f32 = np.float32
index = np.uint64
"""Pixels are addressed by unsigned numbers: a signed index is tested for being negative each time."""
ONE = index(1)
MIN_DEPTH_RATIO = 1e-3
BORDER = 2


@inlined
def patch_residual(image, T, x, y, rho, rig, shift, colours, weights, gain, offset, robust, M, e):  # type: ignore[no-untyped-def]
    """Photometric residual r = I(project(T p) - (shift, 0)) - (gain colour + offset) over the 8 pixels of a patch.

    image (h, w) uint8; T (4, 4) T_target_host, with the right camera's translation for a right image; x, y ray; shift px.
    Fills M (4, 4, upper) = sum W d d^T and e (4,) = sum W d r for d = (dI/du, dI/dv, -gain colour, -1), W = gradient weight times
    Huber weight (Engel et al. 2018, eq. 4). Returns the energy and whether the patch is inside the image and in front. The energy
    of an outlier (above max_energy a pixel) is returned as it was when it passed the limit; then M and e are not filled.
    """
    h, w = image.shape
    X = T[0, 0] * x + T[0, 1] * y + T[0, 2] + T[0, 3] * rho
    Y = T[1, 0] * x + T[1, 1] * y + T[1, 2] + T[1, 3] * rho
    Z = T[2, 0] * x + T[2, 1] * y + T[2, 2] + T[2, 3] * rho
    if not Z > MIN_DEPTH_RATIO:
        return 0.0, False
    Xu, Xv, Yu, Yv = T[0, 0] / rig.fx, T[0, 1] / rig.fy, T[1, 0] / rig.fx, T[1, 1] / rig.fy
    Zu, Zv = T[2, 0] / rig.fx, T[2, 1] / rig.fy
    limit, energy = robust.max_energy * PATCH, 0.0
    m00, m01, m02, m03, m11, m12, m13, m22, m23, m33 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    e0, e1, e2, e3 = 0.0, 0.0, 0.0, 0.0
    for k in range(PATCH):
        dx, dy = PATTERN[k, 0], PATTERN[k, 1]
        iz = 1.0 / (Z + Zu * dx + Zv * dy)
        u = rig.fx * (X + Xu * dx + Xv * dy) * iz + rig.cx - shift
        v = rig.fy * (Y + Yu * dx + Yv * dy) * iz + rig.cy
        if not (iz > 0.0 and u > BORDER and v > BORDER and u < w - BORDER - 1 and v < h - BORDER - 1):
            return 0.0, False
        x0, y0 = index(u), index(v)
        a, b = f32(u - int(u)), f32(v - int(v))
        x1, y1, xm, ym = x0 + ONE, y0 + ONE, x0 - ONE, y0 - ONE
        x2, y2 = x1 + ONE, y1 + ONE
        w11 = a * b
        w01, w10, w00 = b - w11, a - w11, f32(1) - a - b + w11
        i00, i10 = f32(image[y0, x0]), f32(image[y0, x1])
        i01, i11 = f32(image[y1, x0]), f32(image[y1, x1])
        gx = f32(0.5) * (
            w00 * (i10 - f32(image[y0, xm]))
            + w10 * (f32(image[y0, x2]) - i00)
            + w01 * (i11 - f32(image[y1, xm]))
            + w11 * (f32(image[y1, x2]) - i01)
        )
        gy = f32(0.5) * (
            w00 * (i01 - f32(image[ym, x0]))
            + w10 * (i11 - f32(image[ym, x1]))
            + w01 * (f32(image[y2, x0]) - i00)
            + w11 * (f32(image[y2, x1]) - i10)
        )
        predicted = gain * colours[k]
        r = w00 * i00 + w10 * i10 + w01 * i01 + w11 * i11 - (predicted + offset)
        size = abs(r)
        huber = 1.0 if size < robust.huber else robust.huber / size
        weight = weights[k] * huber
        energy += weight * r * r * (2.0 - huber)
        if energy > limit:
            return energy, True
        wx, wy, wp = weight * gx, weight * gy, weight * predicted
        m00, m01, m02, m03 = m00 + wx * gx, m01 + wx * gy, m02 - wx * predicted, m03 - wx
        m11, m12, m13 = m11 + wy * gy, m12 - wy * predicted, m13 - wy
        m22, m23, m33 = m22 + wp * predicted, m23 + wp, m33 + weight
        e0, e1, e2, e3 = e0 + wx * r, e1 + wy * r, e2 - wp * r, e3 - weight * r
    M[0, 0], M[0, 1], M[0, 2], M[0, 3], M[1, 1], M[1, 2], M[1, 3] = m00, m01, m02, m03, m11, m12, m13
    M[2, 2], M[2, 3], M[3, 3], e[0], e[1], e[2], e[3] = m22, m23, m33, e0, e1, e2, e3
    return energy, True


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
