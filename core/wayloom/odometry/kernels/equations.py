"""Normal equations of the window: every residual linearised, gathered a pair, mapped to the state, the points eliminated.

State: z = (delta, then for each keyframe its left perturbation (v, omega), a, b), 1 + 8F unknowns.
"""

import numpy as np

from wayloom.odometry.kernels.arrays import LOCAL, PATCH
from wayloom.odometry.kernels.compiler import inlined, kernel, part
from wayloom.odometry.kernels.linear import fill_relative, local_from_host
from wayloom.odometry.kernels.patch import gain_between, make_scratch, patch_residual, projection_jacobian

OFFSET_INFORMATION = 0.2
"""Of a patch's own brightness offset in a right image, beside a weight of one for each of its pixels."""


@inlined
def add_pair(J, M, e, scale, gain, H, g, coupling, own):  # type: ignore[no-untyped-def]
    """Chain patch_residual's M (4, 4), e (4,) with J (2, 8) of projection_jacobian and add, times scale, to the pair's H (9, 9,
    lower) and g (9,), the point's coupling (9,) and own (2,). gain: d(predicted)/d(a, b) is that times the colour and one."""
    ru, rv = J[0, 7], J[1, 7]
    for k in range(7):
        row = k if k < 6 else 8
        p0 = scale * (M[0, 0] * J[0, k] + M[0, 1] * J[1, k])
        p1 = scale * (M[0, 1] * J[0, k] + M[1, 1] * J[1, k])
        for m in range(k + 1):
            H[row, m if m < 6 else 8] += p0 * J[0, m] + p1 * J[1, m]
        g[row] -= scale * (e[0] * J[0, k] + e[1] * J[1, k])
        coupling[row] += p0 * ru + p1 * rv
        a = scale * (M[0, 2] * J[0, k] + M[1, 2] * J[1, k])
        b = scale * gain * (M[0, 3] * J[0, k] + M[1, 3] * J[1, k])
        if row == 8:
            H[8, 6] += a
            H[8, 7] += b
        else:
            H[6, row] += a
            H[7, row] += b
    H[6, 6] += scale * M[2, 2]
    H[7, 6] += scale * gain * M[2, 3]
    H[7, 7] += scale * gain * gain * M[3, 3]
    g[6] -= scale * e[2]
    g[7] -= scale * gain * e[3]
    coupling[6] += scale * (M[0, 2] * ru + M[1, 2] * rv)
    coupling[7] += scale * gain * (M[0, 3] * ru + M[1, 3] * rv)
    own[0] += scale * (M[0, 0] * ru * ru + 2.0 * M[0, 1] * ru * rv + M[1, 1] * rv * rv)
    own[1] -= scale * (e[0] * ru + e[1] * rv)


@inlined
def remove_host_offset(M, e, shift):  # type: ignore[no-untyped-def]
    """patch_residual takes d/da as -gain colour; it is -gain (colour - b_host). shift = gain b_host corrects the sums M and e."""
    M[2, 2] += shift * (shift * M[3, 3] - 2.0 * M[2, 3])
    M[0, 2] -= shift * M[0, 3]
    M[1, 2] -= shift * M[1, 3]
    M[2, 3] -= shift * M[3, 3]
    e[2] -= shift * e[3]


@inlined
def remove_patch_offset(M, e):  # type: ignore[no-untyped-def]
    """Eliminate a patch's own brightness offset from the sums M (4, 4, upper) and e (4,). Returns the energy that it explains.

    Between left and right the offset differs from place to place (vignettes, responses, surfaces that shine to one side); an edge
    takes what is left of it for a shift, rising edges to one side and falling ones to the other.
    """
    share = 1.0 / (M[3, 3] + OFFSET_INFORMATION)
    explained = share * e[3] * e[3]
    M[0, 0] -= share * M[0, 3] * M[0, 3]
    M[0, 1] -= share * M[0, 3] * M[1, 3]
    M[0, 2] -= share * M[0, 3] * M[2, 3]
    M[1, 1] -= share * M[1, 3] * M[1, 3]
    M[1, 2] -= share * M[1, 3] * M[2, 3]
    M[2, 2] -= share * M[2, 3] * M[2, 3]
    e[0] -= share * M[0, 3] * e[3]
    e[1] -= share * M[1, 3] * e[3]
    e[2] -= share * M[2, 3] * e[3]
    rest = share * OFFSET_INFORMATION
    M[0, 3] *= rest
    M[1, 3] *= rest
    M[2, 3] *= rest
    M[3, 3] *= rest
    e[3] *= rest
    return explained


