"""Bundle adjustment of several drives' match groups with one lens: Gauss-Newton, points, poses and drives eliminated in turn.

Each residual's weight is 1/s^2 1/(1 + |r|^2 / (c s)^2) (Cauchy), s being the noise of its kind of match, by the residuals. A match
group's points leave by the Schur complement, then its poses, then the drive's offsets; what stays is (11, 11) for the lens and
kappa, which is held at zero.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from wayloom.calibration.residuals import (
    DRIVE,
    KAPPA,
    KEPT,
    LENS,
    MATCHES,
    POSES,
    UNKNOWNS,
    Drive,
    DriveState,
    first_state,
    lens_of_drive,
    residuals,
)
from wayloom.calibration.settings import CalibrationSettings
from wayloom.geometry import se3
from wayloom.geometry.lens import R_real_ideal, RightLens, lens_from_values, rotation_derivatives
from wayloom.odometry.kernels.match_equations import fill_group_equations
from wayloom.odometry.rig.calibration_observations import TARGETS

FloatArray = NDArray[np.float64]
STAY = [*range(LENS), LENS + DRIVE]
LEAVE = list(range(LENS, LENS + DRIVE))
"""Columns of lens and kappa, and of the drive's offsets."""
KINDS = (slice(0, 1), slice(1, 1 + TARGETS), slice(1 + TARGETS, MATCHES))
"""Matches that share one noise: right of the host, left of the targets, right of the targets."""
FIRST_NOISE_PX = 0.5
POSES_PRIOR = np.diag(([1e2] * 3 + [1e4] * 3) * TARGETS)
"""1/m^2 and 1/rad^2, of each step: 10 cm, 0.6 degrees; it matters for targets without matches only."""
RHO_PRIOR = 1.0
"""m^2, of each step: keeps a point without temporal matches where it is."""


@dataclass(frozen=True, slots=True)
class GroupEquations:
    """Reduced normal equations of a match group in lens, drive and kappa (14), points and poses eliminated: H (14, 14), g (14,),
    H x = g; the way back: poses = pose_step - pose_gain @ x, rho = rho_step - rho_gain @ (x, poses)."""

    H: FloatArray
    g: FloatArray
    pose_step: FloatArray
    pose_gain: FloatArray
    rho_step: FloatArray
    rho_gain: FloatArray


@dataclass(slots=True)
class Adjustment:
    """State and outcome. equations: of each drive's groups, at the last linearisation; noise_px (3,) of KINDS;
    weights: (P, 5) of each drive's matches, 0 to 1; converged: whether the last step was small."""

    lens: RightLens
    states: list[DriveState]
    noise_px: FloatArray
    equations: list[list[GroupEquations]]
    weights: list[FloatArray]
    converged: bool = False


def adjust(
    drives: list[Drive], settings: CalibrationSettings, prior_H: FloatArray, prior_g: FloatArray, lens: RightLens = RightLens()
) -> Adjustment:
    """Minimise over lens, offsets, poses and inverse depths.

    prior_H (10, 10), prior_g (10,): energy 1/2 x^T H x - g^T x of the lens's difference x from the ideal camera's.
    """
    fit = Adjustment(lens, [first_state(drive) for drive in drives], np.full(len(KINDS), FIRST_NOISE_PX), [], [])
    for k in range(settings.iterations):
        _linearise(fit, drives, settings)
        step = _lens_step(fit, settings, prior_H, prior_g)
        sigma = np.sqrt(np.diag(np.linalg.inv(lens_information(fit, settings)[0][:LENS, :LENS] + prior_H)))
        fit.lens = lens_from_values(fit.lens.values + step)
        for drive, state, equations in zip(drives, fit.states, fit.equations, strict=True):
            _step_back(drive, state, equations, step, settings)
        fit.noise_px = _noise(fit, drives, settings)
        fit.converged = k > 2 and bool((np.abs(step) < settings.smallest_step * sigma).all())
        if fit.converged:
            break
    _linearise(fit, drives, settings)
    return fit


def drive_information(
    fit: Adjustment, d: int, settings: CalibrationSettings, curvature: float = 1.0
) -> tuple[FloatArray, FloatArray]:
    """(11, 11) and (11,) of lens and kappa by one drive: its groups and its offsets' prior, the offsets eliminated.

    curvature : of the energy, over that of its reweighted squares
    """
    H, g = _drive_sums(fit, d, settings, curvature)
    gain = _offset_gain(H)
    return H[np.ix_(STAY, STAY)] - gain @ H[np.ix_(LEAVE, STAY)], g[STAY] - gain @ g[LEAVE]


