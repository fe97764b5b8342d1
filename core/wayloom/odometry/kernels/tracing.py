"""Epipolar search and depth update of points whose poses are known, by one more image.

A host's ray (x, y, 1) with inverse depth rho lies at p(rho) = pi(R (x, y, 1) + rho t) in a target. While rho runs through the
interval that a point is known to lie in, p runs along a straight line, the epipolar line.
"""

import math

import numpy as np

from wayloom.odometry.kernels.arrays import LEAST_ALIKE, LEFT_ALIKE, PATCH, PATTERN, RIGHT, RIGHT_ALIKE, Robust
from wayloom.odometry.kernels.compiler import inlined, kernel, part
from wayloom.odometry.kernels.equations import relative_poses, remove_patch_offset, right_of
from wayloom.odometry.kernels.patch import gain_between, looks_alike, make_scratch, patch_residual, projection_jacobian

f32 = np.float32
index = np.uint64
ONE = index(1)
MIN_DEPTH_RATIO = 0.1
"""Nearest depth in the target over the depth in the host: a patch that grows ten times is not the same patch."""
BORDER = 3
MARGIN_PX = 1.0
"""Searched on both sides of the interval."""
AWAY_PX = 2.0
"""From here on another minimum is another match."""
NOISE_PX = 0.2
"""Error of a match along and across the line, each (Engel, Sturm, Cremers, Semi-Dense Visual Odometry, ICCV 2013, eq. 5 and 8)."""
FAR = 4.0
"""Times an outlier's energy, below which a patch may still be drawn to where it fits."""
STEPS = 3
"""At most, of one image's Gauss-Newton; the next keyframe goes on from there."""
UNSEEN, VAGUE, AMBIGUOUS, MISFIT, TRACED = 0, 1, 2, 3, 4
"""What a search ends in: out of view; no new knowledge to be had; several matches; none that fits; the interval is new."""


@inlined
def patch_distance(image, u, v, uu, uv, vu, vv, colours, gain, offset, limit):  # type: ignore[no-untyped-def]
    """Sum of squares of I(p + A d) - (gain colour + offset) over the pattern, A = ((uu, uv), (vu, vv)); stops above limit."""
    total = f32(0)
    for k in range(PATCH):
        dx, dy = f32(PATTERN[k, 0]), f32(PATTERN[k, 1])
        p, q = u + uu * dx + uv * dy, v + vu * dx + vv * dy
        ip, iq = np.int32(p), np.int32(q)
        a, b = p - f32(ip), q - f32(iq)
        x, y = index(ip), index(iq)
        top = f32(image[y, x]) + a * (f32(image[y, x + ONE]) - f32(image[y, x]))
        low = f32(image[y + ONE, x]) + a * (f32(image[y + ONE, x + ONE]) - f32(image[y + ONE, x]))
        r = top + b * (low - top) - (gain * colours[k] + offset)
        total += r * r
        if total > limit:
            break
    return total


@inlined
def project(T, x, y, rho, rig):  # type: ignore[no-untyped-def]
    """u, v px and Z over the host's depth of a ray at inverse depth rho."""
    Z = T[2, 0] * x + T[2, 1] * y + T[2, 2] + T[2, 3] * rho
    u = rig.fx * (T[0, 0] * x + T[0, 1] * y + T[0, 2] + T[0, 3] * rho) / Z + rig.cx
    v = rig.fy * (T[1, 0] * x + T[1, 1] * y + T[1, 2] + T[1, 3] * rho) / Z + rig.cy
    return u, v, Z


@inlined
def depth_at(T, x, y, u, v, along_u, rig):  # type: ignore[no-untyped-def]
    """Inverse depth at which the ray is seen in column u (along_u) or row v."""
    Z = T[2, 0] * x + T[2, 1] * y + T[2, 2]
    if along_u:
        xn = (u - rig.cx) / rig.fx
        return (T[0, 0] * x + T[0, 1] * y + T[0, 2] - xn * Z) / (xn * T[2, 3] - T[0, 3])
    yn = (v - rig.cy) / rig.fy
    return (T[1, 0] * x + T[1, 1] * y + T[1, 2] - yn * Z) / (yn * T[2, 3] - T[1, 3])


