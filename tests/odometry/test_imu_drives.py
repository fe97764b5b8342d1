"""Whole drives with an IMU through the made street: gravity and biases found, blind seconds survived, nothing lost by it."""

from dataclasses import dataclass, field
from functools import cache

import numpy as np
import pytest
from made_street import MadeLog, pair
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.logs.types import ImuTrack, StereoFrame
from wayloom.odometry.backend.stereo_scale import SpanScale, StereoScale
from wayloom.odometry.backend.window import Window
from wayloom.odometry.odometry import track
from wayloom.odometry.settings import ImuSettings, OdometrySettings
from wayloom.odometry.types import OdometryResult

F64 = NDArray[np.float64]
GRAVITY = np.array([0.25, 9.8, -0.4]) / np.linalg.norm([0.25, 9.8, -0.4]) * 9.81
"""m/s^2 in the world: the first camera looks a little up and leans."""
T_CAM_IMU = se3.exp(np.array([0.1, 0.5, -0.6, 1.0, -1.1, 1.2]))
BIAS = np.array([0.004, -0.003, 0.002, 0.06, -0.04, 0.05])
STEP_S, RATE_HZ = 1e-3, 200.0


def camera_pose(t_s: F64) -> F64:
    """T_world_cam (M, 4, 4) of a car at about 3.3 m/s that winds, nods and changes its speed; the identity at 0."""
    turn = np.stack([0.01 * np.sin(1.9 * t_s), 0.09 * np.sin(0.6 * t_s), 0.008 * np.sin(1.4 * t_s)], axis=-1)
    T = se3.exp(np.concatenate([np.zeros_like(turn), turn], axis=-1))
    T[..., 0, 3], T[..., 1, 3] = 0.5 * (1 - np.cos(0.6 * t_s)), 0.015 * np.sin(2.3 * t_s)
    T[..., 2, 3] = 3.3 * t_s + 0.5 * np.sin(0.8 * t_s)
    return T


def imu_track(seconds: float, seed: int = 3) -> ImuTrack:
    t = np.arange(0.0, seconds, 1 / RATE_HZ)
    before, now, after = (camera_pose(t + k * STEP_S) @ T_CAM_IMU for k in (-1, 0, 1))
    acceleration = (after[:, :3, 3] - 2 * now[:, :3, 3] + before[:, :3, 3]) / STEP_S**2
    force = np.einsum("mji,mj->mi", now[:, :3, :3], acceleration - GRAVITY)
    change = np.einsum("mji,mjk->mik", before[:, :3, :3], after[:, :3, :3])
    skew = change - change.swapaxes(1, 2)
    rate = np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1) / (4 * STEP_S)
    rng = np.random.default_rng(seed)
    noise = rng.normal(size=(2, len(t), 3)) * np.sqrt(RATE_HZ)
    return ImuTrack(np.rint(t * 1e9).astype(np.int64), force + BIAS[3:] + 2e-3 * noise[0], rate + BIAS[:3] + 1.5e-4 * noise[1])


@dataclass
class ImuLog(MadeLog):
    """The made street driven with an IMU."""

    imu: ImuTrack | None = None
    T_cam_imu: F64 = field(default_factory=lambda: T_CAM_IMU)

    def frame(self, index: int) -> StereoFrame:
        left, right = rendered(index)
        if index in self.changes:
            left, right = self.changes[index](left, right)
        return StereoFrame(index, int(self.t_ns[index]), left, right)


@cache
def rendered(index: int) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """The pair of a frame: all drives here go the same way."""
    left, right, _ = pair(camera_pose(np.array([0.1 * index]))[0])
    return np.rint(left).astype(np.uint8), np.rint(right).astype(np.uint8)


def drive(frames: int, **changes: object) -> ImuLog:
    return ImuLog(camera_pose(np.arange(frames) * 0.1), imu=imu_track(0.1 * frames), **changes)  # type: ignore[arg-type]


def position_errors(result: OdometryResult, log: MadeLog) -> F64:
    return np.linalg.norm(result.trajectory.T_world_cam[:, :3, 3] - log.truth[:, :3, 3], axis=1)


@pytest.fixture(scope="module")
def log() -> ImuLog:
    return drive(105)