def right_of(T, rig):  # type: ignore[no-untyped-def]
    """T_right_host (…, 4, 4) of T_left_host (…, 4, 4): the same rotation, the translation moved by t_right_left."""
    out = np.empty_like(T)
    fill_right_of(T.reshape(-1, 4, 4), rig.tx, rig.ty, rig.tz, out.reshape(-1, 4, 4))
    return out


@kernel
def fill_right_of(T, tx, ty, tz, out):  # type: ignore[no-untyped-def]
    """right_of of T (n, 4, 4) into out (n, 4, 4), by t_right_left."""
    for i in range(T.shape[0]):
        for k in range(4):
            for m in range(4):
                out[i, k, m] = T[i, k, m]
        out[i, 0, 3] += tx
        out[i, 1, 3] += ty
        out[i, 2, 3] += tz


@inlined
def add_static(  # type: ignore[no-untyped-def]
    image, still, T_right, ray, rho, rig, delta, colour, weight, gain, offset, robust, scratch, own, coupling, H, g
):
    """A patch in its host's right image (h, w): knows rho and delta only. still (4, 4) the identity, T_right (4, 4) T_right_left;
    ray (2,), colour and weight (8,) of the patch, gain and offset of right against left. Adds to own (2,), coupling (9,),
    H (9, 9), g (9,); returns the energy and whether it is an inlier."""
    x, y = ray[0], ray[1]
    energy, inside = patch_residual(image, T_right, x, y, rho, rig, delta, colour, weight, gain, offset, robust, scratch)
    limit = robust.max_energy * PATCH
    good = inside and energy <= limit and projection_jacobian(still, x, y, rho, rig, 1.0, scratch.J)
    if good:
        M, e, J = scratch.M, scratch.e, scratch.J
        energy -= remove_patch_offset(M, e)
        scale, ru, rv = robust.static_weight, J[0, 7], J[1, 7]
        own[0] += scale * (M[0, 0] * ru * ru + 2.0 * M[0, 1] * ru * rv + M[1, 1] * rv * rv)
        own[1] -= scale * (e[0] * ru + e[1] * rv)
        coupling[8] -= scale * (M[0, 0] * ru + M[0, 1] * rv)
        H[8, 8] += scale * M[0, 0]
        g[8] += scale * e[0]
    return robust.static_weight * min(energy, limit), good


@inlined
def add_temporal(  # type: ignore[no-untyped-def]
    image,
    T,
    S,
    ray,
    rho,
    rig,
    right,
    shift,
    colour,
    weight,
    gain,
    gain_image,
    b_host,
    offset,
    scale,
    robust,
    scratch,
    own,
    coupling,
    H,
    g,
):
    """A patch in a target's left (right = 0) or right image (1). T, S (4, 4) T_target_host now and at the first estimates; gain =
    exp(a_target - a_host), gain_image 1 or that of right against left; offset of the image; scale the term's weight.
    Adds to own (2,), coupling (9,), H (9, 9), g (9,); returns the energy and whether it is an inlier."""
    x, y = ray[0], ray[1]
    energy, inside = patch_residual(image, T, x, y, rho, rig, shift, colour, weight, gain * gain_image, offset, robust, scratch)
    limit = robust.max_energy * PATCH
    good = inside and energy <= limit and projection_jacobian(S, x, y, rho, rig, right, scratch.J)
    if good:
        remove_host_offset(scratch.M, scratch.e, gain * gain_image * b_host)
        if right > 0.0:
            energy -= remove_patch_offset(scratch.M, scratch.e)
        add_pair(scratch.J, scratch.M, scratch.e, scale, gain_image, H, g, coupling, own)
    return scale * min(energy, limit), good


def relative_poses(frames, first):  # type: ignore[no-untyped-def]
    """T_target_host (F, F, 4, 4) by [host, target]: current (first = 0), or at the first estimates of frames that have one (1)."""
    T = frames.T_cam_world
    if first:
        T = np.where(frames.has_first[:, None, None] == 1, frames.T_first, T)
    out = np.empty((len(T), len(T), 4, 4))
    fill_relative_poses(T, out)
    return out


@kernel
def fill_relative_poses(T_cam_world, out):  # type: ignore[no-untyped-def]
    """relative_poses of T_cam_world (F, 4, 4) into out (F, F, 4, 4)."""
    for h in range(T_cam_world.shape[0]):
        for t in range(T_cam_world.shape[0]):
            fill_relative(T_cam_world[t], T_cam_world[h], out[h, t])


