import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

from georeference.made_gnss_drives import LEVER, PLACE, MadeDrive, made_drive, odometry_of
from wayloom.errors import StageError
from wayloom.evaluation.trajectory import relative_errors
from wayloom.geodesy import wgs84
from wayloom.geodesy.map_frame import map_frame_for
from wayloom.geometry import se3
from wayloom.georeference.alignment import georeference
from wayloom.georeference.settings import GeoReferenceSettings
from wayloom.georeference.types import Wanted
from wayloom.georeference.uncertainty import heading_sigma_rad, moved_covariance, position_covariance
from wayloom.logs.sidecars.oxts import UP_FACTOR
from wayloom.logs.types import FixType, GnssTrack
from wayloom.simulation.sensors.gnss import SIGMA_M, fix_errors, steps_in_force
from wayloom.simulation.vehicle.vehicle_settings import gnss_steps

FRAME = map_frame_for(PLACE.lon_deg, PLACE.lat_deg)
SYNCHRONISED = GeoReferenceSettings(time_offset_sigma_s=0.0002)
"""Receiver and cameras on one pulse: on a straight road at one speed sigma would hold the clock's."""


def position_errors(drive: MadeDrive, geo) -> np.ndarray:
    return geo.T_enu_cam[:, :3, 3] - drive.truth_in(geo.frame)[:, :3, 3]


def with_fixes(drive: MadeDrive, **changes) -> MadeDrive:
    return dataclasses.replace(drive, log=dataclasses.replace(drive.log, gnss=dataclasses.replace(drive.log.gnss, **changes)))


def moved_fixes(drive: MadeDrive, rows: slice, by: list[float]) -> MadeDrive:
    enu = wgs84.enu_from_lonlatheight(drive.log.gnss.lon_lat_height, PLACE)
    enu[rows] += by
    return with_fixes(drive, lon_lat_height=wgs84.lonlatheight_from_enu(enu, PLACE))


def test_a_perfect_drive_comes_to_its_exact_place():
    drive = made_drive(sigma_m=1e-4, drift=False)
    geo = georeference(drive.log, drive.odometry)
    assert geo.frame == FRAME
    assert np.abs(position_errors(drive, geo)).max() < 0.01
    rotation = se3.inverse(drive.truth_in(FRAME)) @ geo.T_enu_cam
    assert np.arccos(np.clip((np.trace(rotation[:, :3, :3], axis1=1, axis2=2) - 1) / 2, -1, 1)).max() < np.radians(0.3)


def test_rtk_fixes_give_centimetres_in_spite_of_drift():
    drive = made_drive(sigma_m=0.02)
    error = position_errors(drive, georeference(drive.log, drive.odometry))
    assert np.sqrt((error**2).sum(axis=1).mean()) < 0.06


def test_every_frame_gets_a_pose_and_the_path_has_no_steps():
    drive = made_drive(sigma_m=2.0, fix_every=10)
    geo = georeference(drive.log, drive.odometry)
    assert geo.T_enu_cam.shape == (200, 4, 4)
    steps = np.linalg.norm(np.diff(geo.T_enu_cam[:, :3, 3], axis=0), axis=1)
    assert np.abs(steps - np.linalg.norm(np.diff(drive.odometry.trajectory.T_world_cam[:, :3, 3], axis=0), axis=1)).max() < 0.15


def test_fixes_between_frames_count_at_their_own_time():
    """Fixes half-way between frames, on a fast drive: taken at the wrong frame they would be a metre off."""
    drive = made_drive(sigma_m=0.01, step_m=2.0, drift=False)
    T = drive.T_place_cam
    middle = T[:-1] @ se3.exp(0.5 * np.array([se3.log(step) for step in se3.inverse(T[:-1]) @ T[1:]]))
    antenna = middle[:, :3, :3] @ LEVER + middle[:, :3, 3]
    gnss = drive.log.gnss
    track = GnssTrack(
        gnss.t_ns[:-1] + 50_000_000,
        wgs84.lonlatheight_from_enu(antenna, PLACE),
        gnss.covariance_enu[:-1],
        gnss.fix_type[:-1],
    )
    drive = dataclasses.replace(drive, log=dataclasses.replace(drive.log, gnss=track))
    assert np.abs(position_errors(drive, georeference(drive.log, drive.odometry))).max() < 0.02


