"""Whole drives through a made street with exact truth: accuracy, losses, damaged input, image sizes."""

from dataclasses import replace

import numpy as np
import pytest
from made_street import CAMERA, MadeLog, curve, render

from wayloom.errors import CalibrationError, LogError
from wayloom.geometry import se3
from wayloom.geometry.camera import PinholeCamera, StereoRig
from wayloom.odometry.odometry import track
from wayloom.odometry.types import OdometryResult


def position_errors(result: OdometryResult, log: MadeLog) -> np.ndarray:
    return np.linalg.norm(result.trajectory.T_world_cam[:, :3, 3] - log.truth[:, :3, 3], axis=1)


def check_whole(result: OdometryResult, frames: int) -> None:
    assert len(result.trajectory) == frames
    assert np.isfinite(result.trajectory.T_world_cam).all()
    R = result.trajectory.T_world_cam[:, :3, :3]
    np.testing.assert_allclose(R @ R.swapaxes(1, 2), np.tile(np.eye(3), (frames, 1, 1)), atol=1e-9)
    points = result.points
    assert points.obs_start[-1] == len(points.obs_keyframe) == len(points.obs_right)
    assert (points.variance > 0).all()
    assert (points.inverse_depth > 0).all()


@pytest.fixture(scope="module")
def drive() -> tuple[MadeLog, OdometryResult]:
    log = MadeLog(curve(40), bias_px=0.4)
    return log, track(log)


def test_a_drive_is_tracked_within_half_a_percent_of_its_way(drive) -> None:
    log, result = drive
    check_whole(result, 40)
    assert result.trajectory.tracked.all()
    assert (result.trajectory.segment == 0).all()
    assert position_errors(result, log).max() < 0.005 * 39 * 0.4


def test_the_disparity_bias_is_found(drive) -> None:
    assert drive[1].disparity_bias_px == pytest.approx(0.4, abs=0.1)


def test_a_rig_without_bias_keeps_none() -> None:
    assert track(MadeLog(curve(40))).disparity_bias_px == 0.0


def test_points_have_the_right_depth_and_an_honest_variance(drive) -> None:
    log, result = drive
    points, keyframes = result.points, result.keyframes
    assert len(points) > 1000
    errors = np.zeros(len(points))
    for k, frame in enumerate(keyframes.frame):
        mine = points.host == k
        u, v = points.uv_host[mine].astype(int).T
        errors[mine] = points.inverse_depth[mine] - render(log.truth[frame], CAMERA)[1][v, u]
    sigma = np.sqrt(points.variance)
    assert np.median(np.abs(errors)) < 0.002
    assert (np.abs(errors) < 2 * sigma).mean() > 0.9
    assert np.median(np.abs(errors)) > 0.1 * np.median(sigma)


def test_observations_are_keyframes_that_see_the_point_and_never_its_host(drive) -> None:
    _, result = drive
    points, keyframes = result.points, result.keyframes
    counts = np.diff(points.obs_start)
    assert counts.min() >= 2
    point = np.repeat(np.arange(len(points)), counts)
    assert (points.obs_keyframe != points.host[point]).all()
    world = result.points_world()
    inside = [
        CAMERA.contains(CAMERA.project(se3.transform(se3.inverse(keyframes.T_world_cam[k]), world[i : i + 1])))[0]
        for i, k in zip(point[::17], points.obs_keyframe[::17], strict=True)
    ]
    assert all(inside)
    assert points.obs_right.mean() > 0.7
    assert points.host_right.mean() > 0.9


def test_grey_values_are_those_of_the_host_image(drive) -> None:
    log, result = drive
    mine = result.points.host == 3
    u, v = result.points.uv_host[mine].astype(int).T
    np.testing.assert_array_equal(result.points.grey[mine], log.frame(int(result.keyframes.frame[3])).left[v, u])


def test_frames_follow_the_final_estimate_of_their_keyframe(drive) -> None:
    _, result = drive
    np.testing.assert_allclose(result.trajectory.T_world_cam[result.keyframes.frame], result.keyframes.T_world_cam, atol=1e-12)
    assert (np.diff(result.keyframes.frame) > 0).all()


def blank(left, right):
    return np.zeros_like(left), np.zeros_like(right)


def test_black_frames_are_bridged_by_constant_motion_and_reported() -> None:
    log = MadeLog(curve(24), changes=dict.fromkeys((0, 1, 12, 13), blank))
    result = track(log)
    check_whole(result, 24)
    assert np.flatnonzero(~result.trajectory.tracked).tolist() == [0, 1, 12, 13]
    assert [loss["frame"] for loss in result.report["losses"]] == [0, 1, 12, 13]
    assert len(result.report["segments"]) == 1
    moved = log.truth[2:, :3, 3] - log.truth[2, :3, 3]
    np.testing.assert_allclose(result.trajectory.T_world_cam[2:, :3, 3], moved, atol=0.15)