@pytest.fixture(scope="module")
def result(log: ImuLog) -> OdometryResult:
    return track(log)


def test_gravity_is_found_within_half_a_degree_in_ten_seconds(result: OdometryResult) -> None:
    found = np.array(result.report["imu"]["gravity_world_m_s2"])
    angle = np.degrees(np.arccos(found @ GRAVITY / np.linalg.norm(found) / np.linalg.norm(GRAVITY)))
    assert angle < 0.5
    assert result.report["imu"]["started_s"][0] < 5.0


def test_the_gyroscope_bias_is_found(result: OdometryResult) -> None:
    assert np.abs(np.array(result.report["imu"]["gyroscope_bias_rad_s"]) - BIAS[:3]).max() < 0.001


def test_an_imu_never_makes_a_drive_worse(log: ImuLog) -> None:
    def rms(**changes: object) -> F64:
        found = [track(log, OdometrySettings.model_validate({"seed": seed, **changes})) for seed in range(3)]
        assert all(r.trajectory.tracked.all() and (r.report["imu"] is None) == bool(changes) for r in found)
        return np.array([np.sqrt((position_errors(r, log) ** 2).mean()) for r in found])

    with_imu, without = rms(), rms(imu=ImuSettings(use=False))
    assert with_imu.mean() < without.mean() + 2 * without.std(ddof=1) / np.sqrt(len(without))  # what the seeds alone may do


def test_a_blind_second_is_bridged() -> None:
    def black(left: NDArray[np.uint8], right: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        return np.zeros_like(left), np.zeros_like(right)

    blind = drive(90, changes=dict.fromkeys(range(60, 70), black))
    bridged, guessed = track(blind), track(blind, OdometrySettings(imu=ImuSettings(use=False)))
    assert not bridged.trajectory.tracked[60:70].any()
    assert bridged.trajectory.tracked[70:].all()
    assert [loss["frame"] for loss in bridged.report["losses"]] == list(range(60, 70))
    errors = position_errors(bridged, blind)
    assert errors.max() < 0.1  # of 3.3 m driven blind; 0.5 is what is asked for
    assert errors[60:70].max() < position_errors(guessed, blind)[60:70].max()


def test_samples_that_are_missing_for_a_while_only_leave_a_link_out(log: ImuLog) -> None:
    keep = np.ones(len(log.imu.t_ns), bool)
    keep[800:1000] = False  # one second
    gappy = ImuLog(log.truth[:70], imu=ImuTrack(log.imu.t_ns[keep], log.imu.specific_force[keep], log.imu.angular_rate[keep]))
    result = track(gappy)
    assert result.trajectory.tracked.all()
    assert position_errors(result, gappy).max() < 0.1


def test_a_clock_that_is_off_is_put_right_by_the_setting(log: ImuLog, result: OdometryResult) -> None:
    late = ImuLog(log.truth, imu=ImuTrack(log.imu.t_ns + 40_000_000, log.imu.specific_force, log.imu.angular_rate))
    right, wrong = (track(late, OdometrySettings(imu=ImuSettings(time_offset_s=offset))).report["imu"] for offset in (0.04, 0.0))
    assert right["started_s"] == result.report["imu"]["started_s"]
    np.testing.assert_allclose(right["gravity_world_m_s2"], result.report["imu"]["gravity_world_m_s2"], atol=0.005)
    assert not wrong["started_s"] or wrong["started_s"][0] > 2 * right["started_s"][0]  # what it feels does not fit what is seen


def test_static_stereo_is_asked_only_until_the_imu_is_in_use(log: ImuLog, monkeypatch: pytest.MonkeyPatch) -> None:
    def off(_self: StereoScale, window: Window, *_: object) -> SpanScale:
        return SpanScale(int(window.keyframe[-2]), int(window.keyframe[-1]), way_m=1.0, log_scale=0.3, sigma=0.01, votes=50)

    monkeypatch.setattr(StereoScale, "measure", off)
    drive = track(ImuLog(log.truth[:60], imu=log.imu))
    frames = drive.keyframes.frame
    until = (frames > 0) & (0.1 * frames <= drive.report["imu"]["started_s"][0] + 1e-6)
    assert 0 < until.sum() < len(frames) - 1
    assert drive.report["doubted_steps"] == until.sum()
