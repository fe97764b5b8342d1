"""Levenberg-Marquardt over a window: poses, brightness, inverse depths, disparity bias, and the prior.

The loop is Python: as one kernel it would hold the code of all others once more, and take as long to compile as they do together.
"""

import math

import numpy as np

from wayloom.odometry.kernels.arrays import LEAST_ALIKE, LEFT_ALIKE, LOCAL, PATCH, RIGHT, RIGHT_ALIKE, Terms
from wayloom.odometry.kernels.compiler import kernel
from wayloom.odometry.kernels.equations import (
    add_pairs_to_state,
    eliminate_points,
    host_maps,
    linearise,
    mirror,
    relative_poses,
    right_of,
    steps_of_pairs,
)
from wayloom.odometry.kernels.inertial import add_links, links_energy
from wayloom.odometry.kernels.linear import fill_exp_se3, fill_log_se3, fill_product, fill_relative, orthonormalise, solve_spd
from wayloom.odometry.kernels.patch import gain_between, looks_alike, make_scratch, patch_residual

GAUGE = 1e12
FIRST_DAMPING = 1e-2
SMALL_WAY_M, SMALL_TURN, SMALL_GAIN = 2e-4, 2e-5, 1e-4
"""A minimisation ends with a step that moves no keyframe by more (m, rad) or lowers the energy by a smaller share of it."""
UNLINKED = 1e-4
"""Information that holds each step of a velocity, bias or gravity that nothing speaks of, in their own units."""


def make_terms(N, F):  # type: ignore[no-untyped-def]
    """Empty Terms for N points and F frames."""
    return Terms(
        np.zeros((F, F, LOCAL, LOCAL)), np.zeros((F, F, LOCAL)), np.zeros((N, F, LOCAL)), np.zeros((N, 2)),
        np.zeros((N, F + 1), np.int64),
    )  # fmt: skip


def deviation(frames, delta, inertial, z):  # type: ignore[no-untyped-def]
    """Fills z (1 + 8F): delta, then each keyframe's left perturbation and a, b since its first estimate; 0 where it has none.
    With an IMU (1 + 17F + 2): then each keyframe's velocity and biases since their first estimate, and gamma."""
    z[:] = 0.0
    z[0] = delta
    deviation_of_poses(*frames[1:6], np.empty((4, 4)), z)
    F = len(inertial.velocity)
    if F:
        own, known = z[1 + 8 * F : 1 + 17 * F].reshape(F, 9), frames.has_first > 0
        own[known, :3] = (inertial.velocity - inertial.velocity_first)[known]
        own[known, 3:] = (inertial.bias - inertial.bias_first)[known]
        z[1 + 17 * F :] = inertial.gamma


@kernel
def deviation_of_poses(T_cam_world, T_first, has_first, affine, affine_first, since_first, z):  # type: ignore[no-untyped-def]
    """Keyframes' left perturbations and a, b since their first estimates (arrays.Frames) into z from 1 on; since_first (4, 4) is
    working space."""
    for f in range(has_first.shape[0]):
        if has_first[f]:
            fill_relative(T_cam_world[f], T_first[f], since_first)
            fill_log_se3(since_first, z[1 + 8 * f :])
            z[7 + 8 * f] = affine[f, 0] - affine_first[f, 0]
            z[8 + 8 * f] = affine[f, 1] - affine_first[f, 1]


@kernel
def prior_energy(z, prior_H, prior_g, affine, affine_prior):  # type: ignore[no-untyped-def]
    """z^T H z - 2 g^T z of the marginalisation prior, plus the weak pull of a and b (F, 2) towards zero."""
    total = 0.0
    for i in range(z.shape[0]):
        s = 0.0
        for j in range(z.shape[0]):
            s += prior_H[i, j] * z[j]
        total += z[i] * (s - 2.0 * prior_g[i])
    for f in range(affine.shape[0]):
        total += affine_prior[0] * affine[f, 0] ** 2 + affine_prior[1] * affine[f, 1] ** 2
    return total


