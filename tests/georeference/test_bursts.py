"""GNSS errors that come in stretches: bursts, shifts for good, receivers that understate their scatter, unknown lever arms."""

import dataclasses

import numpy as np
import pytest

from georeference.made_gnss_drives import LEVER, PLACE, MadeDrive, correlated, made_drive
from wayloom.evaluation.gnss_cases import burst_case, nees, random_drive
from wayloom.evaluation.gnss_drives import Receiver, city_way
from wayloom.evaluation.gnss_drives import made_drive as city_drive
from wayloom.geodesy import wgs84
from wayloom.georeference.alignment import georeference
from wayloom.georeference.report import grade
from wayloom.georeference.types import GeoReference
from wayloom.georeference.uncertainty import position_covariance
from wayloom.simulation.sensors.gnss import burst_errors
from wayloom.simulation.vehicle.vehicle_settings import GnssBurst

RATE_HZ = 10.0


def with_errors(drive: MadeDrive, rows: slice, errors_enu: np.ndarray) -> MadeDrive:
    """The drive with errors (n, 3) m added to the fixes of rows."""
    gnss = drive.log.gnss
    assert gnss is not None
    enu = wgs84.enu_from_lonlatheight(gnss.lon_lat_height, PLACE)
    enu[rows] += errors_enu
    moved = dataclasses.replace(gnss, lon_lat_height=wgs84.lonlatheight_from_enu(enu, PLACE))
    return dataclasses.replace(drive, log=dataclasses.replace(drive.log, gnss=moved))


def errors_and_sigmas(drive: MadeDrive, geo: GeoReference) -> tuple[np.ndarray, np.ndarray]:
    """(N,) m each: error of the position, root of the trace of its covariance."""
    assert geo.frame is not None
    error = np.linalg.norm(geo.T_enu_cam[:, :3, 3] - drive.truth_in(geo.frame)[:, :3, 3], axis=1)
    return error, np.sqrt(np.trace(position_covariance(geo.T_enu_cam, geo.covariance), axis1=1, axis2=2))


def rtk(seed: int, seconds: int) -> MadeDrive:
    return made_drive(seed, frames=int(RATE_HZ) * seconds, sigma_m=0.02, scale=1.001, correlation_s=8.0, white_share=0.7)


@pytest.mark.parametrize("size_m", [0.5, 2.0, 15.0, 50.0])
@pytest.mark.parametrize(("start_s", "length_s", "seconds"), [(0, 4, 30), (13, 4, 30), (26, 4, 30), (20, 10, 50)])
def test_a_burst_of_constant_errors_is_found_from_end_to_end(size_m: float, start_s: int, length_s: int, seconds: int) -> None:
    rows = slice(start_s * 10, (start_s + length_s) * 10)
    drive = with_errors(rtk(1, seconds), rows, size_m * np.array([0.6, -0.8, 0.0]))
    geo = georeference(drive.log, drive.odometry)
    error, sigma = errors_and_sigmas(drive, geo)
    assert [outlier["fix"] for outlier in geo.report["outliers"]] == list(range(rows.start, rows.stop))
    assert len(geo.report["shifted"]) == 1
    assert np.allclose(geo.report["shifted"][0]["offset_enu_m"], size_m * np.array([0.6, -0.8, 0.0]), atol=0.3)
    assert np.sqrt((error**2).mean()) < 0.1
    assert (error < 3.0 * sigma).all()


@pytest.mark.parametrize("size_m", [2.0, 15.0, 50.0])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_burst_that_wanders_is_found(size_m: float, seed: int) -> None:
    rows = slice(120, 180)
    burst = GnssBurst(share=0.4, duration_s=6.0, size_m=size_m)
    drive = with_errors(rtk(seed, 30), rows, burst_errors(burst, 60, 1.0 / RATE_HZ, np.random.default_rng(seed)))
    error, sigma = errors_and_sigmas(drive, georeference(drive.log, drive.odometry))
    assert np.sqrt((error**2).mean()) < 0.1
    assert (error < 3.0 * sigma).all()


def test_a_first_guess_that_was_right_is_not_left_for_a_worse_one() -> None:
    drive = made_drive(2, frames=300, sigma_m=0.5, scale=1.001, correlation_s=8.0, white_share=0.7)
    drive = with_errors(drive, slice(180, 300), np.array([70.0, 70.0, 0.0]))
    geo = georeference(drive.log, drive.odometry)
    error, sigma = errors_and_sigmas(drive, geo)
    assert error.max() < 2.0
    assert (error < 3.0 * sigma).all()
    assert any("once and for all" in message for message in geo.report["messages"])


def test_fixes_that_change_place_for_good_widen_the_sigma_by_what_may_be_wrong() -> None:
    drive = with_errors(rtk(3, 30), slice(200, 300), np.array([1.5, 0.0, 0.0]))
    geo = georeference(drive.log, drive.odometry)
    error, sigma = errors_and_sigmas(drive, geo)
    assert error.max() < 0.5
    assert 0.5 < np.median(sigma) < 1.5  # a third of the fixes says that it lies 1.5 m elsewhere
    assert geo.report["grade"] in "CDE"


