import dataclasses

import numpy as np
import pytest

from georeference.made_city_drives import (
    SMALL_WAY,
    city_drive,
    closures_of,
    gnss_of,
    start_at,
    with_bursts,
    with_outages,
)
from georeference.made_gnss_drives import MadeDrive
from wayloom.errors import StageError
from wayloom.geometry import se3
from wayloom.georeference.alignment import georeference
from wayloom.georeference.types import GeoReference, Wanted
from wayloom.georeference.uncertainty import position_covariance
from wayloom.logs.types import FixType
from wayloom.loops.types import LoopClosures

SMALL_M = 640.0


def with_gnss(drive: MadeDrive, gnss) -> MadeDrive:
    return dataclasses.replace(drive, log=dataclasses.replace(drive.log, gnss=gnss))


def errors(drive: MadeDrive, geo: GeoReference) -> np.ndarray:
    truth = start_at(drive.T_place_cam) if geo.frame is None else drive.truth_in(geo.frame)
    return geo.T_enu_cam[:, :3, 3] - truth[:, :3, 3]


def nees(geo: GeoReference, error: np.ndarray, first: int = 20) -> float:
    covariance = position_covariance(geo.T_enu_cam, geo.covariance)[first:]
    return float(np.einsum("ni,ni->n", error[first:], np.linalg.solve(covariance, error[first:, :, None])[:, :, 0]).mean() / 3.0)


@pytest.fixture(scope="module")
def way_home() -> MadeDrive:
    """540 m around a block to the start: 100 m of the first street again."""
    return city_drive([*SMALL_WAY[:-1], (0.0, 100.0)], seed=2)


def test_loops_bring_a_drive_without_gnss_home(way_home):
    closures = closures_of(way_home)
    alone = georeference(way_home.log, way_home.odometry)
    closed = georeference(way_home.log, way_home.odometry, closures=closures)
    again, first = int(closures.second[0]), int(closures.first[0])
    frames = way_home.odometry.keyframes.frame
    gap = closed.T_enu_cam[frames[again], :3, 3] - closed.T_enu_cam[frames[first], :3, 3]
    truth = way_home.T_place_cam[frames[again], :3, 3] - way_home.T_place_cam[frames[first], :3, 3]
    assert np.linalg.norm(gap) == pytest.approx(np.linalg.norm(truth), abs=0.2)
    assert np.linalg.norm(errors(way_home, closed)[frames[again], :2]) < 0.5 * np.linalg.norm(
        errors(way_home, alone)[frames[again], :2]
    )
    assert closed.report["loops"]["used"] == len(closures)


def test_closures_join_what_a_loss_of_tracking_parted(way_home):
    """The second half of the odometry lies elsewhere and turned, as after a loss; only loops know how both go together."""
    trajectory, keyframes = way_home.odometry.trajectory, way_home.odometry.keyframes
    half = len(trajectory) // 2
    lost = np.arange(len(trajectory)) >= half
    T = trajectory.T_world_cam.copy()
    T[lost] = T[half] @ se3.exp(np.array([3.0, 0.0, -8.0, 0.0, 0.4, 0.0])) @ se3.inverse(T[half]) @ T[lost]
    segment = lost.astype(np.int32)
    odometry = dataclasses.replace(
        way_home.odometry,
        trajectory=dataclasses.replace(trajectory, T_world_cam=T, segment=segment),
        keyframes=dataclasses.replace(keyframes, segment=segment[keyframes.frame]),
    )
    closures = closures_of(way_home)
    parted, joined = georeference(way_home.log, odometry), georeference(way_home.log, odometry, closures=closures)
    frames = keyframes.frame[[int(closures.first[0]), int(closures.second[0])]]
    truth = np.diff(way_home.T_place_cam[frames, :3, 3], axis=0)
    gap = [np.linalg.norm(np.diff(geo.T_enu_cam[frames, :3, 3], axis=0) - truth) for geo in (parted, joined)]
    assert gap[0] > 5.0
    assert gap[1] < 0.2
    assert joined.report["loops"]["used"] == len(closures)


def test_without_gnss_the_covariance_is_relative_to_the_start(way_home):
    geo = georeference(way_home.log, way_home.odometry, closures=closures_of(way_home))
    assert geo.frame is None
    sigma = np.sqrt(np.trace(position_covariance(geo.T_enu_cam, geo.covariance), axis1=1, axis2=2))
    assert sigma[0] < 0.01
    assert sigma[250] > sigma[540] > sigma[0]
    assert np.degrees(np.sqrt(geo.covariance[0, 5, 5])) < 0.01
    assert nees(geo, errors(way_home, geo)) < 1.4


