"""Clips A and B put on Earth with the GNSS/INS logs of their drives, with fixes that are thinned, missing or thrown away."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from georeference.made_gnss_drives import MadeLog, odometry_of
from wayloom.geodesy import wgs84
from wayloom.geodesy.map_frame import MapFrame
from wayloom.georeference.alignment import georeference
from wayloom.georeference.types import Wanted
from wayloom.georeference.uncertainty import position_covariance
from wayloom.logs.registry import open_log
from wayloom.logs.types import GnssTrack

pytestmark = pytest.mark.real_data
FAULTY_A = 16
"""Frames at the start of clip A where the INS moves at a constant speed while the images, and its own velocity, accelerate."""


@pytest.fixture(scope="module")
def log(clip_a, clip_a_gnss):
    return open_log(clip_a, gnss=clip_a_gnss)


@pytest.fixture(scope="module")
def odometry(log, data_dir):
    rows = np.loadtxt(data_dir / "kitti_odometry" / "poses" / "00.txt")[: len(log)].reshape(-1, 3, 4)
    T = np.tile(np.eye(4), (len(log), 1, 1))
    T[:, :3] = rows
    return odometry_of(log.t_ns, T)


def to_ins_m(log, geo) -> np.ndarray:
    """(M,) m: the mapped antenna from each of the log's fixes."""
    antenna = geo.T_enu_cam[:, :3, :3] @ log.p_cam_gnss + geo.T_enu_cam[:, :3, 3]
    return np.linalg.norm(antenna - wgs84.enu_from_lonlatheight(log.gnss.lon_lat_height, geo.frame), axis=1)


def only(log, rows):
    gnss = log.gnss
    some = GnssTrack(gnss.t_ns[rows], gnss.lon_lat_height[rows], gnss.covariance_enu[rows], gnss.fix_type[rows])
    return MadeLog(some, log.p_cam_gnss)


def R_cam_ins_camera(T_world_cam: np.ndarray, R_enu_ins_camera: np.ndarray) -> np.ndarray:
    """(3, 3) from rotations over ten frames, v_cam = R v_ins (Kabsch): what the calibration of the INS lacks."""
    R, S = T_world_cam[:, :3, :3], R_enu_ins_camera
    turned = [Rotation.from_matrix(np.swapaxes(X[:-10], 1, 2) @ X[10:]).as_rotvec() for X in (R, S)]
    return Rotation.align_vectors(*turned)[0].as_matrix()


def test_the_roll_of_clip_a_is_within_its_sigma_of_the_ins(log, odometry, tracked_clip_a, clip_a_gnss):
    """Sequence 00 comes without the rotation that rectifies its images; its own poses, which have it, give it back."""
    files = sorted((clip_a_gnss / "oxts" / "data").glob("*.txt"))[: len(log)]
    yaw_pitch_roll = np.array([np.loadtxt(file)[5:2:-1] for file in files])
    R_ins = Rotation.from_euler("ZYX", yaw_pitch_roll).as_matrix() @ log.T_cam_imu[:3, :3].T
    missing = R_cam_ins_camera(odometry.trajectory.T_world_cam, R_ins)
    assert abs(np.degrees(Rotation.from_matrix(missing).as_rotvec()[2])) == pytest.approx(0.42, abs=0.02)  # R_rect_00 of the day
    geo = georeference(log, tracked_clip_a)
    here = MapFrame(*wgs84.lonlatheight_from_enu(geo.T_enu_cam[:1, :3, 3], geo.frame)[0])
    up = (wgs84.T_enu_enu(here, geo.frame) @ geo.T_enu_cam)[:, 2, :3]
    error = up[:, 0] - (R_ins @ missing.T)[:, 2, 0]
    ahead = geo.T_enu_cam[:, :3, 2]
    sigma = np.median(np.sqrt(np.einsum("ni,nij,nj->n", ahead, geo.covariance[:, 3:, 3:], ahead)))
    assert np.sqrt((error**2).mean()) < 2.0 * sigma < np.radians(0.5)


