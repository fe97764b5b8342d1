"""Reprojection residuals of one drive's matches by lens, poses and inverse depths, and their Jacobians.

A point of ray r = (x, y, 1) and inverse depth rho in its host is, times rho,

    q_0 = r + rho t_right_left                 in the host's ideal right camera,
    q_t = R r + rho t,  T_target_host = [R t]  in a target's left camera,      q_t + rho t_right_left in its right one.

Every point has five matches at most: right of the host, left of each of two targets, right of each of two targets; each is two
residuals, predicted - measured, px. The right ones go through the drive's lens.

Both lenses may share a radial error kappa that rectification left (x -> x (1 + kappa r^2)); it is never estimated, but its
derivative is known, so that what it could do to the lens counts as uncertainty.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.geometry.lens import PARAMETERS, RightLens, lens_from_values, project_scaled, projection_jacobians
from wayloom.odometry.rig.calibration_observations import TARGETS, CalibrationObservations

FloatArray = NDArray[np.float64]
MATCHES = 1 + 2 * TARGETS
"""Right of the host, left of the targets, right of the targets."""
LENS, DRIVE, KAPPA = len(PARAMETERS), 3, 1
POSES = 6 * TARGETS
KEPT = LENS + DRIVE + KAPPA
UNKNOWNS = KEPT + POSES
_ON_DRIVE = (PARAMETERS.index("cx_shift_px"), PARAMETERS.index("pitch_rad"), PARAMETERS.index("roll_rad"))
_SIGNS = np.array([-1.0, 1.0, 1.0])
"""A disparity bias is the opposite of a shift of cx."""


@dataclass(slots=True)
class DriveState:
    """What is free in a drive beside the lens: offsets (3,) disparity bias in px, pitch and roll in rad on top of the rig's;
    T_target_host (S, T, 4, 4); rho (P,) 1/m."""

    offsets: FloatArray
    T_target_host: FloatArray
    rho: FloatArray


@dataclass(frozen=True, slots=True)
class Drive:
    """A drive's observations as arrays: rays (P, 3) in the host, measured (P, 5, 2) px, NaN where there is no match."""

    observations: CalibrationObservations
    rays: FloatArray
    measured: FloatArray


def drive_of(observations: CalibrationObservations) -> Drive:
    """The arrays of a drive's observations."""
    measured = np.concatenate(
        [observations.uv_right[:, None], observations.uv_left_target, observations.uv_right_target], axis=1, dtype=np.float64
    )  # fmt: skip
    return Drive(observations, observations.rig.camera.rays(observations.uv_host.astype(float)), measured)


def first_state(drive: Drive) -> DriveState:
    """No offsets, the odometry's poses, depths from the disparities as they are."""
    observations = drive.observations
    rho = (observations.uv_host[:, 0] - drive.measured[:, 0, 0]) / observations.rig.bf
    return DriveState(np.zeros(DRIVE), observations.T_target_host.copy(), rho)


def lens_of_drive(lens: RightLens, offsets: FloatArray) -> RightLens:
    """The rig's lens with a drive's offsets (3,) on top."""
    values = lens.values
    values[list(_ON_DRIVE)] += _SIGNS * offsets
    return lens_from_values(values)


def residuals(drive: Drive, lens: RightLens, state: DriveState) -> FloatArray:
    """(P, 5, 2) px, predicted - measured; NaN where there is no match or the point is behind the camera."""
    rig, observations = drive.observations.rig, drive.observations
    own, t = lens_of_drive(lens, state.offsets), np.array(rig.t_right_left)
    rho, out = state.rho, np.empty_like(drive.measured)
    out[:, 0] = project_scaled(own, rig.camera, rig.baseline_m, drive.rays + rho[:, None] * t, rho)
    for k in range(TARGETS):
        q = _in_target(drive.rays, rho, state.T_target_host[observations.group, k])
        out[:, 1 + k] = rig.camera.project(q)
        out[:, 1 + TARGETS + k] = project_scaled(own, rig.camera, rig.baseline_m, q + rho[:, None] * t, rho)
    return out - drive.measured