@kernel
def add_prior(z, prior_H, prior_g, affine, affine_prior, H, g):  # type: ignore[no-untyped-def]
    """Add the prior's and the affine prior's normal equations at the deviation z to H and g."""
    for i in range(z.shape[0]):
        g[i] += prior_g[i]
        for j in range(z.shape[0]):
            H[i, j] += prior_H[i, j]
            g[i] -= prior_H[i, j] * z[j]
    for f in range(affine.shape[0]):
        for k in range(2):
            H[7 + 8 * f + k, 7 + 8 * f + k] += affine_prior[k]
            g[7 + 8 * f + k] -= affine_prior[k] * affine[f, k]


def normal_equations(terms, A, points, damping, H, g, inverse):  # type: ignore[no-untyped-def]
    """H (1 + 8F, 1 + 8F) and g of delta and keyframes, all points eliminated; A is host_maps; inverse (N,) serves the step back to
    the points."""
    H[:] = 0.0
    g[:] = 0.0
    add_pairs_to_state(terms.H_pair, terms.g_pair, A, H, g, np.empty((LOCAL, LOCAL)), np.empty((LOCAL, 8)))
    eliminate_points(
        points.host, terms.own, terms.coupling, terms.inlier, A, damping, H, g, inverse, np.empty(len(g)),
        np.empty(len(A), np.bool_),
    )  # fmt: skip
    mirror(H)


def take_step(frames, points, inertial, terms, A, inverse, x, min_rho):  # type: ignore[no-untyped-def]
    """Apply the state's step x (1 + 8F, or 1 + 17F + 2) but delta, and the inverse depths' own that follows from it, limited."""
    F = len(inertial.velocity)
    if F:
        own = x[1 + 8 * F : 1 + 17 * F].reshape(F, 9)
        inertial.velocity[:] += own[:, :3]
        inertial.bias[:] += own[:, 3:]
        inertial.gamma[:] += x[1 + 17 * F :]
    local = steps_of_pairs(A, x)
    step_points(points.host, points.rho, terms.own, terms.coupling, terms.inlier, local, inverse, min_rho)
    step_frames(frames.T_cam_world, frames.affine, x, np.empty((4, 4)), np.empty((4, 4)))


@kernel
def step_points(host, rho, own, coupling, inlier, local, inverse, min_rho):  # type: ignore[no-untyped-def]
    """The points' part of take_step: host, rho (N,), own, coupling, inlier (arrays.Terms), local (F, F, 9) of steps_of_pairs."""
    for i in range(host.shape[0]):
        h, s = host[i], own[i, 1]
        for t in range(local.shape[0]):
            if t == h or inlier[i, t]:
                for k in range(LOCAL):
                    s -= coupling[i, t, k] * local[h, t, k]
        limit = 0.3 * rho[i] + 0.01
        rho[i] = max(rho[i] + max(-limit, min(limit, inverse[i] * s)), min_rho)


@kernel
def step_frames(T_cam_world, affine, x, step, moved):  # type: ignore[no-untyped-def]
    """The keyframes' part of take_step: T_cam_world (F, 4, 4), affine (F, 2); step and moved (4, 4) are working space."""
    for f in range(affine.shape[0]):
        fill_exp_se3(x[1 + 8 * f :], step)
        fill_product(step, T_cam_world[f], moved)
        for i in range(4):
            for j in range(4):
                T_cam_world[f, i, j] = moved[i, j]
        orthonormalise(T_cam_world[f])
        affine[f, 0] += x[7 + 8 * f]
        affine[f, 1] += x[8 + 8 * f]


@kernel
def largest_step(x, F):  # type: ignore[no-untyped-def]
    """Largest translation (m) and rotation (rad) component of the F keyframes in a step x."""
    way, turn = 0.0, 0.0
    for f in range(F):
        for k in range(3):
            way = max(way, abs(x[1 + 8 * f + k]))
            turn = max(turn, abs(x[4 + 8 * f + k]))
    return way, turn


def first_alone(H, g, unit, x, out):  # type: ignore[no-untyped-def]
    """Fills out (2,) with the first unknown's step in the solution of H x = g and its variance, the others eliminated; NaN where H
    is not positive definite. unit, x (n,) scratch."""
    unit[:] = 0.0
    unit[0] = 1.0
    out[:] = math.nan
    if solve_spd(H, unit, x):
        out[0], out[1] = np.dot(x, g), x[0]