def test_wild_fixes_are_found_reported_and_left_out():
    drive = moved_fixes(made_drive(seed=3), slice(40, 70), [18.0, -6.0, 2.0])
    geo = georeference(drive.log, drive.odometry)
    assert [outlier["fix"] for outlier in geo.report["outliers"]] == list(range(40, 70))
    assert geo.report["fixes"]["rejected"] == 30
    assert np.linalg.norm(position_errors(drive, geo), axis=1).max() < 2.0


def test_an_outage_is_bridged_and_its_middle_is_less_certain():
    drive = made_drive(seed=4, frames=300, sigma_m=0.1)
    types = drive.log.gnss.fix_type.copy()
    types[70:210] = FixType.NONE
    drive = with_fixes(drive, fix_type=types)
    geo = georeference(drive.log, drive.odometry, settings=SYNCHRONISED)
    sigma = np.sqrt(np.trace(position_covariance(geo.T_enu_cam, geo.covariance), axis1=1, axis2=2))
    assert sigma[140] > 2.0 * sigma[40]
    assert np.linalg.norm(position_errors(drive, geo), axis=1)[140] < 3.0 * sigma[140]
    assert geo.report["fixes"]["unusable"] == {"no fix": 140}


def test_segments_after_a_loss_are_joined_by_gnss():
    drive = made_drive(seed=5, sigma_m=0.1, turn_rad=0.01)
    segment = np.zeros(200, np.int32)
    segment[100:] = 1
    T = drive.odometry.trajectory.T_world_cam.copy()
    T[100:] = T[99] @ se3.exp(np.array([5.0, 1.0, 9.0, 0.02, 0.6, -0.02])) @ se3.inverse(T[100]) @ T[100:]
    broken = dataclasses.replace(drive, odometry=odometry_of(drive.odometry.trajectory.t_ns, T, segment))
    assert np.linalg.norm(position_errors(broken, georeference(broken.log, broken.odometry)), axis=1).max() < 0.6