def linearise(images, rig, frames, points, delta, robust, terms):  # type: ignore[no-untyped-def]
    """All residuals of the window at its current state into terms; returns the energy, a patch's at most max_energy a pixel.

    Image gradients are taken at the current state, the geometry at the first estimates (first-estimate Jacobians, Engel et al.
    2018, sec. 2.3), so that frames of the prior keep its null space.
    """
    scratch, still, T = make_scratch(), np.eye(4), relative_poses(frames, 0)
    rays = (points.uv - (rig.cx, rig.cy)) / (rig.fx, rig.fy)
    for array in terms:
        array.fill(0)
    total = add_hosts(images.right, rig, frames, points, delta, robust, rays, still, right_of(still, rig), scratch, terms)
    S, gains = relative_poses(frames, 1), np.empty(len(T))
    return total + add_observers(images, rig, frames, points, delta, robust, rays, T, S, right_of(T, rig), gains, scratch, terms)


@kernel
def add_hosts(right, rig, frames, points, delta, robust, rays, still, still_right, scratch, terms):  # type: ignore[no-untyped-def]
    """Every point in its host's right image; right (slots, h, w); still (4, 4) the identity, still_right (4, 4) T_right_left.
    Returns the energy."""
    F, total = frames.slot.shape[0], 0.0
    for i in range(points.host.shape[0]):
        h = points.host[i]
        if points.has_static[i]:
            energy, good = add_static(
                right[frames.slot[h]], still, still_right, rays[i], points.rho[i], rig, delta, points.colour[i],
                points.weight[i], frames.gain_right[h, 0], frames.gain_right[h, 1], robust, scratch, terms.own[i],
                terms.coupling[i, h], terms.H_pair[h, h], terms.g_pair[h, h],
            )  # fmt: skip
            terms.inlier[i, F] = good
            total += energy
    return total


@kernel
def add_observers(images, rig, frames, points, delta, robust, rays, T, S, T_right, gains, scratch, terms):  # type: ignore[no-untyped-def]
    """Every point in the left images of the other keyframes, and in the right image of those that it fits; returns the energy.
    T, S, T_right (F, F, 4, 4) T_target_host now, at the first estimates, and to the right camera; gains (F,) working space."""
    total = 0.0
    for t in range(frames.slot.shape[0]):  # one image at a time, points of one host together: that keeps the caches warm
        left, right, b = images.left[frames.slot[t]], images.right[frames.slot[t]], frames.affine[t, 1]
        gain_right, offset_right = frames.gain_right[t, 0], frames.gain_right[t, 1]
        for h in range(gains.shape[0]):
            gains[h] = gain_between(frames.affine[h], frames.affine[t])
        for i in range(points.host.shape[0]):
            h = points.host[i]
            if t == h or points.closed[i, t]:
                continue
            gain, b_host = gains[h], frames.affine[h, 1]
            offset = b - gain * b_host
            energy, good = add_temporal(
                left, T[h, t], S[h, t], rays[i], points.rho[i], rig, 0.0, 0.0, points.colour[i], points.weight[i], gain, 1.0,
                b_host, offset, 1.0, robust, scratch, terms.own[i], terms.coupling[i, t], terms.H_pair[h, t], terms.g_pair[h, t],
            )  # fmt: skip
            total += energy
            terms.inlier[i, t] = good
            if good and robust.observer_right_weight > 0.0:
                total += add_temporal(
                    right, T_right[h, t], S[h, t], rays[i], points.rho[i], rig, 1.0, delta, points.colour[i],
                    points.weight[i], gain, gain_right, b_host, gain_right * offset + offset_right, robust.observer_right_weight,
                    robust, scratch, terms.own[i], terms.coupling[i, t], terms.H_pair[h, t], terms.g_pair[h, t],
                )[0]  # fmt: skip
    return total


def host_maps(frames):  # type: ignore[no-untyped-def]
    """(F, F, 8, 8) local_from_host by [host, target], at the first estimates."""
    S = relative_poses(frames, 1)
    A = np.zeros((*S.shape[:2], 8, 8))
    fill_host_maps(S, frames.affine, A)
    return A


@kernel
def fill_host_maps(S, affine, A):  # type: ignore[no-untyped-def]
    """host_maps of S (F, F, 4, 4) T_target_host and affine (F, 2) into A (F, F, 8, 8), of zeros."""
    for h in range(A.shape[0]):
        for t in range(A.shape[0]):
            if t != h:
                local_from_host(S[h, t], gain_between(affine[h], affine[t]), A[h, t])