def adjust_window(  # type: ignore[no-untyped-def]
    images, rig, frames, points, inertial, delta, prior_H, prior_g, affine_prior, hold_first, hold_delta, wish, robust, iterations,
    min_rho,
):  # fmt: skip
    """Minimise the window's energy in place: frames.T_cam_world, frames.affine, points.rho, the inertial state and delta (1,).

    prior_H, prior_g (1 + 8F, with an IMU 1 + 17F + 2): z^T H z - 2 g^T z left by marginalisation;
    affine_prior (2,) information of a and b about zero;
    hold_first 1 fixes keyframe 0, for windows without a prior. hold_delta 1 leaves delta as it is and fills wish (2,) with the step
    that it would take if it were free, px, and its variance, in the energy's units. Returns inlier and own of Terms at the final
    state, the information of `information_of_state` there, and the energy.
    """
    N, F = points.host.shape[0], frames.slot.shape[0]
    seen, n = 1 + 8 * F, prior_g.shape[0]
    current, new = make_terms(N, F), make_terms(N, F)
    inverse, H_seen, g_seen = np.zeros(N), np.zeros((seen, seen)), np.zeros(seen)
    H, g, x, z, unit = np.zeros((n, n)), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    diagonal = np.einsum("ii->i", H)
    deviation(frames, delta[0], inertial, z)
    best = linearise(images, rig, frames, points, delta[0], robust, current) + energy_of_links(frames, inertial)
    best += prior_energy(z, prior_H, prior_g, frames.affine, affine_prior)
    damping = FIRST_DAMPING
    for _ in range(iterations):
        A = host_maps(frames)
        normal_equations(current, A, points, damping, H_seen, g_seen, inverse)
        H[:], g[:] = 0.0, 0.0
        H[:seen, :seen], g[:seen] = H_seen, g_seen
        if n > seen:
            add_links(frames, inertial, H, g)
            diagonal[seen:] += UNLINKED * inertial.weight
        deviation(frames, delta[0], inertial, z)
        add_prior(z, prior_H, prior_g, frames.affine, affine_prior, H, g)
        diagonal[1:] *= 1.0 + damping  # delta is not damped: it is known by all points together
        diagonal[1:7] += GAUGE * hold_first
        if hold_delta:
            if damping <= FIRST_DAMPING:  # more would keep the others from following
                first_alone(H, g, unit, x, wish)
            H[0, 0] += GAUGE
        if not solve_spd(H, g, x):
            damping *= 10.0
            continue
        T_before, affine_before, rho_before = frames.T_cam_world.copy(), frames.affine.copy(), points.rho.copy()
        velocity_before, bias_before, gamma_before = inertial.velocity.copy(), inertial.bias.copy(), inertial.gamma.copy()
        if hold_delta:
            x[0] = 0.0
        delta[0] += x[0]
        take_step(frames, points, inertial, current, A, inverse, x, min_rho)
        deviation(frames, delta[0], inertial, z)
        energy = linearise(images, rig, frames, points, delta[0], robust, new) + energy_of_links(frames, inertial)
        energy += prior_energy(z, prior_H, prior_g, frames.affine, affine_prior)
        way, turn = largest_step(x, F)
        small = way < SMALL_WAY_M and turn < SMALL_TURN
        if energy < best:
            small = small or best - energy < SMALL_GAIN * abs(best)
            best, damping = energy, damping * 0.25
            current, new = new, current
        else:
            delta[0] -= x[0]
            frames.T_cam_world[:], frames.affine[:], points.rho[:] = T_before, affine_before, rho_before
            inertial.velocity[:], inertial.bias[:], inertial.gamma[:] = velocity_before, bias_before, gamma_before
            damping *= 10.0
        if small or damping > 10.0:
            break
    H = information_of_state(current, frames, points, inertial, prior_H, affine_prior, hold_delta)
    return current.inlier, current.own, H, best


