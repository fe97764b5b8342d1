"""Predictions and derivatives of a drive's matches, against finite differences and a point taken by hand."""

import numpy as np
import pytest
from made_observations import LENS, RIG, made_drive

from wayloom.calibration.residuals import (
    KEPT,
    Drive,
    DriveState,
    drive_of,
    first_state,
    jacobians,
    lens_of_drive,
    residuals,
)
from wayloom.calibration.residuals import (
    LENS as LENS_COUNT,
)
from wayloom.geometry import se3
from wayloom.geometry.lens import RightLens, lens_from_values, project_scaled
from wayloom.geometry.rectification import distort, undistort

DRIVE = drive_of(made_drive(LENS, groups=3, points=20, noise_px=0.05, outliers=0.0))
STEPS = np.array([1e-6, 1e-6, 1e-6, 1e-4, 1e-4, 1e-6, 1e-3, 1e-4, 1e-5, 1e-5])


def state() -> DriveState:
    made = first_state(DRIVE)
    made.offsets[:] = (0.2, 1e-4, -2e-4)
    return made


def moved(change: DriveState) -> DriveState:
    now = state()
    return DriveState(now.offsets + change.offsets, change.T_target_host @ now.T_target_host, now.rho + change.rho)


def still() -> DriveState:
    now = state()
    return DriveState(np.zeros(3), np.tile(np.eye(4), (*now.T_target_host.shape[:2], 1, 1)), np.zeros_like(now.rho))


def check(analytic: np.ndarray, ahead: np.ndarray, behind: np.ndarray, width: float) -> None:
    numeric = (ahead - behind) / width
    known = np.isfinite(numeric)
    assert known.any()
    np.testing.assert_allclose(analytic[known], numeric[known], atol=1e-5 * np.abs(numeric[known]).max() + 1e-6)


@pytest.mark.parametrize("i", range(LENS_COUNT))
def test_the_lens_columns_are_those_of_finite_differences(i: int) -> None:
    step = np.eye(LENS_COUNT)[i] * STEPS[i]
    ahead, behind = (residuals(DRIVE, lens_from_values(LENS.values + sign * step), state()) for sign in (1, -1))
    check(jacobians(DRIVE, LENS, state())[0][..., i], ahead, behind, 2 * STEPS[i])


@pytest.mark.parametrize(("i", "size"), [(0, 1e-3), (1, 1e-6), (2, 1e-6)])
def test_the_drives_columns_are_those_of_finite_differences(i: int, size: float) -> None:
    change = [still(), still()]
    for sign, one in zip((1, -1), change, strict=True):
        one.offsets[i] = sign * size
    ahead, behind = (residuals(DRIVE, LENS, moved(one)) for one in change)
    check(jacobians(DRIVE, LENS, state())[0][..., LENS_COUNT + i], ahead, behind, 2 * size)


@pytest.mark.parametrize("k", range(2))
@pytest.mark.parametrize("i", range(6))
def test_the_poses_columns_are_those_of_finite_differences(k: int, i: int) -> None:
    change = [still(), still()]
    for sign, one in zip((1, -1), change, strict=True):
        one.T_target_host[:, k] = se3.exp(sign * 1e-6 * np.eye(6)[i])
    ahead, behind = (residuals(DRIVE, LENS, moved(one)) for one in change)
    check(jacobians(DRIVE, LENS, state())[0][..., KEPT + 6 * k + i], ahead, behind, 2e-6)


def test_the_depths_column_is_that_of_finite_differences() -> None:
    change = [still(), still()]
    for sign, one in zip((1, -1), change, strict=True):
        one.rho[:] = sign * 1e-6
    ahead, behind = (residuals(DRIVE, LENS, moved(one)) for one in change)
    check(jacobians(DRIVE, LENS, state())[1], ahead, behind, 2e-6)


def test_the_common_radial_errors_column_is_that_of_finite_differences() -> None:
    camera = RIG.camera

    def warped(pixels: np.ndarray, kappa: float, way: object) -> np.ndarray:
        xy = (pixels.reshape(-1, 2) - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
        out = way(xy, (kappa, 0.0, 0.0, 0.0, 0.0))  # type: ignore[operator]
        return np.asarray(out * (camera.fx, camera.fy) + (camera.cx, camera.cy)).reshape(pixels.shape)

    def predicted(kappa: float) -> np.ndarray:
        """Both images through kappa: the host's ray is what it sees undistorted; left predictions are distorted, right ones get
        kappa with the lens's own k1."""
        rays = camera.rays(warped(DRIVE.observations.uv_host.astype(float), kappa, undistort))
        lens = lens_from_values(LENS.values + kappa * np.eye(LENS_COUNT)[7])
        out = residuals(Drive(DRIVE.observations, rays, DRIVE.measured), lens, state())
        for t in (1, 2):
            left = out[:, t] + DRIVE.measured[:, t]
            out[:, t] = np.where(np.isfinite(left), warped(np.nan_to_num(left), kappa, distort), np.nan) - DRIVE.measured[:, t]
        return out

    check(jacobians(DRIVE, LENS, state())[0][..., KEPT - 1], predicted(1e-5), predicted(-1e-5), 2e-5)


def test_a_match_is_predicted_where_camera_and_lens_put_the_point() -> None:
    now, p, rig = state(), 7, RIG
    own = lens_of_drive(LENS, now.offsets)
    host = DRIVE.rays[p] / now.rho[p]
    T = now.T_target_host[DRIVE.observations.group[p], 1]
    target = T[:3, :3] @ host + T[:3, 3]
    one = np.ones(1)
    expected = [
        project_scaled(own, rig.camera, rig.baseline_m, (host + rig.t_right_left)[None], one),
        rig.camera.project(target[None]),
        project_scaled(own, rig.camera, rig.baseline_m, (target + rig.t_right_left)[None], one),
    ]
    found = residuals(DRIVE, LENS, now)[p, [0, 2, 4]] + DRIVE.measured[p, [0, 2, 4]]
    np.testing.assert_allclose(found, np.concatenate(expected), atol=1e-9)


def test_a_drives_disparity_bias_is_the_opposite_of_a_shift_of_the_centre() -> None:
    lens = lens_of_drive(RightLens(cx_shift_px=0.3), np.array([0.5, 1e-3, 2e-3]))
    assert lens.cx_shift_px == pytest.approx(-0.2)
    assert (lens.pitch_rad, lens.roll_rad) == (1e-3, 2e-3)