@kernel
def add_pairs_to_state(H_pair, g_pair, A, H, g, B, BA):  # type: ignore[no-untyped-def]
    """Map every pair's 9x9 block to the state: local = x_target + A x_host, delta as it is. Adds to H, g (1 + 8F), H lower only.
    B (9, 9) and BA (9, 8) are working space."""
    F = A.shape[0]
    for h in range(F):
        for t in range(F):
            for k in range(LOCAL):
                for m in range(k + 1):
                    B[k, m] = B[m, k] = H_pair[h, t, k, m]
            H[0, 0] += B[8, 8]
            g[0] += g_pair[h, t, 8]
            if t == h:
                continue
            for k in range(LOCAL):
                for m in range(8):
                    s = 0.0
                    for n in range(8):
                        s += B[k, n] * A[h, t, n, m]
                    BA[k, m] = s
            oh, ot = 1 + 8 * h, 1 + 8 * t
            for k in range(8):
                H[ot + k, 0] += B[8, k]
                H[oh + k, 0] += BA[8, k]
                g[ot + k] += g_pair[h, t, k]
                for m in range(8):
                    s = 0.0
                    for n in range(8):
                        s += A[h, t, n, k] * BA[n, m]
                    H[oh + k, oh + m] += s
                    H[ot + k, ot + m] += B[k, m]
                    if t > h:
                        H[ot + k, oh + m] += BA[k, m]
                    else:
                        H[oh + m, ot + k] += BA[k, m]
                    g[oh + k] += A[h, t, m, k] * g_pair[h, t, m]


@part
def coupling_of_state(coupling, inlier, h, A, row):  # type: ignore[no-untyped-def]
    """Fills row (1 + 8F): the coupling to the state of a point of host h, whose couplings (F, 9) to its pairs are given."""
    row[:] = 0.0
    host = row[1 + 8 * h : 9 + 8 * h]
    for t in range(A.shape[0]):
        c = coupling[t]
        row[0] += c[8]
        if t == h or not inlier[t]:
            continue
        for k in range(8):
            row[1 + 8 * t + k] = c[k]
        for n in range(8):
            of_host, factor = A[h, t, n], c[n]
            for k in range(8):
                host[k] += of_host[k] * factor


@part
def subtract(row, used, inverse, gradient, H, g):  # type: ignore[no-untyped-def]
    """Subtract v v^T inverse and v inverse gradient of a point's coupling v = row (1 + 8F) from H (lower) and g.

    used (F,): whether v has a part in a keyframe's eight columns.
    """
    H[0, 0] -= inverse * row[0] * row[0]
    g[0] -= inverse * gradient * row[0]
    for t in range(used.shape[0]):
        if not used[t]:
            continue
        for k in range(1 + 8 * t, 9 + 8 * t):
            c, target = inverse * row[k], H[k]
            g[k] -= c * gradient
            for m in range(k + 1):
                target[m] -= c * row[m]


@kernel
def eliminate_points(host, own, coupling, inlier, A, damping, H, g, inverse, row, used):  # type: ignore[no-untyped-def]
    """Schur complement: subtracts v v^T / h and v (own gradient) / h of every point from H (lower) and g; inverse (N,) = 1/h.
    host (N,), own, coupling and inlier of the points (arrays.Terms); row (1 + 8F) and used (F,) bool are working space."""
    F = A.shape[0]
    for i in range(host.shape[0]):
        information, h = own[i, 0], host[i]
        inverse[i] = 0.0
        if information < 1e-9:
            continue
        inverse[i] = 1.0 / (information * (1.0 + damping) + 1e-3)
        coupling_of_state(coupling[i], inlier[i], h, A, row)
        for t in range(F):
            used[t] = t == h or inlier[i, t]
        subtract(row, used, inverse[i], own[i, 1], H, g)


def steps_of_pairs(A, x):  # type: ignore[no-untyped-def]
    """(F, F, 9) by [host, target]: what a step x (1 + 8F) of the state is in the pairs' local unknowns."""
    out = np.zeros((*A.shape[:2], LOCAL))
    fill_steps_of_pairs(A, x, out)
    return out


@kernel
def fill_steps_of_pairs(A, x, out):  # type: ignore[no-untyped-def]
    """steps_of_pairs into out (F, F, 9), of zeros."""
    F = A.shape[0]
    for h in range(F):
        for t in range(F):
            out[h, t, 8] = x[0]
            if t == h:
                continue
            for n in range(8):
                s = x[1 + 8 * t + n]
                for k in range(8):
                    s += A[h, t, n, k] * x[1 + 8 * h + k]
                out[h, t, n] = s


@kernel
def mirror(H):  # type: ignore[no-untyped-def]
    """Copy the lower triangle of H to the upper."""
    for i in range(H.shape[0]):
        for j in range(i):
            H[j, i] = H[i, j]
