"""The quality report of a drive says what the drive was made to be."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from georeference.made_gnss_drives import MadeDrive, made_drive
from wayloom.errors import InputError
from wayloom.geometry import se3
from wayloom.georeference.alignment import georeference
from wayloom.georeference.types import GeoReference
from wayloom.loops.types import LoopClosures
from wayloom.pipeline.drive_quality import MOST, MOST_FIXES, drive_quality, read_quality, thinned, write_quality


@pytest.fixture(scope="module")
def drive() -> MadeDrive:
    return made_drive(sigma_m=0.05)


@pytest.fixture(scope="module")
def geo(drive: MadeDrive) -> GeoReference:
    return georeference(drive.log, drive.odometry)  # type: ignore[arg-type]


def test_the_report_gives_a_grade_its_reasons_and_every_series(drive: MadeDrive, geo: GeoReference, tmp_path: Path) -> None:
    quality = drive_quality(drive.odometry, geo)
    write_quality(tmp_path / "quality.json", quality)
    assert read_quality(tmp_path / "quality.json") == json.loads(json.dumps(quality)) == quality
    assert quality["grade"] == geo.report["grade"]
    sigma = np.linalg.norm(geo.report["sigma_enu_m"]["median"])
    assert quality["reasons"][0].startswith(f"sigma of the position {sigma:.2f} m in the median")
    assert quality["fixes"]["count"] == len(geo.fixes) == 200
    np.testing.assert_allclose(np.array(quality["fixes"]["residual_enu_m"]).T, geo.fixes.residual_enu, atol=5e-5)
    assert set(np.array(quality["fixes"]["sigma_enu_m"]).round(2).ravel()) == {0.05}
    assert quality["receiver"]["time_offset_s"] == geo.report["time_offset_s"]
    assert quality["loops"] is None


def test_the_drift_is_that_of_the_odometry_against_the_result(drive: MadeDrive, geo: GeoReference) -> None:
    stretched = drive.odometry.trajectory.T_world_cam.copy()
    turn = se3.exp(np.array([0.0, 0.0, 0.0, 0.0, np.radians(0.5) / 100.0, 0.0]))
    T = [np.eye(4)]
    for before, here in zip(geo.T_enu_cam[:-1], geo.T_enu_cam[1:], strict=True):
        step = se3.inverse(before) @ here
        step[:3, 3] *= 1.02
        T.append(T[-1] @ step @ turn)  # a metre a frame: half a degree in 100 m, and two per cent too long
    stretched = np.array(T)
    odometry = replace(drive.odometry, trajectory=replace(drive.odometry.trajectory, T_world_cam=stretched))
    drift = drive_quality(odometry, geo)["drift"]
    assert drift["over_m"] == pytest.approx(100.0, rel=0.02)
    assert drift["percent"]["median"] == pytest.approx(2.0, abs=0.15)  # the turn adds half of half a degree's chord across
    assert drift["deg_per_100m"]["median"] == pytest.approx(0.5, abs=0.02)
    assert drift["odometry_m"][-1] > 2.0


def test_a_drive_without_gnss_has_no_grade_no_drift_and_a_sigma_that_grows_from_its_start(drive: MadeDrive) -> None:
    log = replace(drive.log, gnss=None)
    quality = drive_quality(drive.odometry, georeference(log, drive.odometry))  # type: ignore[arg-type]
    assert (quality["placed"], quality["grade"], quality["fixes"], quality["drift"]) == (False, None, None, None)
    east = quality["track"]["sigma"]["enu_m"][0]
    assert east[0] < 0.01 < 0.1 < east[-1]
    assert quality["reasons"] == ["no GNSS: map in the drive's own frame"]


def test_the_ends_of_a_closure_are_the_places_of_its_keyframes(drive: MadeDrive, geo: GeoReference) -> None:
    first, second = np.array([0, 3], np.int32), np.array([40, 60], np.int32)
    loops = LoopClosures(first, second, np.tile(np.eye(4), (2, 1, 1)), np.tile(np.eye(6), (2, 1, 1)))
    found = drive_quality(drive.odometry, geo, loops)["loops"]
    assert found["count"] == 2
    ends = np.array(found["ends_m"])
    assert ends[:2, 0].tolist() == [0.0, 0.0]  # the first keyframe is where the plane begins
    frames = drive.odometry.keyframes.frame
    truth = np.linalg.norm(drive.T_place_cam[frames[second], :3, 3] - drive.T_place_cam[frames[first], :3, 3], axis=1)
    np.testing.assert_allclose(np.hypot(*(ends[2:] - ends[:2])), truth, atol=0.3)


def test_hours_are_thinned_and_no_rejected_fix_of_a_short_burst_is_lost(drive: MadeDrive, geo: GeoReference) -> None:
    count = 30_000
    used = np.ones(count, bool)
    used[12_345:12_365] = False
    fixes = replace(geo.fixes, t_ns=np.arange(count), residual_enu=np.zeros((count, 3)), sigma_enu=np.ones((count, 3)), used=used)
    quality = drive_quality(drive.odometry, replace(geo, fixes=fixes))
    assert len(quality["fixes"]["used"]) == MOST_FIXES + 20
    assert quality["fixes"]["count"] == count
    rows = thinned(1_000_000)
    assert (len(rows), rows[0], rows[-1]) == (MOST, 0, 999_999)
    assert np.diff(rows).max() <= np.diff(rows).min() + 1
    assert thinned(3).tolist() == [0, 1, 2]
    assert len(thinned(0)) == 0


def test_what_is_no_quality_report_is_refused(tmp_path: Path) -> None:
    for name, text in (("none", None), ("text", "{"), ("other", '{"format": "x"}')):
        if text is not None:
            (tmp_path / name).write_text(text)
        with pytest.raises(InputError, match="run the geo-reference stage again"):
            read_quality(tmp_path / name)
