"""A drive of a rig without a file learns the lens from its own first stretch, where there is one."""

from pathlib import Path

import numpy as np
import pytest
from made_rig import LENS, LensLog
from made_street import curve

from wayloom.calibration.own_lens import own_lens, track_calibrated
from wayloom.evaluation.recordings import ins_truth
from wayloom.evaluation.trajectory import evaluate
from wayloom.geometry.lens import IDENTITY, lens_field
from wayloom.logs.registry import open_log
from wayloom.odometry.odometry import track
from wayloom.odometry.settings import OdometrySettings

FRAMES = 30


def test_a_lens_shows_in_the_first_stretch() -> None:
    log = LensLog(curve(FRAMES), lens=LENS)
    found, true = (lens_field(lens, log.rig.camera, 20) for lens in (own_lens(log), LENS))
    error = found - true
    error -= error.mean(axis=(0, 1))  # rows and disparity bias of the drive take the rest
    assert np.sqrt((error**2).mean()) < 0.15 * np.sqrt(((true - true.mean(axis=(0, 1))) ** 2).mean())


def test_a_perfect_rig_stays_perfect_and_loses_nothing() -> None:
    log = LensLog(curve(20))
    assert own_lens(log) == IDENTITY
    np.testing.assert_array_equal(track_calibrated(log).trajectory.T_world_cam, track(log).trajectory.T_world_cam)


def test_a_car_that_stands_or_a_drive_too_short_tells_nothing() -> None:
    assert own_lens(LensLog(np.tile(np.eye(4), (6, 1, 1)), lens=LENS)) == IDENTITY


def test_a_known_lens_and_the_setting_keep_it_from_learning() -> None:
    log = LensLog(curve(8), lens=LENS)
    assert track_calibrated(log, lens=LENS).lens == LENS
    assert track_calibrated(log, OdometrySettings(learn_lens=False)).lens == IDENTITY


@pytest.mark.real_data
def test_clip_b_gains_its_length(clip_b: Path) -> None:
    log = open_log(clip_b)
    errors = evaluate(track_calibrated(log).trajectory.T_world_cam, ins_truth(clip_b, log))
    assert errors.ate_m < 0.28
    assert abs(errors.length_ratio - 1.0) < 0.01