def lens_information(fit: Adjustment, settings: CalibrationSettings) -> tuple[FloatArray, FloatArray]:
    """(11, 11) and (11,) of lens and kappa by all drives, without the lens's prior, about the present lens."""
    return _sum_of([drive_information(fit, d, settings) for d in range(len(fit.equations))])


def lens_expansion(fit: Adjustment, settings: CalibrationSettings) -> tuple[FloatArray, FloatArray]:
    """As `lens_information`, with the robust energy's own curvature: its expansion to second order, which stands for these drives
    when others are added."""
    return _sum_of([drive_information(fit, d, settings, curvature_ratio(fit.weights[d])) for d in range(len(fit.equations))])


def curvature_ratio(weights: FloatArray) -> float:
    """Curvature of the Cauchy energy over that of the reweighted squares, for weights (P, 5).

    With w = 1/(1 + s), s = |r|^2/c^2, the energy's second derivative by r is w I - 2 w^2 r r^T/c^2, of trace 2 w (1 - w s) = 2 w^2.
    """
    return float((weights**2).sum() / max(weights.sum(), 1e-12))


def group_scores(fit: Adjustment, d: int, settings: CalibrationSettings) -> tuple[FloatArray, FloatArray]:
    """Scores (S, 10) and curvatures (S, 10, 10) of a drive's match groups for the lens, the drive's offsets eliminated.

    With G = H_lo (H_oo + A)^-1, A the offsets' prior, a group's score is (I, -G) g and its curvature (I, -G) H (I, -G)^T; with
    G A G^T these sum to the drive's.
    """
    ratio, free = curvature_ratio(fit.weights[d]), slice(0, LENS + DRIVE)
    gain = _offset_gain(_drive_sums(fit, d, settings, ratio)[0])[:LENS]
    reduce = np.hstack([np.eye(LENS), -gain])
    scores = np.array([reduce @ e.g[free] for e in fit.equations[d]]).reshape(-1, LENS)
    curvatures = np.array([ratio * reduce @ e.H[free, free] @ reduce.T for e in fit.equations[d]]).reshape(-1, LENS, LENS)
    return scores, curvatures


def drive_offsets(fit: Adjustment, d: int, settings: CalibrationSettings) -> tuple[FloatArray, FloatArray]:
    """How a drive's offsets follow the lens, -do/dx (3, 10), and their covariance (3, 3) at that lens by the groups' scores."""
    H = _drive_sums(fit, d, settings, curvature_ratio(fit.weights[d]))[0]
    own = H[np.ix_(LEAVE, LEAVE)]
    scores = np.array([e.g[LEAVE] for e in fit.equations[d]]).reshape(-1, len(LEAVE))
    inverse = np.linalg.inv(own)
    meat = scores.T @ scores + np.diag(1.0 / settings.drive.sigmas**2)
    return np.asarray(np.linalg.solve(own, H[LEAVE, :LENS])), np.asarray(inverse @ meat @ inverse)


def _sum_of(parts: list[tuple[FloatArray, FloatArray]]) -> tuple[FloatArray, FloatArray]:
    return sum((H for H, _ in parts), np.zeros((len(STAY), len(STAY)))), sum((g for _, g in parts), np.zeros(len(STAY)))


def _offset_gain(H: FloatArray) -> FloatArray:
    """(11, 3): what eliminating the offsets takes from lens and kappa, of a drive's H (14, 14)."""
    return np.asarray(np.linalg.solve(H[np.ix_(LEAVE, LEAVE)], H[np.ix_(LEAVE, STAY)]).T, np.float64)


def _drive_sums(fit: Adjustment, d: int, settings: CalibrationSettings, curvature: float = 1.0) -> tuple[FloatArray, FloatArray]:
    """(14, 14) and (14,) of a drive's groups, H times `curvature`, and of the prior of its offsets."""
    H, g = np.zeros((KEPT, KEPT)), np.zeros(KEPT)
    for group in fit.equations[d]:
        H += curvature * group.H
        g += group.g
    information = 1.0 / settings.drive.sigmas**2
    H[LEAVE, LEAVE] += information
    g[LEAVE] -= information * fit.states[d].offsets
    return H, g


def _lens_step(fit: Adjustment, settings: CalibrationSettings, prior_H: FloatArray, prior_g: FloatArray) -> FloatArray:
    H, g = (part[:LENS, ...] for part in lens_information(fit, settings))
    x = fit.lens.values - RightLens().values
    return np.asarray(np.linalg.solve(H[:, :LENS] + prior_H, g + prior_g - prior_H @ x), np.float64)