def information_of_state(terms, frames, points, inertial, prior_H, affine_prior, hold_delta):  # type: ignore[no-untyped-def]
    """(n, n) information of delta, keyframes and the IMU's unknowns in the energy's units: the residuals of terms, all points
    eliminated, and the priors. The gauge is free where there is no prior."""
    F, n = frames.slot.shape[0], prior_H.shape[0]
    seen = 1 + 8 * F
    H_seen, g_seen, H, g = np.zeros((seen, seen)), np.zeros(seen), np.zeros((n, n)), np.zeros(n)
    normal_equations(terms, host_maps(frames), points, 0.0, H_seen, g_seen, np.zeros(points.host.shape[0]))
    H[:seen, :seen] = H_seen
    if n > seen:
        add_links(frames, inertial, H, g)
        np.einsum("ii->i", H)[seen:] += UNLINKED * inertial.weight
    add_prior(np.zeros(n), prior_H, np.zeros(n), frames.affine, affine_prior, H, g)
    H[0, 0] += GAUGE * hold_delta
    return H


def reduced_equations(images, rig, frames, points, delta, robust):  # type: ignore[no-untyped-def]
    """H, g (1 + 8F) of delta and keyframes from the given points alone, eliminated without damping: what marginalisation
    adds to the prior."""
    N, n = points.host.shape[0], 1 + 8 * frames.slot.shape[0]
    terms = make_terms(N, frames.slot.shape[0])
    inverse, H, g = np.zeros(N), np.zeros((n, n)), np.zeros(n)
    linearise(images, rig, frames, points, delta, robust, terms)
    normal_equations(terms, host_maps(frames), points, 0.0, H, g, inverse)
    return H, g


def energy_of_links(frames, inertial):  # type: ignore[no-untyped-def]
    """The energy of the IMU's links, 0 where there is none: its kernels are then never compiled."""
    return links_energy(frames, inertial) if len(inertial.velocity) else 0.0


def observations(images, rig, frames, points, inlier, mask, targets, delta, robust, out):  # type: ignore[no-untyped-def]
    """Where the points in mask (N,) were inliers, by inlier (N, F + 1), in the left images of the frames targets (T,).

    Fills out (N T, 3): point, frame, the sum of RIGHT where the patch is a photometric inlier in the frame's right image too, at
    rows and bias corrected, LEFT_ALIKE and RIGHT_ALIKE where it looks like its host as well; by frame, then point. Returns how
    many.
    """
    T = relative_poses(frames, 0)
    return observe(images, rig, frames, points, inlier, mask, targets, T, right_of(T, rig), delta, robust, make_scratch(), out)


@kernel
def observe(  # type: ignore[no-untyped-def]
    images, rig, frames, points, inlier, mask, targets, T, T_right, delta, robust, scratch, out
):
    """observations with T and T_right (F, F, 4, 4) T_target_host to the left and the right camera, and working space."""
    n = 0
    for t in targets:
        for i in range(points.host.shape[0]):
            if not (mask[i] and inlier[i, t] > 0):
                continue
            h = points.host[i]
            x, y = (points.uv[i, 0] - rig.cx) / rig.fx, (points.uv[i, 1] - rig.cy) / rig.fy
            gain, gain_right = gain_between(frames.affine[h], frames.affine[t]), frames.gain_right[t, 0]
            offset = frames.affine[t, 1] - gain * frames.affine[h, 1]
            _, inside = patch_residual(
                images.left[frames.slot[t]], T[h, t], x, y, points.rho[i], rig, 0.0, points.colour[i], points.weight[i], gain,
                offset, robust, scratch,
            )  # fmt: skip
            left = inside and looks_alike(scratch.columns, LEAST_ALIKE)
            energy, inside = patch_residual(
                images.right[frames.slot[t]], T_right[h, t], x, y, points.rho[i], rig, delta, points.colour[i],
                points.weight[i], gain * gain_right, gain_right * offset + frames.gain_right[t, 1], robust, scratch,
            )  # fmt: skip
            good = inside and energy <= robust.max_energy * PATCH
            right = good and looks_alike(scratch.columns, LEAST_ALIKE)
            out[n, 0], out[n, 1], out[n, 2] = i, t, good * RIGHT + left * LEFT_ALIKE + right * RIGHT_ALIKE
            n += 1
    return n
