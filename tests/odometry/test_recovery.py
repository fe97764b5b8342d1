"""When an alignment is believed, and what is tried for a frame that motion alone does not explain."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from made_street import CAMERA, RIG, MadeLog, curve, pair

from wayloom.geometry import se3
from wayloom.odometry.odometry import track
from wayloom.odometry.settings import OdometrySettings
from wayloom.odometry.tracking import recovery, relocalisation
from wayloom.odometry.tracking.alignment import Alignment
from wayloom.odometry.types import OdometryResult

SETTINGS = OdometrySettings()


def fit(
    T: np.ndarray | None = None, gain: float = 1.0, rms: float = 5.0, visible: float = 0.9, saturated: float = 0.02
) -> Alignment:
    return Alignment(np.eye(4) if T is None else T, np.array([gain, 0.0]), rms, visible, saturated)


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        (fit(np.full((4, 4), np.nan)), "not finite"),
        (fit(visible=0.1), "10 % of the keyframe's points"),
        (fit(saturated=0.7), "70 % of the points fit worse"),
        (fit(gain=0.01), "0.01 times as bright"),
        (fit(rms=18.0), "fit to 18 grey levels only"),
        (fit(rms=np.inf), "not finite"),
    ],
)
def test_what_cannot_be_right_is_said_in_words(bad: Alignment, words: str) -> None:
    assert recovery.fit_failure(fit(), SETTINGS) is None
    assert words in str(recovery.fit_failure(bad, SETTINGS))


def test_turns_and_ways_that_no_vehicle_makes_are_failures() -> None:
    turn, way = (se3.exp(np.array(xi)) for xi in ((0, 0, 0, 0, 0.6, 0.0), (0, 0, -12.0, 0, 0, 0)))
    assert "a turn of 34.4 deg" in str(recovery.motion_failure(turn, np.eye(4), None, 0.1, SETTINGS))
    assert "a way of 12.00 m" in str(recovery.motion_failure(way, np.eye(4), None, 0.1, SETTINGS))
    assert recovery.motion_failure(way, np.eye(4), None, 1.0, SETTINGS) is None


def test_a_motion_far_from_the_expected_one_is_a_failure_only_where_one_is_expected() -> None:
    stop, expected = np.eye(4), se3.exp(np.array([0, 0, -1.0, 0, 0, 0]))
    assert "1.00 m from where constant motion leads" in str(recovery.motion_failure(stop, stop, expected, 0.1, SETTINGS))
    assert recovery.motion_failure(stop, stop, None, 0.1, SETTINGS) is None


def test_after_a_gap_half_an_image_is_not_believed_without_features() -> None:
    assert recovery.gap_failure(fit(saturated=0.45), 0.3, False) is None
    assert recovery.gap_failure(fit(saturated=0.2), 1.3, True) is None
    for since_s, follows_held in ((0.2, True), (10.0, False), (1.3, True)):
        why = str(recovery.gap_failure(fit(saturated=0.45), since_s, follows_held))
        assert f"after {since_s} s without a place 45 % of the points" in why


def test_the_motion_after_a_blind_second_is_that_between_frames_that_were_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    fast, slow = curve(10, 0.4), curve(12, 0.1)
    truth, expected = np.concatenate([fast, fast[-1] @ slow[1:]]), []
    original = recovery.Recovery.align

    def watched(self: recovery.Recovery, request: recovery.TrackingRequest, *rest: Any) -> recovery.TrackingResult:
        expected.append(se3.inverse(request.frame.T_predicted)[:3, 3])
        return original(self, request, *rest)

    monkeypatch.setattr(recovery.Recovery, "align", watched)
    blind = dict.fromkeys(range(10, 14), lambda left, right: (np.zeros_like(left), right))
    log = MadeLog(truth, changes=blind)
    result = track(log)
    assert np.flatnonzero(~result.trajectory.tracked).tolist() == [10, 11, 12, 13]
    after = expected[10]  # of frame 15, the second one that is seen again; the first frame is sought nowhere
    assert np.linalg.norm(after - log.truth[15, :3, 3]) < 0.05  # held frames lie 1.2 m ahead: with them it would be sought behind


def test_a_gain_without_a_change_of_contrast_is_a_failure() -> None:
    image = np.random.default_rng(0).integers(0, 120, (40, 60)).astype(np.uint8)
    assert recovery.gain_failure(fit(gain=0.2), image, image) is not None
    assert recovery.gain_failure(fit(gain=0.2), image // 5, image) is None
    assert recovery.gain_failure(fit(gain=1.3), image // 5, image) is None


@pytest.mark.parametrize("shrink", [1, 2])
def test_a_keyframe_is_found_again_by_its_features_from_elsewhere(shrink: int) -> None:
    T_world_there = se3.exp(np.array([0.4, 0.0, 2.0, 0.0, 0.25, 0.02]))
    left, right, _ = (image.round().astype(np.uint8) if i < 2 else image for i, image in enumerate(pair(np.eye(4))))
    there = (0.5 * pair(T_world_there)[0] + 20.0).round().astype(np.uint8)
    known = relocalisation.landmarks(left, right, RIG, 0.0, SETTINGS, shrink)
    found = relocalisation.sight(known, relocalisation.find_features(there, shrink), CAMERA.K)
    assert found is not None
    assert found.decisive
    difference = se3.log(found.T_frame_keyframe @ T_world_there)
    assert np.abs(difference[:3]).max() < 0.05
    assert np.abs(difference[3:]).max() < 0.01
    assert found.brightness[0] == pytest.approx(0.5, abs=0.1)
    assert found.brightness[1] == pytest.approx(20.0, abs=12.0)
    again = relocalisation.sight(known, relocalisation.find_features(there, shrink), CAMERA.K)
    assert again is not None
    np.testing.assert_array_equal(again.T_frame_keyframe, found.T_frame_keyframe)


@pytest.mark.parametrize("shrink", [1, 2])
def test_features_of_images_with_odd_sides_lie_alike_everywhere(shrink: int) -> None:
    spots, grid = np.full((201, 403), 90.0), np.mgrid[0:201, 0:403]
    places = np.array([[40.0, 30.0], [201.0, 100.0], [370.0, 170.0], [385.0, 40.0]])
    for u, v in places:
        spots += 120.0 * np.exp(-((grid[1] - u) ** 2 + (grid[0] - v) ** 2) / (2 * 6.0**2))
    found = relocalisation.find_features(spots.round().astype(np.uint8), shrink).uv
    off = np.array([found[np.linalg.norm(found - place, axis=1).argmin()] - place for place in places])
    assert np.abs(off).max() < 0.3 * shrink  # OpenCV's doubling of an image moves all by a quarter of a pixel
    assert np.ptp(off, axis=0).max() < 0.1


def test_large_images_are_tried_at_half_their_size_first() -> None:
    assert relocalisation.shrinks(np.zeros((376, 1241), np.uint8)) == (2, 1)
    assert relocalisation.shrinks(np.zeros((200, 320), np.uint8)) == (1,)


def test_an_image_of_another_place_is_not_taken_for_the_keyframe() -> None:
    left, right, _ = pair(np.eye(4))
    elsewhere = pair(se3.exp(np.array([0.0, 0.0, 12.0, 0.0, 2.6, 0.0])))[0]
    known = relocalisation.landmarks(left.round().astype(np.uint8), right.round().astype(np.uint8), RIG, 0.0, SETTINGS)
    found = relocalisation.sight(known, relocalisation.find_features(elsewhere.round().astype(np.uint8)), CAMERA.K)
    assert found is None or not found.decisive


def test_blank_images_have_no_features_and_match_nothing() -> None:
    none = relocalisation.find_features(np.full((100, 120), 90, np.uint8))
    assert len(none.uv) == len(none.descriptors) == 0
    assert relocalisation.matches(none, none).shape == (0, 2)


def test_matches_are_those_of_the_naive_search() -> None:
    rng = np.random.default_rng(3)
    ours = relocalisation.Features(np.zeros((30, 2)), rng.integers(0, 120, (30, 128)).astype(np.float32), np.zeros(30))
    shuffled = rng.permutation(30)[:20]
    noisy = np.clip(ours.descriptors[shuffled] + rng.integers(-30, 31, (20, 128)), 0, 255).astype(np.float32)
    theirs = relocalisation.Features(np.zeros((20, 2)), noisy, np.zeros(20))
    expected = []
    for i, a in enumerate(ours.descriptors):
        d = [float(((a - b) ** 2).sum()) for b in noisy]
        j = int(np.argmin(d))
        back = [float(((noisy[j] - b) ** 2).sum()) for b in ours.descriptors]
        clear = all(sorted(x)[0] < relocalisation.RATIO**2 * sorted(x)[1] for x in (d, back))
        if clear and int(np.argmin(back)) == i:
            expected.append([i, j])
    assert len(expected) > 10
    assert relocalisation.matches(ours, theirs).tolist() == expected


def errors(result: OdometryResult, log: MadeLog) -> np.ndarray:
    return np.linalg.norm(result.trajectory.T_world_cam[:, :3, 3] - log.truth[:, :3, 3], axis=1)


@pytest.mark.parametrize(("visible", "many", "asks"), [(0.8, 100, False), (0.5, 100, True), (0.8, 10_000, True)])
def test_the_first_motion_needs_features_only_where_little_of_the_keyframe_is_seen(
    visible: float, many: int, asks: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[int] = []
    log = MadeLog(curve(4, step_m=1.0))
    find, best = relocalisation.find_features, recovery.best_alignment
    monkeypatch.setattr(relocalisation, "find_features", lambda *a: (asked.append(1), find(*a))[1])
    monkeypatch.setattr(recovery, "MANY_POINTS", many)
    monkeypatch.setattr(recovery, "best_alignment", lambda *a: replace(best(*a), visible=visible))
    result = track(log)
    assert bool(asked) == asks
    assert result.trajectory.tracked.all()
    assert errors(result, log).max() < 0.02


def test_a_fast_turn_at_ten_hertz_is_followed() -> None:
    log = MadeLog(curve(10, step_m=0.3, yaw_step=0.12))  # 7 degrees a frame, a circle in five seconds
    result = track(log)
    assert result.trajectory.tracked.all()
    assert len(result.report["segments"]) == 1
    assert errors(result, log).max() < 0.1


@pytest.mark.parametrize(("large_px", "sizes"), [(relocalisation.LARGE_PX, {1}), (10_000, {2, 1})])
def test_a_second_of_blindness_in_a_curve_ends_where_the_car_is(
    large_px: int, sizes: set[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """By features, of large images at half their size first, and where these lead nowhere of the whole ones."""
    looked_at: list[int] = []
    find = relocalisation.find_features
    monkeypatch.setattr(relocalisation, "LARGE_PX", large_px)
    monkeypatch.setattr(relocalisation, "find_features", lambda image, shrink=1: (looked_at.append(shrink), find(image, shrink))[1])
    truth = curve(34, step_m=0.3, yaw_step=0.02)

    def black(left: np.ndarray, right: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return left * 0, right * 0

    log = MadeLog(truth, changes=dict.fromkeys(range(14, 24), black))
    result = track(log)
    assert np.flatnonzero(~result.trajectory.tracked).tolist() == list(range(14, 24))
    assert [loss["frame"] for loss in result.report["losses"]] == list(range(14, 24))
    assert len(result.report["segments"]) == 1
    assert errors(result, log)[24:].max() < 0.1
    assert set(looked_at) == sizes


def test_a_black_right_camera_costs_no_frame() -> None:
    log = MadeLog(curve(26), changes=dict.fromkeys(range(10, 20), lambda left, right: (left, right * 0)))
    result = track(log)
    assert result.trajectory.tracked.all()
    assert errors(result, log).max() < 0.1


def test_a_jump_of_exposure_is_no_loss() -> None:
    def dark(left: np.ndarray, right: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return (left * 0.22).astype(np.uint8), (right * 0.22).astype(np.uint8)

    log = MadeLog(curve(20), changes=dict.fromkeys(range(8, 14), dark))
    result = track(log)
    assert result.trajectory.tracked.all()
    assert errors(result, log).max() < 0.1


def test_a_car_that_stands_for_minutes_neither_drifts_nor_makes_keyframes() -> None:
    stand = np.r_[0:8, [7] * 60, 8:12]
    rng = np.random.default_rng(1)

    def noisy(left: np.ndarray, right: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return tuple(np.clip(image + rng.normal(0, 2, image.shape), 0, 255).astype(np.uint8) for image in (left, right))  # type: ignore[return-value]

    log = MadeLog(curve(12)[stand], changes=dict.fromkeys(range(len(stand)), noisy))
    result = track(log)
    assert result.trajectory.tracked.all()
    standing = result.trajectory.T_world_cam[8:68, :3, 3]
    assert np.linalg.norm(standing - standing[0], axis=1).max() < 0.01
    assert ((result.keyframes.frame > 8) & (result.keyframes.frame < 68)).sum() == 0


def test_a_drive_of_one_place_has_one_keyframe_its_points_and_every_pose() -> None:
    log = MadeLog(np.tile(np.eye(4), (6, 1, 1)))
    result = track(log)
    assert len(result.keyframes) == 1
    assert result.trajectory.tracked.all()
    assert np.abs(result.trajectory.T_world_cam - np.eye(4)).max() < 1e-3
    points = result.points
    assert len(points) > 300
    assert points.host_right.all()
    v, u = points.uv_host.astype(int).T[::-1]
    truth = pair(np.eye(4))[2][v, u]
    assert np.median(np.abs(points.inverse_depth - truth)) < 0.003
