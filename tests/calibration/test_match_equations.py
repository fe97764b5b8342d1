"""The kernel of the match groups' normal equations, against the arrays of their residuals and derivatives."""

from itertools import pairwise

import numpy as np
from made_observations import LENS, made_drive

from wayloom.calibration import adjustment
from wayloom.calibration.residuals import KEPT, UNKNOWNS, DriveState, drive_of, first_state, jacobians, residuals
from wayloom.calibration.settings import CalibrationSettings

DRIVE = drive_of(made_drive(LENS, groups=3, points=40, noise_px=0.2, outliers=0.1))
SETTINGS = CalibrationSettings()
NOISE_PX = np.array([0.3, 0.4, 0.5])


def state() -> DriveState:
    """With a point behind a camera and offsets of the drive's own."""
    made = first_state(DRIVE)
    made.offsets[:] = (0.2, 1e-3, -2e-3)
    made.T_target_host[1, 0, 2, 3] = -1.0 / made.rho[DRIVE.observations.group == 1].mean()
    return made


def test_equations_are_those_of_weighted_residuals_with_depths_and_poses_eliminated() -> None:
    now = state()
    fit = adjustment.Adjustment(LENS, [now], NOISE_PX, [], [])
    adjustment._linearise(fit, [DRIVE], SETTINGS)
    r, (J, J_rho) = residuals(DRIVE, LENS, now), jacobians(DRIVE, LENS, now)
    noise = NOISE_PX[[0, 1, 1, 2, 2]]
    known = np.isfinite(r).all(axis=2) & np.isfinite(J).all(axis=(2, 3)) & np.isfinite(J_rho).all(axis=2)
    assert 0.3 < known.mean() < 0.95
    weight = np.where(known, 1.0 / (1.0 + (r**2).sum(axis=2) / (SETTINGS.robust_scale * noise) ** 2), 0.0)
    np.testing.assert_allclose(fit.weights[0], weight, rtol=1e-9)
    assert np.ptp(weight[known]) > 0.5
    root = np.sqrt(weight) / noise
    r, J_rho = np.where(known[..., None], r * root[..., None], 0.0), np.where(known[..., None], J_rho * root[..., None], 0.0)
    J = np.where(known[..., None, None], J * root[..., None, None], 0.0)
    starts = np.searchsorted(DRIVE.observations.group, np.arange(4))
    for s, (first, last) in enumerate(pairwise(starts)):
        n, poses = last - first, UNKNOWNS - KEPT
        dense = np.zeros((10 * n, UNKNOWNS + n))
        dense[:, :UNKNOWNS] = J[first:last].reshape(-1, UNKNOWNS)
        for i in range(n):
            dense[10 * i : 10 * i + 10, UNKNOWNS + i] = J_rho[first + i].ravel()
        H, g = dense.T @ dense, -dense.T @ r[first:last].ravel()
        rest = slice(KEPT, UNKNOWNS + n)
        H[rest, rest] += np.diag([*np.diag(adjustment.POSES_PRIOR), *[adjustment.RHO_PRIOR] * n])
        gain = np.linalg.solve(H[rest, rest], np.column_stack([H[rest, :KEPT], g[rest]]))
        found = fit.equations[0][s]
        scale = np.abs(H[:KEPT, :KEPT]).max(axis=0)
        np.testing.assert_allclose(found.H, H[:KEPT, :KEPT] - H[:KEPT, rest] @ gain[:, :-1], rtol=1e-6, atol=1e-9 * scale.max())
        np.testing.assert_allclose(found.g, g[:KEPT] - H[:KEPT, rest] @ gain[:, -1], rtol=1e-6, atol=1e-6 * np.abs(g[:KEPT]).max())
        np.testing.assert_allclose(found.pose_step, gain[:poses, -1], rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(found.pose_gain, gain[:poses, :-1], rtol=1e-6, atol=1e-8)
        x = np.linspace(-1e-3, 1e-3, UNKNOWNS)
        x[KEPT:] = found.pose_step - found.pose_gain @ x[:KEPT]
        depths = gain[poses:, -1] - gain[poses:, :-1] @ x[:KEPT]
        np.testing.assert_allclose(found.rho_step - found.rho_gain @ x, depths, rtol=1e-6, atol=1e-9)