def test_a_drive_in_ten_pieces_is_put_together_again():
    drive = made_drive(seed=9, frames=300, sigma_m=0.3)
    rng = np.random.default_rng(9)
    segment = (np.arange(300) // 30).astype(np.int32)
    T = drive.odometry.trajectory.T_world_cam.copy()
    for start in range(30, 300, 30):
        jump = se3.exp(np.concatenate([rng.normal(size=3) * 3.0, rng.normal(size=3) * 0.2]))
        T[start:] = T[start] @ jump @ se3.inverse(T[start]) @ T[start:]
    broken = dataclasses.replace(drive, odometry=odometry_of(drive.odometry.trajectory.t_ns, T, segment))
    assert np.linalg.norm(position_errors(broken, georeference(broken.log, broken.odometry)), axis=1).max() < 1.5


def test_a_piece_without_any_fix_stays_near_its_neighbours_and_is_uncertain():
    drive = made_drive(seed=10, frames=150, sigma_m=0.1)
    types = drive.log.gnss.fix_type.copy()
    types[50:100] = FixType.NONE
    drive = with_fixes(drive, fix_type=types)
    segment = (np.arange(150) // 50).astype(np.int32)
    broken = dataclasses.replace(
        drive, odometry=odometry_of(drive.odometry.trajectory.t_ns, drive.odometry.trajectory.T_world_cam, segment)
    )
    geo = georeference(broken.log, broken.odometry)
    sigma = np.sqrt(np.trace(position_covariance(geo.T_enu_cam, geo.covariance), axis1=1, axis2=2))
    assert sigma[75] > 5.0
    assert np.linalg.norm(position_errors(broken, geo), axis=1)[75] < sigma[75]


def test_poses_that_are_not_finite_are_refused_by_frame():
    drive = made_drive(frames=20)
    drive.odometry.trajectory.T_world_cam[7, 0, 3] = np.inf
    with pytest.raises(StageError, match="frame 7 is not finite"):
        georeference(drive.log, drive.odometry)


def test_without_gnss_the_map_is_in_the_drives_own_level_frame_and_says_so():
    drive = made_drive()
    geo = georeference(dataclasses.replace(drive.log, gnss=None), drive.odometry)
    assert geo.frame is None
    T_own_world = geo.T_enu_cam @ se3.inverse(drive.odometry.trajectory.T_world_cam)
    assert np.allclose(T_own_world, T_own_world[0], atol=1e-3)
    assert np.abs(geo.T_enu_cam[0, :3, 3]).max() < 1e-6
    assert abs(geo.T_enu_cam[0, 0, 2]) < 1e-3
    assert np.degrees(np.arccos(-geo.T_enu_cam[:, 2, 1].mean())) < 3.0
    assert geo.report["messages"] == ["no GNSS: map in the drive's own frame"]


def test_fixes_none_of_which_can_be_used_are_as_no_gnss_and_the_reasons_are_counted():
    drive = made_drive()
    drive = with_fixes(drive, fix_type=np.zeros(200, np.uint8))
    geo = georeference(drive.log, drive.odometry)
    assert geo.frame is None
    assert geo.report["fixes"] == {"used": 0, "unusable": {"no fix": 200}}


def test_fixes_with_impossible_covariances_or_outside_the_drive_are_left_out():
    drive = made_drive(sigma_m=0.1)
    covariance, t_ns = drive.log.gnss.covariance_enu.copy(), drive.log.gnss.t_ns.copy()
    covariance[5], covariance[6] = np.nan, -np.eye(3)
    t_ns[190:] += 10_000_000_000
    geo = georeference(with_fixes(drive, covariance_enu=covariance, t_ns=t_ns).log, drive.odometry)
    assert geo.report["fixes"]["unusable"] == {"no usable covariance": 2, "outside the drive's time": 10}


def test_a_standing_vehicle_has_a_place_but_no_heading():
    drive = made_drive(frames=50, step_m=0.001, sigma_m=0.05)
    geo = georeference(drive.log, drive.odometry)
    assert "heading is hardly observed" in geo.report["messages"][0]
    assert np.degrees(heading_sigma_rad(geo.covariance)).min() > 10.0
    antenna = geo.T_enu_cam[:, :3, :3] @ LEVER + geo.T_enu_cam[:, :3, 3]
    truth = drive.truth_in(FRAME)
    assert np.linalg.norm(antenna - (truth[:, :3, :3] @ LEVER + truth[:, :3, 3]), axis=1).max() < 0.3


def test_a_straight_road_leaves_the_roll_to_gravity():
    drive = made_drive(seed=6, turn_rad=0.0, sigma_m=0.02, hills=0.0)
    geo = georeference(drive.log, drive.odometry)
    truth = drive.truth_in(FRAME)
    roll = se3.inverse(truth) @ geo.T_enu_cam
    assert np.abs(np.degrees(np.arctan2(roll[:, 1, 0], roll[:, 0, 0]))).max() < 5.0
    along = truth[100, :3, 2]
    sigma = np.degrees(np.sqrt(along @ geo.covariance[100, 3:, 3:] @ along))
    assert 1.0 < sigma < 4.0


def test_the_given_frame_is_used_and_changes_no_place_on_earth():
    drive = made_drive(seed=7)
    one = georeference(drive.log, drive.odometry)
    other = georeference(drive.log, drive.odometry, Wanted(map_frame_for(7.5, 48.5)))
    places = [wgs84.lonlatheight_from_enu(g.T_enu_cam[:, :3, 3], g.frame) for g in (one, other)]
    assert np.abs(places[0] - places[1])[:, :2].max() < 1e-12
    sigmas = [np.trace(position_covariance(g.T_enu_cam, g.covariance), axis1=1, axis2=2) for g in (one, other)]
    assert np.allclose(*sigmas, rtol=1e-4)


def test_equal_input_gives_equal_bits():
    drive = made_drive(seed=8)
    one, two = georeference(drive.log, drive.odometry), georeference(drive.log, drive.odometry)
    assert np.array_equal(one.T_enu_cam, two.T_enu_cam)
    assert np.array_equal(one.covariance, two.covariance)


def frame_errors(T: np.ndarray, T_truth: np.ndarray) -> np.ndarray:
    """(N - 1,) m: translation error of the motion from each frame to the next."""
    steps = np.arange(len(T) - 1)
    return relative_errors(T, T_truth, np.column_stack([steps, steps + 1]))[0]


def through_every_kind_of_fix(seed: int, scale: float, frames: int = 240) -> MadeDrive:
    """Fixed, float, none, single, fixed again, with the simulator's noise, which is not the noise that the graph assumes."""
    kinds = every_kind(frames)
    drive = made_drive(seed=seed, frames=frames, scale=scale)
    antenna = drive.T_place_cam[:, :3, :3] @ LEVER + drive.T_place_cam[:, :3, 3]
    sigma = np.array([SIGMA_M[FixType(kind)] for kind in kinds])[:, None] * [1.0, 1.0, UP_FACTOR]
    return with_fixes(
        drive,
        lon_lat_height=wgs84.lonlatheight_from_enu(antenna + fix_errors(kinds, 0.1, np.random.default_rng(seed)), PLACE),
        covariance_enu=np.einsum("ni,ij->nij", sigma**2, np.eye(3)),
        fix_type=kinds,
    )


@pytest.mark.parametrize(("seed", "scale"), [(0, 1.0), (1, 0.98), (2, 1.02), (3, 1.01)])
def test_the_geo_referenced_path_is_as_smooth_as_the_odometry(seed, scale):
    """Float and single fixes scatter by decimetres and metres; from frame to frame the odometry, at its scale, knows better."""
    drive = through_every_kind_of_fix(seed, scale)
    truth = drive.truth_in(FRAME)
    mapped = frame_errors(georeference(drive.log, drive.odometry).T_enu_cam, truth)
    at_scale = drive.odometry.trajectory.T_world_cam.copy()
    at_scale[:, :3, 3] *= scale
    tracked = frame_errors(at_scale, truth)
    assert np.median(mapped) < 1.5 * np.median(tracked)
    assert mapped.max() < 1.5 * tracked.max()


@pytest.mark.parametrize("by", [[1.5, 1.5, 0.0], [-2.0, 2.0, 1.0], [0.0, 3.0, 0.0]])
def test_single_fixes_that_are_metres_off_together_hardly_bend_the_path_between_fixed_ones(by):
    drive = made_drive(seed=12, frames=120, sigma_m=0.02, scale=1.015)
    single = slice(45, 75)
    drive = moved_fixes(drive, single, by)
    covariance = drive.log.gnss.covariance_enu.copy()
    covariance[single] = np.eye(3) * SIGMA_M[FixType.SINGLE] ** 2
    geo = georeference(with_fixes(drive, covariance_enu=covariance).log, drive.odometry)
    assert geo.report["fixes"]["rejected"] == 0
    assert np.linalg.norm(position_errors(drive, geo), axis=1).max() < 0.1


def test_the_report_states_the_scale_of_the_odometry():
    drive = made_drive(seed=13, frames=300, sigma_m=0.05, scale=0.985)
    scale = georeference(drive.log, drive.odometry).report["scale"]
    assert scale["mean"] == pytest.approx(0.985, abs=0.002)
    assert scale["least"] <= scale["mean"] <= scale["most"]
    assert 0.0 < scale["sigma"] < 0.01


def test_a_drive_with_a_single_fix_at_its_start_has_no_heading_and_still_a_place():
    drive = made_drive(seed=14, frames=600, sigma_m=0.1)
    types = np.zeros(600, np.uint8)
    types[0] = FixType.FIXED
    geo = georeference(with_fixes(drive, fix_type=types).log, drive.odometry)
    assert np.isfinite(geo.covariance).all()
    assert np.degrees(heading_sigma_rad(geo.covariance)).min() > 90.0


def nees_of(drive: MadeDrive, frame: int) -> float:
    """Normalised estimation error squared of the position: 3 in the mean for a perfect filter."""
    geo = georeference(drive.log, drive.odometry, settings=SYNCHRONISED)
    error = position_errors(drive, geo)[frame]
    return float(error @ np.linalg.solve(position_covariance(geo.T_enu_cam, geo.covariance)[frame], error))


def mean_nees(sigma_m: float, outage: bool, scale_of: Callable[[int], float | None]) -> float:
    """Of 60 drives with the noise that the graph assumes, judged at frame 70, the middle of an outage of 60 m if there is one."""
    nees = []
    for seed in range(60):
        drive = made_drive(300 + seed, frames=140, sigma_m=sigma_m, scale=scale_of(seed), correlation_s=20.0, white_share=0.5)
        if outage:
            types = drive.log.gnss.fix_type.copy()
            types[40:100] = FixType.NONE
            drive = with_fixes(drive, fix_type=types)
        nees.append(nees_of(drive, 70))
    return float(np.mean(nees))


@pytest.mark.parametrize("outage", [False, True])
@pytest.mark.parametrize("sigma_m", [0.1, 0.5])
def test_the_covariance_is_honest_where_the_odometrys_scale_wanders(sigma_m, outage):
    assert 2.5 < mean_nees(sigma_m, outage, lambda seed: None) < 3.5


@pytest.mark.parametrize("outage", [False, True])
@pytest.mark.parametrize("sigma_m", [0.03, 0.5])
def test_the_covariance_is_no_promise_too_much_where_the_scale_is_off_all_along(sigma_m, outage):
    """By 1 to 2 %, either way: a scale that stays is easier than one that wanders, so the claim may be cautious."""
    nees = mean_nees(sigma_m, outage, lambda seed: 1.0 + (-1) ** seed * np.random.default_rng(seed).uniform(0.01, 0.02))
    assert 1.8 < nees < 3.5


@pytest.mark.parametrize(("sigma_m", "fix_every"), [(0.03, 1), (0.5, 1), (2.0, 5)])
def test_the_covariance_is_honest_under_correlated_noise(sigma_m, fix_every):
    """Normalised estimation error squared of the position over many drives: 3 for a perfect filter, many times that where
    correlated fixes are taken as independent."""
    drives = (made_drive(seed=100 + seed, frames=120, sigma_m=sigma_m, fix_every=fix_every) for seed in range(25))
    assert 1.2 < np.mean([nees_of(drive, 60) for drive in drives]) < 5.0


def test_every_kind_of_fix_gives_its_own_accuracy_and_an_honest_covariance():
    errors, nees = [], []
    for seed in range(8):
        drive = through_every_kind_of_fix(900 + seed, scale=1.0 + 0.01 * (-1) ** seed, frames=400)
        geo = georeference(drive.log, drive.odometry)
        error = position_errors(drive, geo)
        errors.append((error**2).sum(axis=1))
        covariance = position_covariance(geo.T_enu_cam, geo.covariance)
        nees.append(np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[:, :, None])[:, :, 0]))
    rms = {part: np.sqrt(np.mean([e[rows] for e in errors])) for part, rows in PARTS.items()}
    assert rms["fixed"] < 0.08
    assert rms["fixed again"] < 0.08
    assert rms["float"] < 0.7
    assert rms["none"] < 1.6
    assert rms["single"] < 1.6
    assert 1.5 < np.mean(nees) < 6.0