def test_a_receiver_that_understates_its_scatter_is_found_out() -> None:
    drive = made_drive(4, frames=300, sigma_m=0.02, fix_every=2, scale=1.001)
    t_s = np.arange(150) / 5.0
    wrong = correlated(t_s, 1.6, 8.0, 0.7, np.random.default_rng(4))
    drive = with_errors(drive, slice(0, 150), wrong)
    geo = georeference(drive.log, drive.odometry)
    error, sigma = errors_and_sigmas(drive, geo)
    assert geo.report["scatter_ratio"]["single"] > 20.0
    assert any("scatter" in message for message in geo.report["messages"])
    assert (error < 3.0 * sigma).all()


def test_an_honest_receiver_is_left_alone() -> None:
    geo = georeference((drive := rtk(5, 30)).log, drive.odometry)
    assert geo.report["scatter_ratio"] == {}
    assert geo.report["shifted"] == []
    assert geo.report["messages"] == []
    assert geo.report["grade"] == "A"


def test_a_lever_arm_that_is_not_given_is_found_where_the_drive_turns() -> None:
    drive = rtk(6, 30)
    drive = dataclasses.replace(drive, log=dataclasses.replace(drive.log, p_cam_gnss=np.zeros(3)))
    geo = georeference(drive.log, drive.odometry)
    error, sigma = errors_and_sigmas(drive, geo)
    found, lever_sigma = np.array(geo.report["lever_correction_m"]), np.array(geo.report["sigma_lever_m"])
    assert (np.abs(found - LEVER) < 3.0 * lever_sigma).all()
    assert abs(found[2] - LEVER[2]) < 0.5  # forward; how high the antenna is, a flat road does not tell
    assert (error < 3.0 * sigma).all()


def test_the_grade_falls_with_sigma_and_with_each_doubt() -> None:
    assert [grade(sigma, 0) for sigma in (0.05, 0.2, 0.5, 2.0, 10.0)] == list("ABCDE")
    assert [grade(0.05, doubts) for doubts in (0, 1, 2, 9)] == list("ABCE")


def test_a_clock_that_a_straight_road_cannot_tell_gets_a_word_and_one_that_corners_tell_none() -> None:
    straight = made_drive(1, frames=300, sigma_m=0.02, turn_rad=0.0, scale=1.001, correlation_s=8.0, white_share=0.7)
    said = georeference(straight.log, straight.odometry).report["messages"]
    assert len(said) == 1
    assert "hardly tells how late the GNSS clock is" in said[0]
    drive = city_drive(city_way(60.0), Receiver(late_s=0.02), 0)
    said = georeference(drive.log, drive.odometry).report["messages"]  # type: ignore[arg-type]
    assert not any("hardly tells" in message for message in said)


def test_two_bursts_about_an_outage_are_told_from_the_fixes_after_them() -> None:
    """One turn of two runs away from what the two descents find: the sigma of the wrong one was a seventh of its error."""
    drive = random_drive(33)
    assert nees(drive, georeference(drive.log, drive.odometry)).mean() < 3.0


def test_a_burst_between_pieces_that_agree_with_each_other_is_in_doubt() -> None:
    """Good for 1.5 s, 3 m off for twelve, good for half a second, then nothing for half a minute: it was 82 sigmas off."""
    drive = random_drive(90)
    geo = georeference(drive.log, drive.odometry)
    error, sigma = errors_and_sigmas(drive, geo)
    assert (error < 3.0 * sigma).all()


@pytest.mark.parametrize(("size_m", "seed"), [(1.0, 0), (1.0, 1), (3.0, 1), (15.0, 1)])
def test_a_ramp_is_left_out_with_its_foot(size_m: float, seed: int) -> None:
    """Its foot was believed, up to thirteen sigmas off, where the scale of the odometry could explain it."""
    ramp = (GnssBurst(share=0.4, duration_s=20.0, size_m=size_m, wander_share=0.0, ramp_s=8.0),)
    drive = city_drive(city_way(100.0), Receiver(bursts=ramp), seed)
    geo = georeference(drive.log, drive.odometry)
    error, sigma = errors_and_sigmas(drive, geo)
    assert np.sqrt((error**2).mean()) < 0.35
    assert (error < 3.0 * sigma).all()
    assert geo.report["shifted"][0]["from_s"] < 41.0


def test_a_clock_late_by_a_fifth_of_a_second_is_found_where_the_way_bends() -> None:
    drive = city_drive(city_way(60.0), Receiver(late_s=0.2), 0)
    geo = georeference(drive.log, drive.odometry)
    error, sigma = errors_and_sigmas(drive, geo)
    assert geo.report["time_offset_s"] == pytest.approx(0.2, abs=0.01)
    assert (error < 3.0 * sigma).all()


def test_a_wandering_burst_costs_no_more_than_the_fixes_that_it_spoils() -> None:
    case = burst_case(3.0, 20.0, 0.2)
    assert case.told is not None
    errors = []
    for drive in (case.drive(0), case.told(0)):
        error, _ = errors_and_sigmas(drive, georeference(drive.log, drive.odometry))
        errors.append(np.sqrt((error**2).mean()))
    assert errors[0] < 1.1 * errors[1]