@inlined
def search_line(image, T, x, y, u0, v0, u1, v1, rig, colours, gain, offset, uniqueness, distances):  # type: ignore[no-untyped-def]
    """Least patch distance along the line from (u0, v0) to (u1, v1), in steps of about a pixel, at most as many as distances holds.

    Returns the place of the minimum from 0 to 1 (-1: the line is out of view), its distance and the least one over AWAY_PX off;
    the latter is exact up to uniqueness times the former.
    """
    h, w = image.shape
    length = math.sqrt((u1 - u0) ** 2 + (v1 - v0) ** 2)
    steps = min(int(length) + 2, distances.shape[0])
    along_u, aspect, ifx, ify = abs(u1 - u0) > abs(v1 - v0), rig.fx / rig.fy, 1.0 / rig.fx, 1.0 / rig.fy
    a, t, Z = T[1, 0] * x + T[1, 1] * y + T[1, 2], T[1, 3], T[2, 0] * x + T[2, 1] * y + T[2, 2]
    if along_u:
        a, t = T[0, 0] * x + T[0, 1] * y + T[0, 2], T[0, 3]
    slope = T[2, 3] / (T[2, 3] * a - Z * t)  # of 1 / (Z + T_z rho), with depth_at's rho
    start = -t / (T[2, 3] * a - Z * t)
    best, at = f32(1e12), -1
    for k in range(steps):
        distances[k] = f32(1e12)
        s = k / (steps - 1)
        u, v = u0 + s * (u1 - u0), v0 + s * (v1 - v0)
        xn, yn = (u - rig.cx) * ifx, (v - rig.cy) * ify
        iz = start + slope * (xn if along_u else yn)
        uu, uv = (T[0, 0] - xn * T[2, 0]) * iz, (T[0, 1] - xn * T[2, 1]) * iz * aspect
        vu, vv = (T[1, 0] - yn * T[2, 0]) * iz / aspect, (T[1, 1] - yn * T[2, 1]) * iz
        du, dv = BORDER + 2.0 * max(abs(uu), abs(uv)), BORDER + 2.0 * max(abs(vu), abs(vv))
        if not (u > du and v > dv and u < w - 1 - du and v < h - 1 - dv):
            continue
        d = patch_distance(
            image, f32(u), f32(v), f32(uu), f32(uv), f32(vu), f32(vv), colours, gain, offset, f32(uniqueness) * best
        )  # fmt: skip
        distances[k] = d
        if d < best:
            best, at = d, k
    if at < 0:
        return -1.0, best, best
    second, away = f32(1e12), AWAY_PX * (steps - 1) / length
    for k in range(steps):
        if abs(k - at) > away:
            second = min(second, distances[k])
    return at / (steps - 1), best, second


@inlined
def line_information(image, u, v, du, dv):  # type: ignore[no-untyped-def]
    """Share of the squared gradient of the patch at pixel (u, v) that lies along the direction (du, dv), of length 1."""
    along, total = 0.0, 1e-9
    for k in range(PATCH):
        x, y = u + PATTERN[k, 0], v + PATTERN[k, 1]
        gx = np.int32(image[y, x + 1]) - np.int32(image[y, x - 1])
        gy = np.int32(image[y + 1, x]) - np.int32(image[y - 1, x])
        along += (gx * du + gy * dv) ** 2
        total += float(gx * gx + gy * gy)
    return along / total


@part
def settle(image, T, x, y, rho, low, high, rig, colours, weights, gain, offset, robust, scratch):  # type: ignore[no-untyped-def]
    """Gauss-Newton on one patch's inverse depth within [low, high]. Returns it and its energy, -1 where it leaves the image."""
    energy = -1.0
    for _ in range(4):
        energy, inside = patch_residual(image, T, x, y, rho, rig, 0.0, colours, weights, gain, offset, robust, scratch)
        if not (inside and projection_jacobian(T, x, y, rho, rig, 0.0, scratch.J)):
            return rho, -1.0
        if energy > robust.max_energy * PATCH:
            break
        ru, rv = scratch.J[0, 7], scratch.J[1, 7]
        M, e = scratch.M, scratch.e
        information = M[0, 0] * ru * ru + 2.0 * M[0, 1] * ru * rv + M[1, 1] * rv * rv
        if not information > 1e-6:
            break
        step = -(e[0] * ru + e[1] * rv) / information
        rho = min(max(rho + step, low), high)
        if abs(step) * math.sqrt(ru * ru + rv * rv) < 0.02:
            break
    return rho, energy


def trace_points(images, rig, frames, points, rows, target, low, high, uniqueness, max_length, robust, state):  # type: ignore[no-untyped-def]
    """Search points `rows` (n,) of N in the left image of frame `target` along their epipolar lines; in view, unique and fitting
    ones get a new inverse depth points.rho and interval low, high (N,) 1/m.

    Intervals start as (0, nearest). uniqueness: least ratio of the second best squared distance to the best; max_length px of a
    line, longer ones are searched from their far end. Fills state (n,) with UNSEEN to TRACED.
    """
    trace_rows(
        images, relative_poses(frames, 0), rig, frames, points, rows, target, low, high, uniqueness, max_length, robust,
        make_scratch(), np.empty(int(max_length) + 8, np.float32), state,
    )  # fmt: skip