EVERY_KIND = gnss_steps(
    (0.0, FixType.FIXED), (0.25, FixType.FLOAT), (0.4, FixType.NONE), (0.6, FixType.SINGLE), (0.8, FixType.FIXED)
)


def every_kind(frames: int) -> np.ndarray:
    """(frames,) FixType of frames that are spread evenly over a drive."""
    shares = np.arange(frames) / (frames - 1)
    return np.array([step.fix for step in steps_in_force(EVERY_KIND, shares)], np.uint8)


PARTS = {
    "fixed": slice(0, 100),
    "float": slice(100, 160),
    "none": slice(160, 240),
    "single": slice(240, 320),
    "fixed again": slice(320, 400),
}


def test_nothing_tracked_is_an_error_that_says_what_to_look_at():
    drive = made_drive(frames=20)
    drive.odometry.trajectory.tracked[:] = False
    with pytest.raises(StageError, match="tracked no frame"):
        georeference(drive.log, drive.odometry)


def test_faster_fixes_than_needed_are_thinned():
    drive = made_drive()
    geo = georeference(drive.log, drive.odometry, settings=GeoReferenceSettings(max_fix_rate_hz=2.0))
    assert geo.report["fixes"]["used"] == 40


@pytest.mark.parametrize("fixes", [1, 2, 3, 5])
def test_a_handful_of_fixes_is_enough_for_a_place(fixes):
    drive = made_drive(seed=11, frames=60, sigma_m=0.1)
    types = np.zeros(60, np.uint8)
    types[np.linspace(0, 59, fixes).astype(int)] = FixType.FIXED
    drive = with_fixes(drive, fix_type=types)
    geo = georeference(drive.log, drive.odometry)
    assert geo.report["fixes"]["used"] == fixes
    sigma = np.sqrt(np.trace(position_covariance(geo.T_enu_cam, geo.covariance), axis1=1, axis2=2))
    assert (np.linalg.norm(position_errors(drive, geo), axis=1) < 3.0 * sigma + 0.1).all()


