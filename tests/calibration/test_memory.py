"""Epochs of a rig, and the file of each."""

from dataclasses import replace

import numpy as np
import pytest
from made_observations import CAMERA, LENS, made_drive

from wayloom.calibration.learn import learn_rig
from wayloom.calibration.memory import (
    ANOTHER_RIG,
    KNOCKED_CHI_SQUARE,
    Epoch,
    RememberedDrive,
    bias_sigma_px,
    contradiction,
    learn_epoch,
    split_epochs,
    sum_of,
)
from wayloom.calibration.rig_file import read_rig_file, text_of, write_rig_file
from wayloom.calibration.settings import CalibrationSettings
from wayloom.geometry.camera import StereoRig
from wayloom.geometry.lens import RightLens

KNOCKED = replace(LENS, pitch_rad=LENS.pitch_rad + 2e-3, yaw_rad=LENS.yaw_rad - 3e-3)
GROUP_PX = 0.05


def remembered(lens: RightLens, number: int, **more: object) -> RememberedDrive:
    """Drive `number`, recorded at that second."""
    observations = made_drive(lens, number, group_px=GROUP_PX, **more)  # type: ignore[arg-type]
    return RememberedDrive(f"{number:02}", number * 10**9, learn_rig([observations]).rig, lambda: observations)


@pytest.fixture(scope="module")
def worn() -> list[RememberedDrive]:
    return [remembered(LENS, k) for k in range(4)]


@pytest.fixture(scope="module")
def knocked() -> list[RememberedDrive]:
    return [remembered(KNOCKED, k) for k in (10, 11)]


def numbers(epochs: list[Epoch]) -> list[tuple[str, ...]]:
    return [epoch.ids for epoch in epochs]


def test_drives_of_one_rig_are_one_epoch_and_those_after_a_knock_another(
    worn: list[RememberedDrive], knocked: list[RememberedDrive]
) -> None:
    epochs = split_epochs([*worn, *knocked])
    assert numbers(epochs) == [("00", "01", "02", "03"), ("10", "11")]
    assert epochs[0].chi_square is None
    assert epochs[1].chi_square is not None
    assert epochs[1].chi_square > 10 * KNOCKED_CHI_SQUARE


def test_the_order_in_which_drives_come_changes_neither_epochs_nor_a_byte_of_the_file(
    worn: list[RememberedDrive], knocked: list[RememberedDrive]
) -> None:
    drives = [*worn, *knocked]
    other = [drives[k] for k in (5, 2, 0, 4, 3, 1)]
    assert numbers(split_epochs(drives)) == numbers(split_epochs(other))
    one, again = (text_of(learn_epoch(split_epochs(order)[0])) for order in (drives, other))
    assert one == again


def test_one_stray_drive_does_not_end_an_epoch(worn: list[RememberedDrive], knocked: list[RememberedDrive]) -> None:
    stray = replace(knocked[0], drive_id="stray", t_ns=worn[1].t_ns + 1)
    epochs = split_epochs([*worn, stray])
    assert numbers(epochs) == [("00", "01", "02", "03"), ("stray",)]
    assert [epoch.stray for epoch in epochs] == [False, True]


def test_a_drive_of_few_matches_begins_no_epoch(worn: list[RememberedDrive]) -> None:
    short = remembered(KNOCKED, 12, groups=4)
    assert numbers(split_epochs([*worn, short])) == [("00", "01", "02", "03", "12")]


def test_a_log_with_another_baseline_is_another_rig(worn: list[RememberedDrive]) -> None:
    long = remembered(LENS, 13, rig=StereoRig(CAMERA, (-0.7, 0.0, 0.0)))
    assert contradiction(long, Epoch(tuple(worn))) == ANOTHER_RIG


def test_drives_of_one_rig_hardly_ever_contradict_each_other() -> None:
    found = []
    for rig in range(6):
        drives = [remembered(LENS, 20 + 10 * rig + k) for k in range(3)]
        found.append(contradiction(drives[2], Epoch(tuple(drives[:2]))))
    assert max(found) < KNOCKED_CHI_SQUARE
    assert np.mean(found) < 20  # ten where sigmas are exact


def test_a_rig_knows_more_with_each_drive_and_keeps_to_its_sigmas(worn: list[RememberedDrive]) -> None:
    files = [learn_epoch(Epoch(tuple(worn[: k + 1]))) for k in range(4)]
    sizes = [float(np.linalg.norm(file.sigma / CalibrationSettings().lens.sigmas)) for file in files]
    assert sizes == sorted(sizes, reverse=True)
    z = (files[-1].lens.values - LENS.values) / files[-1].sigma
    assert np.abs(z).max() < 3.5


def test_the_sum_of_drives_says_what_they_say_together(worn: list[RememberedDrive]) -> None:
    together = learn_rig([drive.observations() for drive in worn]).rig
    summed = sum_of([drive.own for drive in worn])
    assert np.abs((summed.lens.values - together.lens.values) / together.sigma).max() < 0.5
    assert summed.drives == together.drives
    assert sum_of([drive.own for drive in (*worn, *worn)]).matches == summed.matches


def test_the_file_keeps_what_was_learnt(worn: list[RememberedDrive], tmp_path: object) -> None:
    rig = learn_epoch(Epoch(tuple(worn)))
    file = tmp_path / "RIG.toml"  # type: ignore[operator]
    write_rig_file(rig, file)
    again = read_rig_file(file)
    assert text_of(again) == text_of(rig)
    assert again.covariance is not None
    assert again.covariance.shape == (11, 11)


def test_the_spread_of_the_bias_is_the_upper_end_of_what_few_drives_allow() -> None:
    believed = CalibrationSettings().drive.disparity_bias_px
    assert bias_sigma_px([0.1]) == believed
    assert bias_sigma_px([0.3, -0.3]) == believed
    rng, covered = np.random.default_rng(0), 0
    for _ in range(400):
        covered += bias_sigma_px(list(0.02 * rng.normal(size=4))) > 0.02
    assert 0.92 < covered / 400 < 0.98