def jacobians(drive: Drive, lens: RightLens, state: DriveState) -> tuple[FloatArray, FloatArray]:
    """Derivatives of the residuals: J (P, 5, 2, 26) by lens (10), drive (3), kappa and the group's poses (twist (v, omega) of
    each target, perturbed on the left), J_rho (P, 5, 2)."""
    rig, observations, rho = drive.observations.rig, drive.observations, state.rho
    own, t = lens_of_drive(lens, state.offsets), np.array(rig.t_right_left)
    J, J_rho = np.zeros((len(rho), MATCHES, 2, UNKNOWNS)), np.zeros((len(rho), MATCHES, 2))

    by_kappa = -drive.rays * np.array([1.0, 1.0, 0.0]) * (drive.rays[:, :2] ** 2).sum(axis=1)[:, None]  # of the host's ray

    def right(row: int, q: FloatArray, dq_drho: FloatArray, dq_dkappa: FloatArray) -> FloatArray:
        by_q, by_rho, by_lens = projection_jacobians(own, rig.camera, rig.baseline_m, q + rho[:, None] * t, rho)
        J[:, row, :, :LENS] = by_lens
        J[:, row, :, LENS : LENS + DRIVE] = by_lens[:, :, list(_ON_DRIVE)] * _SIGNS
        J[:, row, :, LENS + DRIVE] = by_lens[:, :, PARAMETERS.index("k1")] + np.einsum("pij,pj->pi", by_q, dq_dkappa)
        J_rho[:, row] = by_rho + np.einsum("pij,pj->pi", by_q, dq_drho + t)
        return by_q

    right(0, drive.rays, np.zeros_like(drive.rays), by_kappa)
    for k in range(TARGETS):
        T = state.T_target_host[observations.group, k]
        q = _in_target(drive.rays, rho, T)
        by_twist = np.concatenate([rho[:, None, None] * np.eye(3), -se3.hat(q)], axis=2)  # dq = rho v + omega x q
        columns = slice(KEPT + 6 * k, KEPT + 6 * (k + 1))
        by_q, turned = _pinhole_by_q(drive, q), np.einsum("pij,pj->pi", T[:, :3, :3], by_kappa)
        xy = q[:, :2] / q[:, 2:]
        radial = xy * (xy**2).sum(axis=1)[:, None] * (rig.camera.fx, rig.camera.fy)
        J[:, 1 + k, :, LENS + DRIVE] = np.einsum("pij,pj->pi", by_q, turned) + radial
        J[:, 1 + k, :, columns] = by_q @ by_twist
        J_rho[:, 1 + k] = np.einsum("pij,pj->pi", by_q, T[:, :3, 3])
        J[:, 1 + TARGETS + k, :, columns] = right(1 + TARGETS + k, q, T[:, :3, 3], turned) @ by_twist
    return J, J_rho


def _in_target(rays: FloatArray, rho: FloatArray, T: FloatArray) -> FloatArray:
    """(P, 3): points times rho in their targets' left cameras; T (P, 4, 4)."""
    return np.asarray(np.einsum("pij,pj->pi", T[:, :3, :3], rays) + rho[:, None] * T[:, :3, 3])


def _pinhole_by_q(drive: Drive, q: FloatArray) -> FloatArray:
    """(P, 2, 3): derivative of the left camera's projection at q (P, 3)."""
    camera = drive.observations.rig.camera
    z = np.where(q[:, 2] > 0, q[:, 2], np.nan)
    out = np.zeros((len(q), 2, 3))
    out[:, 0, 0], out[:, 1, 1] = camera.fx / z, camera.fy / z
    out[:, 0, 2], out[:, 1, 2] = -camera.fx * q[:, 0] / z**2, -camera.fy * q[:, 1] / z**2
    return out
