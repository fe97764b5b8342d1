"""The right image with the rig's lens undone and rows that follow, alone and in whole drives."""

from dataclasses import replace

import numpy as np
import pytest
from made_rig import CAMERA, LENS, RIG, LensLog, right_image
from made_street import curve, render

from wayloom.geometry.camera import StereoRig
from wayloom.geometry.lens import IDENTITY, RightLens, displaced
from wayloom.odometry import frame_source
from wayloom.odometry.kernels.resampling import STEP
from wayloom.odometry.odometry import track
from wayloom.odometry.rig import rows
from wayloom.odometry.rig.rows import RightRectifier
from wayloom.odometry.settings import OdometrySettings
from wayloom.reports.drive_warnings import calibration_warning

GRID = np.column_stack([a.ravel() for a in np.meshgrid(np.linspace(0, 479, 25), np.linspace(0, 179, 11))])


def grey(image: np.ndarray) -> np.ndarray:
    return np.clip(np.round(image), 0, 255).astype(np.uint8)


def test_the_displacements_are_the_lens_and_the_rows_together() -> None:
    right = RightRectifier(RIG, LENS, np.array([0.4, -0.3, 1.5]))
    assert right.corners is not None
    v, u = np.mgrid[0 : CAMERA.height, 0 : CAMERA.width]
    row, column, below, beside = v // STEP, u // STEP, (v % STEP / STEP)[..., None], (u % STEP / STEP)[..., None]
    upper, lower = ((1.0 - beside) * right.corners[row + k, column] + beside * right.corners[row + k, column + 1] for k in (0, 1))
    where = np.dstack([u, v]) + (1.0 - below) * upper + below * lower
    exact = right.real_pixels(np.column_stack([u.ravel(), v.ravel()]).astype(float)).reshape(*u.shape, 2)
    np.testing.assert_allclose(where, exact, atol=2e-3)


def test_a_small_rotation_moves_rows_and_columns_as_the_lens_model_says() -> None:
    tiny = RightLens(pitch_rad=-1e-4, roll_rad=2e-4)
    moved = rows.shift(np.array([1e-4 * 300, 2e-4 * 300, 0.0]), RIG, GRID)
    np.testing.assert_allclose(moved, tiny.real_pixels(CAMERA, 0.0, GRID) - GRID, atol=1e-4)


def test_a_lens_that_is_known_is_undone_at_every_depth() -> None:
    left, truth = render(np.eye(4), CAMERA)
    right = RightRectifier(RIG, LENS, np.zeros(3))
    aligned = right.align(grey(right_image(np.eye(4), RIG, LENS)))
    u, v = (a[20:-20:10, 130:-20:10].ravel() for a in np.meshgrid(np.arange(480), np.arange(180)))
    rho = truth[v, u]
    q = CAMERA.rays(np.column_stack([u, v]).astype(float)) + rho[:, None] * np.array(right.rig.t_right_left)
    seen = CAMERA.project(q)
    inside = CAMERA.contains(seen, 2)
    x, y = np.round(seen[inside]).astype(int).T
    error = np.abs(aligned[y, x].astype(float) - left[v[inside], u[inside]])
    assert np.median(error) < 12  # half a pixel of rounding, on a texture of 10 grey levels a pixel
    wrong = np.abs(grey(right_image(np.eye(4), RIG, LENS))[y, x].astype(float) - left[v[inside], u[inside]])
    assert np.median(error) < 0.8 * np.median(wrong)


def test_matches_through_the_lens_are_those_of_the_ideal_camera() -> None:
    uv = GRID[(GRID[:, 0] > 40)]
    real = LENS.real_pixels(CAMERA, 0.0, uv - (7.0, 0.0))
    matches = np.column_stack([uv, uv[:, 0] - real[:, 0], real[:, 1] - uv[:, 1]])
    ideal = rows.through_lens(matches, RIG, replace(LENS, ty=0.0, tz=0.0))
    np.testing.assert_allclose(ideal[:, 2:], np.tile([7.0, 0.0], (len(uv), 1)), atol=1e-6)


def test_rows_that_creep_are_followed() -> None:
    left = render(np.eye(4), CAMERA)[0]
    perfect = grey(right_image(np.eye(4), RIG, IDENTITY))
    right = RightRectifier(RIG, IDENTITY, np.zeros(3))
    for k in range(80):
        bent = rows.align(perfect, rows.displacements(-np.array([0.005, -0.004, 0.01]) * min(k, 30), RIG))
        aligned = right.align(bent)
        matches = rows.row_matches(grey(left), aligned)
        right.follow(grey(left), aligned, matches[:, :2].astype(np.int64), matches[:, 2])
    assert np.abs(rows.shift(right.coefficients - (0.15, -0.12, 0.3), RIG, GRID)[:, 1]).max() < 0.1