def _linearise(fit: Adjustment, drives: list[Drive], settings: CalibrationSettings) -> None:
    """Renew equations and weights."""
    fit.equations, fit.weights = [], []
    noise = _noise_of_match(fit.noise_px)
    for drive, state in zip(drives, fit.states, strict=True):
        own, rig, groups = lens_of_drive(fit.lens, state.offsets), drive.observations.rig, drive.observations.groups
        camera, P = rig.camera, len(state.rho)
        starts = np.searchsorted(drive.observations.group, np.arange(groups + 1))
        numbers = np.array(
            [camera.fx, camera.fy, camera.cx, camera.cy, own.focal_ratio, own.cx_shift_px, own.k1, own.p1, own.p2, rig.baseline_m,
             own.ty, own.tz, *rig.t_right_left]
        )  # fmt: skip
        weights, rho_step, rho_gain = np.zeros((P, MATCHES)), np.zeros(P), np.zeros((P, UNKNOWNS))
        H, g = np.zeros((groups, UNKNOWNS, UNKNOWNS)), np.zeros((groups, UNKNOWNS))
        fill_group_equations(
            drive.rays, drive.measured, state.rho, starts, state.T_target_host, R_real_ideal(own).copy(),
            np.array(rotation_derivatives(own)), numbers, noise, settings.robust_scale, RHO_PRIOR, np.empty((12, UNKNOWNS + 1)),
            weights, H, g, rho_step, rho_gain,
        )  # fmt: skip
        slices = [slice(a, b) for a, b in pairwise(starts)]
        fit.equations.append([_group_equations(H[k], g[k], rho_step[s], rho_gain[s]) for k, s in enumerate(slices)])
        fit.weights.append(weights)


def _group_equations(H: FloatArray, g: FloatArray, rho_step: FloatArray, rho_gain: FloatArray) -> GroupEquations:
    """Eliminate the poses of a group from H (26, 26) and g (26,); rho_step (n,) and rho_gain (n, 26) as they are."""
    P = slice(KEPT, UNKNOWNS)
    solved = np.asarray(np.linalg.solve(H[P, P] + POSES_PRIOR, np.column_stack([g[P], H[P, :KEPT]])), np.float64)
    pose_step, pose_gain = solved[:, 0], solved[:, 1:]
    own_H, own_g = H[:KEPT, :KEPT] - H[:KEPT, P] @ pose_gain, g[:KEPT] - H[:KEPT, P] @ pose_step
    return GroupEquations(own_H, own_g, pose_step, pose_gain, rho_step, rho_gain)


def _step_back(
    drive: Drive, state: DriveState, equations: list[GroupEquations], lens_step: FloatArray, settings: CalibrationSettings
) -> None:
    """Move a drive's offsets, poses and inverse depths by what follows from the lens's step (10,)."""
    information = 1.0 / settings.drive.sigmas**2
    H = sum((e.H for e in equations), np.zeros((KEPT, KEPT)))
    g = sum((e.g for e in equations), np.zeros(KEPT))
    right = g[LEAVE] - information * state.offsets - H[LEAVE, :LENS] @ lens_step
    offsets = np.linalg.solve(H[np.ix_(LEAVE, LEAVE)] + np.diag(information), right)
    state.offsets += offsets
    kept, rho = np.concatenate([lens_step, offsets, np.zeros(KAPPA)]), []
    for s, e in enumerate(equations):
        poses = e.pose_step - e.pose_gain @ kept
        rho.append(e.rho_step - e.rho_gain @ np.concatenate([kept, poses]))
        state.T_target_host[s] = se3.exp(poses.reshape(TARGETS, POSES // TARGETS)) @ state.T_target_host[s]
    state.rho += np.concatenate([np.zeros(0), *rho])


def _noise_of_match(noise_px: FloatArray) -> FloatArray:
    """(5,) px, of each of a point's matches."""
    out = np.empty(MATCHES)
    for kind, noise in zip(KINDS, noise_px, strict=True):
        out[kind] = noise
    return out


def _noise(fit: Adjustment, drives: list[Drive], settings: CalibrationSettings) -> FloatArray:
    """(3,) px: the spread of each kind of match, by median absolute residuals; what the fit took up is given back."""
    found = [residuals(drive, fit.lens, state) for drive, state in zip(drives, fit.states, strict=True)]
    points, matched = sum(len(r) for r in found), sum(int(np.isfinite(r).sum()) for r in found)
    share = max(1.0 - points / max(matched, 1), 0.2)  # each point's depth takes one of its residuals
    out = np.full(len(KINDS), FIRST_NOISE_PX)
    for k, kind in enumerate(KINDS):
        sizes = np.abs(np.concatenate([r[:, kind].ravel() for r in found]))
        sizes = sizes[np.isfinite(sizes)]
        if len(sizes):
            out[k] = 1.4826 * np.median(sizes) / np.sqrt(share)
    return np.asarray(np.maximum(out, settings.least_noise_px), np.float64)