def test_false_closures_are_refused_and_reported(way_home):
    closures = closures_of(way_home, false=15)
    geo = georeference(way_home.log, way_home.odometry, closures=closures)
    true = georeference(way_home.log, way_home.odometry, closures=closures_of(way_home))
    assert geo.report["loops"]["used"] == true.report["loops"]["used"]
    assert sum(group["closures"] for group in geo.report["loops"]["refused"]) == 15
    assert np.abs(errors(way_home, geo) - errors(way_home, true)).max() < 0.5


def test_a_false_closure_that_odometry_alone_would_take_is_refused_with_rtk():
    """It moves the second visit by 1.5 m, well within the drift of 640 m; fixes good to 2 cm deny it."""
    drive = city_drive(SMALL_WAY, seed=4)
    closures = closures_of(drive)
    moved = closures.T_first_second.copy()
    moved[:, 0, 3] += 1.5
    wrong = dataclasses.replace(closures, T_first_second=moved)
    alone = georeference(drive.log, drive.odometry, closures=wrong)
    assert alone.report["loops"]["used"] == len(closures)
    placed = with_gnss(drive, gnss_of(drive, FixType.FIXED, 4))
    geo = georeference(placed.log, placed.odometry, closures=wrong)
    assert geo.report["loops"]["used"] == 0
    assert np.linalg.norm(errors(placed, geo), axis=1).max() < 0.15


def test_loops_unmask_fixes_that_are_off_after_an_outage():
    """Behind an outage of 300 m nothing but the closures says that the fixes have gone astray by 4 m."""
    drive = city_drive(SMALL_WAY, seed=5)
    fixes, _ = with_outages(gnss_of(drive, FixType.FIXED, 5), [22.0], 30.0)
    placed = with_gnss(drive, with_bursts(fixes, [(52.0, 30.0, [3.0, -2.5, 1.0])]))
    without = georeference(placed.log, placed.odometry)
    geo = georeference(placed.log, placed.odometry, closures=closures_of(placed))
    assert np.linalg.norm(errors(placed, without)[560:], axis=1).min() > 2.0
    assert np.linalg.norm(errors(placed, geo)[560:], axis=1).max() < 0.5
    assert geo.report["fixes"]["rejected"] > 40


def test_an_rtk_drive_of_a_city_is_within_the_bounds():
    """The bounds that are asked of 5 km with RTK, outages and bursts, on 640 m; the odometry's scale as on simulated drives."""
    drive = city_drive(SMALL_WAY, seed=6, scale_sigma=0.002)
    fixes, gone = with_outages(with_bursts(gnss_of(drive, FixType.FIXED, 6), [(8.0, 5.0, [4.0, -3.0, 2.0])]), [25.0])
    placed = with_gnss(drive, fixes)
    geo = georeference(placed.log, placed.odometry, closures=closures_of(placed))
    norm, outage = np.linalg.norm(errors(placed, geo), axis=1), np.repeat(gone, 2)[: len(drive.T_place_cam)]
    assert np.sqrt((norm[~outage] ** 2).mean()) < 0.05
    assert np.sqrt((norm[outage] ** 2).mean()) < 0.3


def test_closures_of_another_run_are_refused(way_home):
    closures = closures_of(way_home)
    foreign = LoopClosures(closures.first, closures.second + 10_000, closures.T_first_second, closures.covariance)
    with pytest.raises(StageError, match="of different runs"):
        georeference(way_home.log, way_home.odometry, closures=foreign)


def test_equal_closures_give_equal_bits(way_home):
    one, two = (georeference(way_home.log, way_home.odometry, closures=closures_of(way_home)) for _ in range(2))
    assert one.T_enu_cam.tobytes() == two.T_enu_cam.tobytes()
    assert one.covariance.tobytes() == two.covariance.tobytes()


@pytest.mark.parametrize("with_fixes", [True, False])
def test_a_drive_whose_unknowns_are_eliminated_part_by_part_lies_where_it_does_as_a_whole(way_home, monkeypatch, with_fixes):
    log = way_home.log if with_fixes else dataclasses.replace(way_home.log, gnss=None)
    wanted = Wanted(anchors=np.array([3, 40, 90]))
    whole = georeference(log, way_home.odometry, wanted, closures=closures_of(way_home))
    monkeypatch.setattr("wayloom.mapping.drive_equations.MANY_NODES", 10)
    monkeypatch.setattr("wayloom.mapping.drive_equations.PART_NODES", 25)
    parts = georeference(log, way_home.odometry, wanted, closures=closures_of(way_home))
    np.testing.assert_allclose(parts.T_enu_cam, whole.T_enu_cam, atol=1e-6)
    np.testing.assert_allclose(parts.covariance, whole.covariance, rtol=1e-4, atol=1e-6 * np.abs(whole.covariance).max())
    assert whole.anchors is not None
    np.testing.assert_allclose(parts.anchors.cross, whole.anchors.cross, rtol=1e-4, atol=1e-6 * np.abs(whole.anchors.cross).max())