@kernel
def trace_rows(  # type: ignore[no-untyped-def]
    images, T_all, rig, frames, points, rows, target, low, high, uniqueness, max_length, robust, scratch, distances, state
):
    """trace_points with T_all (F, F, 4, 4) T_target_host by [host, target] and working space."""
    image = images.left[frames.slot[target]]
    for row in range(rows.shape[0]):
        i = rows[row]
        h = points.host[i]
        state[row] = UNSEEN
        if h == target:
            continue
        T, x, y = T_all[h, target], (points.uv[i, 0] - rig.cx) / rig.fx, (points.uv[i, 1] - rig.cy) / rig.fy
        Z0 = T[2, 0] * x + T[2, 1] * y + T[2, 2]
        near, far = high[i], low[i]
        if T[2, 3] < 0.0:
            near = min(near, (MIN_DEPTH_RATIO - Z0) / T[2, 3])
        if not (Z0 > MIN_DEPTH_RATIO and near > far):
            continue
        u0, v0, _ = project(T, x, y, far, rig)
        u1, v1, _ = project(T, x, y, near, rig)
        length = math.sqrt((u1 - u0) ** 2 + (v1 - v0) ** 2)
        if not length > 0.05:
            state[row] = VAGUE
            continue
        du, dv = (u1 - u0) / length, (v1 - v0) / length
        if length > max_length:
            u1, v1, length = u0 + du * max_length, v0 + dv * max_length, max_length
        share = line_information(images.left[frames.slot[h]], int(points.uv[i, 0]), int(points.uv[i, 1]), du, dv)
        error = NOISE_PX + NOISE_PX / max(share, 1e-6)
        if 2.0 * error > length:
            state[row] = VAGUE
            continue
        gain = gain_between(frames.affine[h], frames.affine[target])
        offset = frames.affine[target, 1] - gain * frames.affine[h, 1]
        u0, v0, u1, v1 = u0 - du * MARGIN_PX, v0 - dv * MARGIN_PX, u1 + du * MARGIN_PX, v1 + dv * MARGIN_PX
        s, best, second = search_line(
            image, T, x, y, u0, v0, u1, v1, rig, points.colour[i], f32(gain), f32(offset), uniqueness, distances
        )  # fmt: skip
        if s < 0.0:
            continue
        if best > 2.0 * robust.max_energy * PATCH:  # before it is settled; weights are below one
            state[row] = MISFIT
            continue
        if second < uniqueness * best:
            state[row] = AMBIGUOUS
            continue
        along_u = abs(du) > abs(dv)
        u, v = u0 + s * (u1 - u0), v0 + s * (v1 - v0)
        start, reach_u, reach_v = depth_at(T, x, y, u, v, along_u, rig), 1.5 * du, 1.5 * dv
        a, b = depth_at(T, x, y, u - reach_u, v - reach_v, along_u, rig), depth_at(T, x, y, u + reach_u, v + reach_v, along_u, rig)
        rho, energy = settle(
            image, T, x, y, start, min(a, b), max(a, b), rig, points.colour[i], points.weight[i], gain, offset, robust, scratch
        )
        if energy < 0.0 or energy > robust.max_energy * PATCH:
            state[row] = MISFIT
            continue
        u, v, _ = project(T, x, y, rho, rig)
        a = depth_at(T, x, y, u - error * du, v - error * dv, along_u, rig)
        b = depth_at(T, x, y, u + error * du, v + error * dv, along_u, rig)
        points.rho[i], low[i], high[i] = max(rho, 1e-4), max(min(a, b), 0.0), max(a, b)
        state[row] = TRACED


def update_depths(images, rig, frames, points, rows, target, delta, robust, information, state, agrees):  # type: ignore[no-untyped-def]
    """Take what frame `target` tells of the points `rows` (n,) of known depth into points.rho and information (N,), with poses and
    brightness fixed.

    Gauss-Newton on information (rho - rho_before)^2 + the patch's energy in the target's left image (in its right one where the
    target is the host), then one step on the target's right image. Fills state (n,) with UNSEEN, MISFIT or TRACED and agrees (n,)
    with the sum of RIGHT where the right image fits too, LEFT_ALIKE and RIGHT_ALIKE; points that do not fit stay as they are.
    """
    T = np.ascontiguousarray(relative_poses(frames, 0)[:, target])
    take_depths(
        images.left[frames.slot[target]], images.right[frames.slot[target]], T, right_of(T, rig), np.eye(4), rig, frames, points,
        rows, target, delta, robust, information, make_scratch(), np.zeros(2), state, agrees,
    )  # fmt: skip


