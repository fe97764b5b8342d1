"""What is known of clock and lever arm: stated by the log, told by earlier drives, denied by the drive."""

from dataclasses import replace

import numpy as np
import pytest

from wayloom.calibration.receiver import ReceiverEvidence, learnt_receiver
from wayloom.evaluation.gnss_drives import LEVER_M, MadeDrive, Receiver, city_way, made_drive, straight_way
from wayloom.georeference.alignment import georeference
from wayloom.georeference.types import GeoReference
from wayloom.logs.types import StatedReceiver

ON_ONE_PULSE = StatedReceiver(0.0, 1e-3)
DAY_NS = 86_400 * 10**9


def stating(drive: MadeDrive, stated: StatedReceiver) -> MadeDrive:
    return replace(drive, log=replace(drive.log, receiver=stated))


def error_m(drive: MadeDrive, geo: GeoReference) -> float:
    assert geo.frame is not None
    error = geo.T_enu_cam[:, :3, 3] - drive.truth_in(geo.frame)[:, :3, 3]
    return float(np.sqrt((error**2).sum(axis=1).mean()))


def told(geo: GeoReference, name: str, day: int) -> ReceiverEvidence:
    return ReceiverEvidence.from_facts(name, day * DAY_NS, geo.report["receiver_told"])


def test_a_straight_drive_of_an_unknown_clock_is_unsure_along_the_road_and_says_what_would_help() -> None:
    drive = made_drive(straight_way(30.0), Receiver(), 0)
    geo = georeference(drive.log, drive.odometry)
    assert geo.report["grade"] == "C"
    (message,) = geo.report["messages"]
    assert "gnss_time_offset_sigma_s" in message
    assert "--rig" in message
    assert geo.report["receiver_told"] is None


def test_a_straight_drive_whose_log_states_its_clock_is_sure() -> None:
    drive = stating(made_drive(straight_way(30.0), Receiver(), 0), ON_ONE_PULSE)
    geo = georeference(drive.log, drive.odometry)
    assert (geo.report["grade"], geo.report["messages"], geo.report["receiver_known_by"]) == ("A", [], ["log"])
    assert error_m(drive, geo) < 0.1


def test_a_clock_that_is_late_by_what_the_log_states_costs_nothing() -> None:
    drive = stating(made_drive(straight_way(30.0, 15.0), Receiver(late_s=0.3), 0), StatedReceiver(0.3, 1e-3))
    geo = georeference(drive.log, drive.odometry)
    assert geo.report["grade"] == "A"
    assert geo.report["time_offset_s"] == pytest.approx(0.3, abs=0.003)
    assert error_m(drive, geo) < 0.1


def test_a_clock_that_is_stated_wrongly_is_found_where_the_drive_turns() -> None:
    late = made_drive(city_way(60.0), Receiver(late_s=0.05), 0)
    drive = stating(late, ON_ONE_PULSE)
    geo = georeference(drive.log, drive.odometry)
    assert geo.report["time_offset_s"] == pytest.approx(0.05, abs=0.01)
    assert any("denies the GNSS clock that the log states" in message for message in geo.report["messages"])
    assert error_m(drive, geo) < 0.15
    assert geo.report["time_offset_s"] == pytest.approx(georeference(late.log, late.odometry).report["time_offset_s"], abs=1e-4)


def test_a_lever_arm_that_is_given_wrongly_is_found_where_the_drive_turns() -> None:
    drive = stating(made_drive(city_way(60.0), Receiver(lever_error_m=(0.5, 0.0, 0.0)), 0), ON_ONE_PULSE)
    geo = georeference(drive.log, drive.odometry)
    assert any("denies the place of the antenna" in message for message in geo.report["messages"])
    assert geo.report["lever_correction_m"][0] == pytest.approx(-0.5, abs=0.1)


@pytest.mark.parametrize("late_s", [0.0, 0.05])
def test_a_straight_drive_is_sure_once_a_drive_with_turns_has_told_the_clock(late_s: float) -> None:
    first = made_drive(city_way(60.0), Receiver(late_s=late_s), 0)
    evidence = told(georeference(first.log, first.odometry), "first", 0)
    drive = made_drive(straight_way(30.0), Receiver(late_s=late_s), 1)
    geo = georeference(drive.log, drive.odometry, rig_receiver=[evidence])
    assert geo.report["grade"] == "A"
    assert geo.report["receiver_known_by"] == ["rig"]
    assert abs(geo.report["time_offset_s"] - late_s) < 3.0 * geo.report["sigma_time_offset_s"]
    assert error_m(drive, geo) < 0.2


def test_what_drives_tell_of_a_clock_is_honest() -> None:
    off = []
    for seed in range(6):
        drive = made_drive(city_way(45.0), Receiver(late_s=0.02), seed)
        learnt = learnt_receiver([told(georeference(drive.log, drive.odometry), "one", 0)])
        assert learnt is not None
        off.append((learnt.mean[0] - 0.02) / np.sqrt(learnt.covariance[0, 0]))
    assert np.abs(off).max() < 3.0
    assert np.sqrt(np.mean(np.square(off))) < 1.5


def test_the_antenna_that_no_log_gives_is_known_from_earlier_drives() -> None:
    first = made_drive(city_way(60.0), Receiver(lever_given=False), 0)
    evidence = told(georeference(first.log, first.odometry), "first", 0)
    drive = made_drive(straight_way(30.0), Receiver(lever_given=False), 1)
    alone = georeference(drive.log, drive.odometry)
    geo = georeference(drive.log, drive.odometry, rig_receiver=[evidence])
    across = np.array([geo.report["lever_correction_m"][0] - LEVER_M[0], geo.report["sigma_lever_m"][0]])
    assert abs(across[0]) < 3.0 * across[1]
    assert across[1] < 0.25 * alone.report["sigma_lever_m"][0]


def test_a_clock_that_was_changed_is_found_against_what_the_rig_says_and_begins_an_epoch() -> None:
    drives = [made_drive(city_way(60.0), Receiver(late_s=late_s), seed) for seed, late_s in enumerate((0.0, 0.06))]
    before = told(georeference(drives[0].log, drives[0].odometry), "before", 0)
    geo = georeference(drives[1].log, drives[1].odometry, rig_receiver=[before])
    assert any("the rig's earlier drives told" in message for message in geo.report["messages"])
    assert geo.report["time_offset_s"] == pytest.approx(0.06, abs=0.01)
    after = told(geo, "after", 1)
    newest, oldest = learnt_receiver([before, after]), learnt_receiver([after, before], DAY_NS // 2)
    assert newest is not None
    assert newest.epoch.ids == ("after",)
    assert newest.epoch.chi_square is not None
    assert oldest is not None
    assert oldest.epoch.ids == ("before",)


def test_earlier_drives_win_against_a_log_that_states_another_clock() -> None:
    first = made_drive(city_way(60.0), Receiver(late_s=0.08), 0)
    evidence = told(georeference(first.log, first.odometry), "first", 0)
    drive = stating(made_drive(straight_way(30.0), Receiver(late_s=0.08), 1), ON_ONE_PULSE)
    geo = georeference(drive.log, drive.odometry, rig_receiver=[evidence])
    assert any("earlier drives deny the GNSS clock that the log states" in message for message in geo.report["messages"])
    assert error_m(drive, geo) < 0.2
