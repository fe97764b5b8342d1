"""Normal equations of the window: every residual linearised, gathered a pair, mapped to the state, the points eliminated.

State: z = (delta, then for each keyframe its left perturbation (v, omega), a, b), 1 + 8F unknowns.
"""

import numpy as np

from wayloom.odometry.kernels.arrays import LOCAL, PATCH
from wayloom.odometry.kernels.compiler import bare, inlined, jit
from wayloom.odometry.kernels.linear import local_from_host, relative
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


@jit
def right_of(T, rig):  # type: ignore[no-untyped-def]
    """T_right_host (4, 4) of T_left_host (4, 4): the same rotation, the translation moved by t_right_left."""
    out = T.copy()
    out[0, 3] += rig.tx
    out[1, 3] += rig.ty
    out[2, 3] += rig.tz
    return out


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


@jit
def relative_poses(frames, first):  # type: ignore[no-untyped-def]
    """T_target_host (F, F, 4, 4) by [host, target]: current (first = 0), or at the first estimates of frames that have one (1)."""
    F = frames.slot.shape[0]
    out = np.empty((F, F, 4, 4))
    for h in range(F):
        T_host = frames.T_first[h] if first and frames.has_first[h] == 1 else frames.T_cam_world[h]
        for t in range(F):
            T_target = frames.T_first[t] if first and frames.has_first[t] == 1 else frames.T_cam_world[t]
            out[h, t] = relative(T_target, T_host)
    return out


@jit
def linearise(images, rig, frames, points, delta, robust, terms):  # type: ignore[no-untyped-def]
    """All residuals of the window at its current state into terms; returns the energy, a patch's at most max_energy a pixel.

    Image gradients are taken at the current state, the geometry at the first estimates (first-estimate Jacobians, Engel et al.
    2018, sec. 2.3), so that frames of the prior keep its null space.
    """
    N = points.host.shape[0]
    scratch, rays, still = make_scratch(), np.empty((N, 2)), np.eye(4)
    T, S, T_right, still_right = (
        relative_poses(frames, 0),
        relative_poses(frames, 1),
        relative_poses(frames, 0),
        right_of(still, rig),
    )
    gains = np.empty(T.shape[:2])
    for h in range(T.shape[0]):
        for t in range(T.shape[0]):
            T_right[h, t] = right_of(T[h, t], rig)
            gains[h, t] = gain_between(frames.affine[h], frames.affine[t])
    for i in range(N):
        rays[i, 0], rays[i, 1] = (points.uv[i, 0] - rig.cx) / rig.fx, (points.uv[i, 1] - rig.cy) / rig.fy
    clear(terms)
    total = add_hosts(images, rig, frames, points, delta, robust, rays, still, still_right, scratch, terms)
    return total + add_observers(images, rig, frames, points, delta, robust, rays, T, S, T_right, gains, scratch, terms)


@bare
def add_hosts(images, rig, frames, points, delta, robust, rays, still, still_right, scratch, terms):  # type: ignore[no-untyped-def]
    """Every point in its host's right image; returns the energy."""
    F, total = frames.slot.shape[0], 0.0
    for i in range(points.host.shape[0]):
        h = points.host[i]
        if points.has_static[i]:
            energy, good = add_static(
                images.right[frames.slot[h]], still, still_right, rays[i], points.rho[i], rig, delta, points.colour[i],
                points.weight[i], frames.gain_right[h, 0], frames.gain_right[h, 1], robust, scratch, terms.own[i],
                terms.coupling[i, h], terms.H_pair[h, h], terms.g_pair[h, h],
            )  # fmt: skip
            terms.inlier[i, F] = good
            total += energy
    return total


@bare
def add_observers(images, rig, frames, points, delta, robust, rays, T, S, T_right, gains, scratch, terms):  # type: ignore[no-untyped-def]
    """Every point in the left images of the other keyframes, and in the right image of those that it fits; returns the energy."""
    total = 0.0
    for t in range(frames.slot.shape[0]):  # one image at a time, points of one host together: that keeps the caches warm
        left, right, b = images.left[frames.slot[t]], images.right[frames.slot[t]], frames.affine[t, 1]
        gain_right, offset_right = frames.gain_right[t, 0], frames.gain_right[t, 1]
        for i in range(points.host.shape[0]):
            h = points.host[i]
            if t == h or points.closed[i, t]:
                continue
            gain, b_host = gains[h, t], frames.affine[h, 1]
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


@bare
def clear(terms):  # type: ignore[no-untyped-def]
    """Set all of terms to zero."""
    terms.H_pair[:] = 0.0
    terms.g_pair[:] = 0.0
    terms.coupling[:] = 0.0
    terms.own[:] = 0.0
    terms.inlier[:] = 0


@jit
def host_maps(frames):  # type: ignore[no-untyped-def]
    """(F, F, 8, 8) local_from_host by [host, target], at the first estimates."""
    F = frames.slot.shape[0]
    S, A = relative_poses(frames, 1), np.zeros((F, F, 8, 8))
    for h in range(F):
        for t in range(F):
            if t != h:
                local_from_host(S[h, t], gain_between(frames.affine[h], frames.affine[t]), A[h, t])
    return A


@jit
def add_pairs_to_state(terms, A, H, g):  # type: ignore[no-untyped-def]
    """Map every pair's 9x9 block to the state: local = x_target + A x_host, delta as it is. Adds to H, g (1 + 8F), H lower only."""
    F = A.shape[0]
    B, BA = np.empty((LOCAL, LOCAL)), np.empty((LOCAL, 8))
    for h in range(F):
        for t in range(F):
            for k in range(LOCAL):
                for m in range(k + 1):
                    B[k, m] = B[m, k] = terms.H_pair[h, t, k, m]
            H[0, 0] += B[8, 8]
            g[0] += terms.g_pair[h, t, 8]
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
                g[ot + k] += terms.g_pair[h, t, k]
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
                    g[oh + k] += A[h, t, m, k] * terms.g_pair[h, t, m]


@bare
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


@bare
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


@jit
def eliminate_points(terms, A, points, damping, H, g, inverse):  # type: ignore[no-untyped-def]
    """Schur complement: subtracts v v^T / h and v (own gradient) / h of every point from H (lower) and g; inverse (N,) = 1/h."""
    F = A.shape[0]
    row, used = np.empty(1 + 8 * F), np.empty(F, np.bool_)
    for i in range(points.host.shape[0]):
        information, h = terms.own[i, 0], points.host[i]
        inverse[i] = 0.0
        if information < 1e-9:
            continue
        inverse[i] = 1.0 / (information * (1.0 + damping) + 1e-3)
        coupling_of_state(terms.coupling[i], terms.inlier[i], h, A, row)
        for t in range(F):
            used[t] = t == h or terms.inlier[i, t]
        subtract(row, used, inverse[i], terms.own[i, 1], H, g)


@jit
def steps_of_pairs(A, x):  # type: ignore[no-untyped-def]
    """(F, F, 9) by [host, target]: what a step x (1 + 8F) of the state is in the pairs' local unknowns."""
    F = A.shape[0]
    out = np.zeros((F, F, LOCAL))
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
    return out


@bare
def mirror(H):  # type: ignore[no-untyped-def]
    """Copy the lower triangle of H to the upper."""
    for i in range(H.shape[0]):
        for j in range(i):
            H[j, i] = H[i, j]