def test_clip_a_lies_on_its_ins_track_in_karlsruhe(log, odometry):
    geo = georeference(log, odometry)
    assert (geo.frame.lon_deg, geo.frame.lat_deg) == (8.5, 48.5)
    assert geo.report["fixes"]["rejected"] == 0
    assert to_ins_m(log, geo).max() < 0.1


def test_fixes_that_were_kept_back_are_met_within_the_claimed_uncertainty(log, odometry):
    """One fix in twenty is given, the others judge; the truth's own first frames are known to be off by decimetres."""
    geo = georeference(only(log, np.arange(0, 201, 20)), odometry)
    distance = to_ins_m(log, geo)[20:]
    assert np.sqrt((distance**2).mean()) < 0.3
    assert geo.report["sigma_enu_m"]["worst"][0] > 0.05


def test_real_fixes_thrown_off_by_fifteen_metres_are_found(log, odometry):
    enu = wgs84.enu_from_lonlatheight(log.gnss.lon_lat_height, frame := georeference(log, odometry).frame)
    enu[60:90] += [10.0, -11.0, 0.0]
    gnss = dataclasses.replace(log.gnss, lon_lat_height=wgs84.lonlatheight_from_enu(enu, frame))
    geo = georeference(MadeLog(gnss, log.p_cam_gnss), odometry)
    assert [outlier["fix"] for outlier in geo.report["outliers"]] == list(range(60, 90))
    assert to_ins_m(log, geo).max() < 0.5


@pytest.fixture(scope="module", params=["A", "B"])
def clip(request):
    """Log, odometry of its images, the drive placed with all fixes, and its first frame that can be judged."""
    if request.param == "A":
        log = open_log(request.getfixturevalue("clip_a"), gnss=request.getfixturevalue("clip_a_gnss"))
        tracked, first = request.getfixturevalue("tracked_clip_a"), FAULTY_A
    else:
        log = open_log(request.getfixturevalue("clip_b"))
        tracked, first = request.getfixturevalue("tracked_clip_b"), 0
    return log, tracked, georeference(log, tracked), first


def change_m(clip, gnss) -> tuple[np.ndarray, np.ndarray]:
    """(n,) m each: by how much the poses change with other fixes, and the sigma that is then stated."""
    log, tracked, whole, first = clip
    geo = georeference(MadeLog(gnss, log.p_cam_gnss), tracked, Wanted(whole.frame))
    moved = np.linalg.norm(geo.T_enu_cam[first:, :3, 3] - whole.T_enu_cam[first:, :3, 3], axis=1)
    return moved, np.sqrt(np.trace(position_covariance(geo.T_enu_cam, geo.covariance), axis1=1, axis2=2))[first:]


@pytest.mark.parametrize("start", [0, 1])
def test_every_other_fix_is_enough(clip, start):
    moved, _ = change_m(clip, only(clip[0], np.arange(start, len(clip[0].gnss), 2)).gnss)
    assert moved.max() < 0.2


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("alike", [False, True])
def test_a_fifth_of_the_fixes_fifty_metres_off_changes_hardly_anything(clip, seed, alike):
    log, _, whole, _ = clip
    rng = np.random.default_rng(seed)
    rows = rng.choice(len(log.gnss), len(log.gnss) // 5, replace=False)
    bearing = rng.uniform(0.0, 2.0 * np.pi, len(rows))
    thrown = 50.0 * np.column_stack([np.cos(bearing), np.sin(bearing), np.zeros(len(rows))])
    enu = wgs84.enu_from_lonlatheight(log.gnss.lon_lat_height, whole.frame)
    enu[rows] += thrown[0] if alike else thrown
    moved, _ = change_m(clip, dataclasses.replace(log.gnss, lon_lat_height=wgs84.lonlatheight_from_enu(enu, whole.frame)))
    assert moved.max() < 0.2


@pytest.mark.parametrize("first_half", [True, False])
def test_half_a_drive_without_fixes_is_placed_within_what_it_states(clip, first_half):
    """The odometry's scale, 2 % of 35 to 70 m, decides where the rest lies."""
    count = len(clip[0].gnss)
    rows = np.arange(count // 2) if first_half else np.arange(count // 2, count)
    moved, sigma = change_m(clip, only(clip[0], rows).gnss)
    assert (moved < 3.0 * sigma).all()