def test_straight_rows_stay_straight() -> None:
    left, perfect = grey(render(np.eye(4), CAMERA)[0]), grey(right_image(np.eye(4), RIG, IDENTITY))
    right = RightRectifier(RIG, IDENTITY, np.zeros(3))
    matches = rows.row_matches(left, perfect)
    for _ in range(20):
        right.follow(left, right.align(perfect), matches[:, :2].astype(np.int64), matches[:, 2])
    assert np.abs(rows.shift(right.coefficients, RIG, GRID)).max() < 0.06


def test_all_rows_are_those_of_rows_and_lens_together() -> None:
    alone = RightRectifier(RIG, IDENTITY, np.array([0.3, -0.2, 1.0]))
    np.testing.assert_allclose(alone.all_rows(), [0.3, -0.2, 1.0])
    turned = RightRectifier(RIG, RightLens(pitch_rad=-1e-3), np.array([0.1, 0.0, 0.0]))
    np.testing.assert_allclose(turned.all_rows(), [0.4, 0.0, 0.0], atol=5e-3)


def test_the_rows_left_beside_a_known_lens_are_small() -> None:
    log = LensLog(curve(10, 0.5), lens=LENS)
    with_lens, without = frame_source.fit_rows(log, (0, 3), LENS), frame_source.fit_rows(log, (0, 3))
    assert np.abs(with_lens).max() < 0.2
    assert np.abs(without).max() > 0.3


def length_error(log: LensLog, lens: RightLens, settings: OdometrySettings = OdometrySettings()) -> tuple[float, float]:
    """Share by which the way is too long, and the worst position error in m."""
    result = track(log, settings, lens=lens)
    assert result.rig == displaced(log.rig, lens)
    places, truth = (T[:, :3, 3] for T in (result.trajectory.T_world_cam, log.truth))
    way, true = (float(np.linalg.norm(np.diff(p, axis=0), axis=1).sum()) for p in (places, truth))
    return way / true - 1.0, float(np.linalg.norm(places - truth, axis=1).max())


def test_a_drive_with_a_known_lens_is_as_good_as_one_of_a_perfect_rig() -> None:
    truth, no_bias = curve(40, 0.6, 0.01), OdometrySettings(bias_prior=1e15)
    perfect = length_error(LensLog(truth), IDENTITY, no_bias)
    known = length_error(LensLog(truth, lens=LENS), LENS, no_bias)
    unknown = length_error(LensLog(truth, lens=LENS), IDENTITY)
    with_bias = length_error(LensLog(truth, lens=LENS), LENS)
    assert abs(known[0] - perfect[0]) < min(1e-3, 0.2 * abs(unknown[0] - perfect[0]))  # 0.016 px of these disparities of 16 px
    assert known[1] < 0.001 * 40 * 0.6
    assert abs(with_bias[0] - perfect[0]) < 3e-3  # a bias that 24 m tell to 0.02 px or so
    # with four other choices of points 0.2 to 0.33 of what the lens costs, with OpenCV's alignment of the rows as with ours
    assert abs(with_bias[0] - perfect[0]) < 0.4 * abs(unknown[0] - perfect[0])


def test_the_lens_moves_no_pose_of_the_left_camera() -> None:
    assert displaced(RIG, LENS).camera == RIG.camera
    assert displaced(RIG, LENS).baseline_m == RIG.baseline_m
    assert displaced(StereoRig(CAMERA, (-0.5, 0.01, 0.02)), IDENTITY).t_right_left == pytest.approx((-0.5, 0.01, 0.02))


def test_the_size_of_a_bad_calibration_is_told_in_pixels() -> None:
    turned = RightRectifier(RIG, IDENTITY, np.array([1.2, 0.0, 0.0]))
    assert turned.worst_px() == pytest.approx(1.2 * (1 + (89.5 / 300) ** 2), rel=0.02)
    told = calibration_warning({"rows_off_px": turned.worst_px(), "disparity_bias_px": -0.4})
    assert "rows of left and right by up to 1.3 px, disparities by 0.4 px" in str(told)
    assert calibration_warning({"rows_off_px": 0.9, "disparity_bias_px": -0.9}) is None