def test_a_single_frame_has_a_place():
    drive = made_drive(frames=1)
    geo = georeference(drive.log, drive.odometry)
    assert geo.T_enu_cam.shape == (1, 4, 4)
    assert np.isfinite(geo.covariance).all()


def test_fixes_that_are_no_place_on_earth_are_left_out_and_counted():
    drive = made_drive(frames=60)
    odd = drive.log.gnss.lon_lat_height.copy()
    odd[10, 1], odd[20, 0] = 97.0, 400.0
    geo = georeference(with_fixes(drive, lon_lat_height=odd).log, drive.odometry)
    assert geo.report["fixes"]["unusable"] == {"no place on Earth": 2}


def test_what_joins_two_places_of_a_drive_is_as_sure_as_the_odometry_wherever_gnss_puts_both():
    """Fixes of 2 m that wander, a scale that is known: places 60 m apart err by metres, and alike."""
    drive = made_drive(sigma_m=2.0, turn_rad=0.005)
    anchors, settings = np.array([60, 120, 180]), SYNCHRONISED.model_copy(update={"scale_sigma": 0.002})
    geo = georeference(drive.log, drive.odometry, Wanted(anchors=anchors), settings)
    assert np.array_equal(geo.anchors.frame, anchors)
    assert geo.anchors.connected.all()
    for (a, b), cross in zip(((60, 120), (120, 180)), geo.anchors.cross, strict=True):
        both = np.block([[geo.covariance[a], cross], [cross.T, geo.covariance[b]]])
        assert np.linalg.eigvalsh(both)[0] > -1e-9 * np.abs(both).max()
        middle = np.eye(4)
        middle[:3, 3] = 0.5 * (geo.T_enu_cam[a] + geo.T_enu_cam[b])[:3, 3]
        step = moved_covariance(se3.inverse(middle), (geo.covariance[a] + geo.covariance[b] - cross - cross.T)[None])[0]
        own = position_covariance(geo.T_enu_cam[[a]], geo.covariance[[a]])[0]
        assert np.sqrt(np.diag(own)).min() > 0.5
        assert np.sqrt(np.diag(step)[:3]).max() < 0.25


def test_anchors_tell_where_the_track_was_lost_and_must_be_keyframes():
    drive = made_drive()
    segment = (np.arange(200) // 90).astype(np.int32)
    broken = odometry_of(drive.odometry.trajectory.t_ns, drive.odometry.trajectory.T_world_cam, segment)
    wanted = Wanted(anchors=np.array([30, 60, 120]))
    geo = georeference(drive.log, broken, wanted)
    assert geo.anchors.connected.tolist() == [True, False]
    without = dataclasses.replace(drive.log, gnss=None)
    assert georeference(without, broken, wanted).anchors.cross.shape == (2, 6, 6)
    broken.trajectory.tracked[61] = False
    with pytest.raises(StageError, match="frame 61 is no node"):
        georeference(drive.log, broken, Wanted(anchors=np.array([30, 61])))