def test_a_drive_of_black_images_gives_a_line_for_every_frame_and_nothing_else() -> None:
    result = track(MadeLog(curve(5), changes=dict.fromkeys(range(5), blank)))
    check_whole(result, 5)
    assert not result.trajectory.tracked.any()
    assert len(result.keyframes) == len(result.points) == 0
    assert result.report["segments"] == []


def test_a_jump_to_another_place_starts_a_new_segment() -> None:
    truth = curve(24)
    truth[12:] = truth[12:] @ se3.exp(np.array([1.0, 0.0, -30.0, 0.0, 2.4, 0.0]))
    log = MadeLog(truth)
    result = track(log)
    check_whole(result, 24)
    assert len(result.report["segments"]) == 2
    assert not result.trajectory.tracked[12]
    second = result.trajectory.segment == 1
    assert result.report["losses"]
    frames = np.flatnonzero(second & result.trajectory.tracked)
    a, b = frames[1], frames[-1]
    way = np.linalg.norm(truth[b, :3, 3] - truth[a, :3, 3])
    T = result.trajectory.T_world_cam
    assert np.linalg.norm(T[b, :3, 3] - T[a, :3, 3]) == pytest.approx(way, rel=0.02)


def test_repeated_frames_are_a_stop() -> None:
    truth = curve(20)[np.r_[0:8, [7] * 6, 8:14]]
    log = MadeLog(truth)
    result = track(log)
    assert result.trajectory.tracked.all()
    assert position_errors(result, log).max() < 0.05


def test_dropped_frames_are_followed_by_their_time_stamps() -> None:
    kept = np.r_[0:8, 11:16, 17:24]
    log = MadeLog(curve(24)[kept])
    log.t_ns = kept.astype(np.int64) * 100_000_000
    result = track(log)
    assert result.trajectory.tracked.all()
    assert position_errors(result, log).max() < 0.06


def test_a_change_of_exposure_is_followed() -> None:
    def darker(left, right):
        return (left * 0.6 + 5).astype(np.uint8), (right * 0.6 + 5).astype(np.uint8)

    log = MadeLog(curve(20), changes=dict.fromkeys(range(9, 20), darker))
    result = track(log)
    assert result.trajectory.tracked.all()
    assert position_errors(result, log).max() < 0.06
    a = result.keyframes.affine[:, 0]
    assert a[-1] - a[0] == pytest.approx(np.log(0.6), abs=0.06)


def test_the_right_image_has_a_brightness_of_its_own() -> None:
    def right_brighter(left, right):
        return left, np.clip(right * 1.1 + 4, 0, 255).astype(np.uint8)

    result = track(MadeLog(curve(10), changes=dict.fromkeys(range(10), right_brighter)))
    affine = result.keyframes.affine
    np.testing.assert_allclose(affine[:, 2] - affine[:, 0], np.log(1.1), atol=0.03)


def test_colour_and_grey_logs_give_the_same_trajectory() -> None:
    grey, colour = (track(MadeLog(curve(8), colour=c)) for c in (False, True))
    np.testing.assert_array_equal(grey.trajectory.T_world_cam, colour.trajectory.T_world_cam)


@pytest.mark.parametrize(("width", "height"), [(333, 251), (64, 64), (480, 360), (641, 97)])
def test_images_of_any_size_are_tracked(width: int, height: int) -> None:
    f = 0.6 * width
    log = MadeLog(
        curve(8, 0.25), rig=StereoRig(PinholeCamera(f, f, (width - 1) / 2, (height - 1) / 2, width, height), (-0.5, 0.0, 0.0))
    )
    result = track(log)
    check_whole(result, 8)
    if min(width, height) > 64:
        assert result.trajectory.tracked.all()
        assert position_errors(result, log).max() < 0.05


def test_a_rig_whose_right_camera_is_not_level_is_respected() -> None:
    log = MadeLog(curve(12), rig=StereoRig(CAMERA, (-0.5, 0.02, 0.01)))
    assert position_errors(track(log), log).max() < 0.05


def test_one_frame_is_a_drive() -> None:
    result = track(MadeLog(curve(1)))
    check_whole(result, 1)
    assert len(result.keyframes) == 1


def test_progress_never_falls_and_ends_at_one() -> None:
    shares: list[float] = []
    track(MadeLog(curve(5)), progress=lambda share, what: shares.append(share))
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def test_impossible_rigs_and_wrong_sizes_are_refused_in_one_line() -> None:
    log = MadeLog(curve(3))
    with pytest.raises(CalibrationError, match="baseline"):
        track(replace(log, rig=StereoRig(CAMERA, (0.5, 0.0, 0.0))))
    with pytest.raises(CalibrationError, match="too small"):
        track(replace(log, rig=StereoRig(PinholeCamera(40, 40, 20, 20, 48, 40), (-0.5, 0.0, 0.0))))
    with pytest.raises(LogError, match="no stereo pair"):
        track(MadeLog(curve(0)))
    cut = MadeLog(curve(3), changes={2: lambda left, right: (left[:, :-1], right)})
    with pytest.raises(LogError, match="frame 2"):
        track(cut)
