"""A drive of a rig that nobody has calibrated finds its lens in its own images; one of a perfect rig loses nothing."""

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from made_rig import LENS, LensLog
from made_street import MadeLog, curve

from wayloom.calibration.learn import field_size
from wayloom.calibration.self_calibration import (
    BIAS_SIGMA_PX,
    GROUPS,
    LEAST_GROUPS,
    sampled_observations,
    self_calibrated_lens,
    track_calibrated,
)
from wayloom.evaluation.recordings import ins_truth
from wayloom.evaluation.trajectory import evaluate
from wayloom.geometry.lens import IDENTITY, lens_from_values
from wayloom.logs.registry import open_log
from wayloom.logs.types import DriveLog
from wayloom.odometry.odometry import track
from wayloom.odometry.settings import OdometrySettings

FRAMES = 100


def way_off(log: DriveLog, T_world_cam: np.ndarray) -> float:
    """By what share of itself the way is longer than the true one."""
    assert log.truth is not None
    lengths = [np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1).sum() for T in (T_world_cam, log.truth)]
    return float(lengths[0] / lengths[1]) - 1.0


def test_a_bent_rig_is_straightened_by_the_drives_own_images() -> None:
    log = LensLog(curve(FRAMES), lens=LENS)
    plain, calibrated = track(log), track_calibrated(log)
    assert calibrated.report["self_calibration"]["used"]
    assert abs(calibrated.disparity_bias_px) < 3 * BIAS_SIGMA_PX < 0.2 < abs(plain.disparity_bias_px)
    field = field_size(lens_from_values(calibrated.lens.values - LENS.values + IDENTITY.values), log.rig.camera)[1]
    assert field < 0.2 * field_size(LENS, log.rig.camera)[1]
    assert abs(way_off(log, calibrated.trajectory.T_world_cam)) < 0.3 * abs(way_off(log, plain.trajectory.T_world_cam))


def test_a_perfect_rig_is_tracked_as_it_is_to_the_bit() -> None:
    log = MadeLog(curve(FRAMES))
    found = track_calibrated(log)
    assert found.report["self_calibration"] | {"chi_square": 0, "moves_px": 0} == {
        "used": False, "why": "nothing speaks against the log's calibration",
        "match_groups": found.report["self_calibration"]["match_groups"], "chi_square": 0, "moves_px": 0,
    }  # fmt: skip
    assert found.report["self_calibration"]["chi_square"] < 20
    np.testing.assert_array_equal(found.trajectory.T_world_cam, track(log).trajectory.T_world_cam)


def test_too_short_a_drive_keeps_its_calibration_and_says_so() -> None:
    found = self_calibrated_lens(LensLog(curve(20), lens=LENS))
    assert found.lens.is_ideal
    assert found.groups < LEAST_GROUPS
    assert "too few" in found.reason


def test_a_lens_that_is_given_or_a_setting_forbids_to_learn_one() -> None:
    log = LensLog(curve(12), lens=LENS)
    given = track_calibrated(log, lens=LENS)
    assert given.lens == LENS
    assert "self_calibration" not in given.report
    assert track_calibrated(log, OdometrySettings(self_calibration=False)).lens == IDENTITY


def test_what_a_dark_part_lacks_the_others_make_good_with_any_number_of_threads() -> None:
    log = MadeLog(curve(FRAMES, 1.6, 0.01), changes={frame: lambda left, right: (0 * left, 0 * right) for frame in range(33)})
    one, two = (sampled_observations(log, OdometrySettings(), threads=threads) for threads in (1, 2))
    assert one.groups == GROUPS
    assert one.host_frame.min() >= 33
    assert one.host_frame.max() >= 66
    for kept in fields(one):
        np.testing.assert_equal(getattr(two, kept.name), getattr(one, kept.name))


@pytest.mark.real_data
def test_clip_b_comes_out_as_long_as_its_ins_says(clip_b: Path) -> None:
    log = open_log(clip_b)
    errors = evaluate(track_calibrated(log).trajectory.T_world_cam, ins_truth(clip_b, log))
    assert errors.length_ratio == pytest.approx(1.0, abs=0.01)
    assert errors.ate_m < 0.28


@pytest.mark.real_data
def test_the_same_lens_is_found_twice(clip_b: Path) -> None:
    log = open_log(clip_b)
    assert self_calibrated_lens(log).lens == self_calibrated_lens(log).lens != IDENTITY