@kernel
def take_depths(  # type: ignore[no-untyped-def]
    left, right, T, T_right, still, rig, frames, points, rows, target, delta, robust, information, scratch, sums, state, agrees
):
    """update_depths with the target's images (h, w) and T (F, 4, 4) T_target_host by host, T_right that of the right camera, still
    the identity, and working space."""
    gain_right, offset_right, limit = frames.gain_right[target, 0], frames.gain_right[target, 1], robust.max_energy * PATCH
    many, once = np.int64(STEPS), np.int64(1)  # not constants: `approach` would be compiled for each of them
    loose = Robust(robust.huber, FAR * robust.max_energy, robust.static_weight, robust.observer_right_weight)
    for row in range(rows.shape[0]):
        i = rows[row]
        h, rho, base, colour, weight = points.host[i], points.rho[i], information[i], points.colour[i], points.weight[i]
        x, y = (points.uv[i, 0] - rig.cx) / rig.fx, (points.uv[i, 1] - rig.cy) / rig.fy
        state[row] = agrees[row] = 0
        if h == target:
            rho, base, inside, good = approach(
                right, T_right[h], still, 1.0, delta, x, y, rho, base, rig, colour, weight, gain_right, offset_right,
                robust.static_weight, limit, many, loose, scratch, sums,
            )  # fmt: skip
        else:
            gain = gain_between(frames.affine[h], frames.affine[target])
            offset = frames.affine[target, 1] - gain * frames.affine[h, 1]
            rho, base, inside, good = approach(
                left, T[h], T[h], 0.0, 0.0, x, y, rho, base, rig, colour, weight, gain, offset, 1.0, limit, many, loose, scratch,
                sums,
            )  # fmt: skip
            if good:
                alike = LEFT_ALIKE * looks_alike(scratch.columns, LEAST_ALIKE)
                rho, base, _, fits = approach(
                    right, T_right[h], T[h], 1.0, delta, x, y, rho, base, rig, colour, weight, gain * gain_right,
                    gain_right * offset + offset_right, robust.observer_right_weight, limit, once, loose, scratch, sums,
                )  # fmt: skip
                if fits:
                    alike += RIGHT + RIGHT_ALIKE * looks_alike(scratch.columns, LEAST_ALIKE)
                agrees[row] = alike
        if inside:
            state[row] = TRACED if good else MISFIT
        if good:
            points.rho[i], information[i] = rho, base


@part
def approach(  # type: ignore[no-untyped-def]
    image, T, S, right, shift, x, y, rho, base, rig, colour, weight, gain, offset, scale, limit, steps, robust, scratch, sums
):
    """Gauss-Newton on base (rho - rho_0)^2 + scale times a patch's energy. T (4, 4) into the image's own camera, S into the left
    one. Returns rho, the information of both together, whether the patch is in view and whether it fits."""
    start, total, inside, good = rho, base, False, False
    for _ in range(steps):
        energy, inside = patch_residual(image, T, x, y, rho, rig, shift, colour, weight, gain, offset, robust, scratch)
        good = inside and energy <= limit
        if not (inside and energy <= FAR * limit and projection_jacobian(S, x, y, rho, rig, right, scratch.J)):
            break
        if right > 0.0:
            remove_patch_offset(scratch.M, scratch.e)
        sums[:] = 0.0
        add_own(scratch, scale, sums)
        total = base + sums[0]
        if total < 1e-6:
            break
        step = (sums[1] - base * (rho - start)) / total
        reach = 0.3 * rho + 0.01
        step = max(-reach, min(reach, step))
        rho = max(rho + step, 1e-4)
        if abs(step) * (abs(scratch.J[0, 7]) + abs(scratch.J[1, 7])) < 0.05:
            break
    if not good:
        return start, base, inside, False
    return rho, total, inside, True


@inlined
def add_own(scratch, scale, sums):  # type: ignore[no-untyped-def]
    """Adds a linearised patch's J_rho^T W J_rho and -J_rho^T W r, times scale, to sums (2,)."""
    M, e, ru, rv = scratch.M, scratch.e, scratch.J[0, 7], scratch.J[1, 7]
    sums[0] += scale * (M[0, 0] * ru * ru + 2.0 * M[0, 1] * ru * rv + M[1, 1] * rv * rv)
    sums[1] -= scale * (e[0] * ru + e[1] * rv)
