"""Fixes that do not belong to the drive give it no place; bad fixes of the drive itself do."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

from wayloom.evaluation.gnss_drives import PLACE, RATE_HZ, MadeDrive, Receiver, city_way, made_drive
from wayloom.geodesy import wgs84
from wayloom.georeference.alignment import georeference
from wayloom.logs.types import FixType
from wayloom.pipeline.drive_quality import is_sound

SECONDS = 60.0
KINDS = [FixType.FIXED, FixType.SINGLE]


def drive_of(fix: FixType, seed: int = 0, seconds: float = SECONDS) -> MadeDrive:
    return made_drive(city_way(seconds), Receiver(fix), seed)


def fixes_enu(drive: MadeDrive) -> np.ndarray:
    assert drive.log.gnss is not None
    return wgs84.enu_from_lonlatheight(drive.log.gnss.lon_lat_height, PLACE)


def with_fixes_at(drive: MadeDrive, enu: np.ndarray) -> MadeDrive:
    assert drive.log.gnss is not None
    gnss = dataclasses.replace(drive.log.gnss, lon_lat_height=wgs84.lonlatheight_from_enu(enu, PLACE))
    return dataclasses.replace(drive, log=dataclasses.replace(drive.log, gnss=gnss))


def circle(drive: MadeDrive, fix: FixType) -> np.ndarray:
    angle = 0.13 * np.arange(len(fixes_enu(drive))) / RATE_HZ
    return np.column_stack([100.0 * np.cos(angle), 100.0 * np.sin(angle), np.zeros(len(angle))])


def another_drive(drive: MadeDrive, fix: FixType) -> np.ndarray:
    count = len(fixes_enu(drive))
    return fixes_enu(drive_of(fix, 7, SECONDS + 60.0))[-count:]


def reversed_drive(drive: MadeDrive, fix: FixType) -> np.ndarray:
    return fixes_enu(drive)[::-1]


def stuck(drive: MadeDrive, fix: FixType) -> np.ndarray:
    return np.zeros_like(fixes_enu(drive))


def nowhere(drive: MadeDrive, fix: FixType) -> np.ndarray:
    return np.random.default_rng(0).normal(size=fixes_enu(drive).shape) * 100.0


@pytest.mark.parametrize("fix", KINDS)
@pytest.mark.parametrize("nonsense", [circle, another_drive, reversed_drive, stuck, nowhere])
def test_fixes_that_are_not_of_the_drive_give_it_no_place(nonsense: Callable[..., np.ndarray], fix: FixType) -> None:
    drive = drive_of(fix)
    geo = georeference((drive := with_fixes_at(drive, nonsense(drive, fix))).log, drive.odometry)  # type: ignore[arg-type]
    assert geo.frame is None
    assert geo.report["grade"] == "E"
    assert "not placed" in geo.report["messages"][0]
    assert is_sound(geo.report, drive.odometry.trajectory), "nothing speaks against the odometry: other drives may place it"
    assert geo.report["fixes"] == {"in_log": 600, "used": 0, "rejected": 600, "unusable": {}}


def test_a_clock_that_is_wrong_beyond_belief_is_said_to_be_so() -> None:
    drive = made_drive(city_way(SECONDS), Receiver(late_s=0.5), 0)
    geo = georeference(drive.log, drive.odometry)  # type: ignore[arg-type]
    assert geo.frame is None
    assert "s or more late" in geo.report["messages"][0]


@pytest.mark.parametrize(
    "receiver",
    [
        Receiver(FixType.SINGLE),
        Receiver(FixType.SINGLE, stated_ratio=0.0125),
        Receiver(late_s=0.08),
        Receiver(FixType.FLOAT, shift_from=0.6, shift_enu_m=(70.0, 70.0, 0.0)),
    ],
)
def test_bad_fixes_of_the_drive_itself_still_place_it(receiver: Receiver) -> None:
    drive = made_drive(city_way(SECONDS), receiver, 0)
    assert georeference(drive.log, drive.odometry).frame is not None  # type: ignore[arg-type]


def test_fixes_of_a_drive_that_stands_are_its_own_however_they_scatter() -> None:
    drive = drive_of(FixType.SINGLE)
    standing = np.tile(drive.T_place_cam[:1], (300, 1, 1))
    drive = made_drive(standing, Receiver(FixType.SINGLE, stated_ratio=0.0125), 1)
    assert georeference(drive.log, drive.odometry).frame is not None  # type: ignore[arg-type]


def test_fixes_most_of_which_contradict_the_odometry_are_laid_aside_as_a_whole_and_shown() -> None:
    """Three of five stretches of 3 s lie metres off: those that agree would place it, and nothing says that they are right."""
    drive = drive_of(FixType.FIXED, seconds=30.0)
    enu = fixes_enu(drive)
    stretch = np.arange(len(enu)) // 30
    off = np.random.default_rng(1).normal(size=(11, 3)) * [3.0, 3.0, 5.0]
    log = with_fixes_at(drive, enu + off[stretch] * (stretch % 5 > 1)[:, None]).log
    geo, alone = (georeference(one, drive.odometry) for one in (log, dataclasses.replace(log, gnss=None)))  # type: ignore[arg-type]
    assert geo.frame is None
    assert geo.report["messages"][0].startswith(
        "180 of 300 fixes contradict the odometry: one of the two is wrong, and all are laid aside"
    )
    assert geo.report["grade"] == "E"
    assert is_sound(geo.report, drive.odometry.trajectory)
    np.testing.assert_array_equal(geo.T_enu_cam, alone.T_enu_cam, "no fix bends it")
    assert len(geo.fixes) == 300
    assert not geo.fixes.used.any()
