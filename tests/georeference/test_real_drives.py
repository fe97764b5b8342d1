"""Clip A, whose truth poses are good to a few decimetres, put on Earth with the GNSS/INS log of its drive."""

import dataclasses

import numpy as np
import pytest

from georeference.made_gnss_drives import odometry_of
from wayloom.geodesy import wgs84
from wayloom.georeference.alignment import georeference
from wayloom.logs.registry import open_log
from wayloom.logs.types import GnssTrack

pytestmark = pytest.mark.real_data


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
    return type("Log", (), {"gnss": some, "p_cam_gnss": log.p_cam_gnss, "name": log.name})()


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
    thrown = type("Log", (), {"gnss": gnss, "p_cam_gnss": log.p_cam_gnss, "name": log.name})()
    geo = georeference(thrown, odometry)
    assert [outlier["fix"] for outlier in geo.report["outliers"]] == list(range(60, 90))
    assert to_ins_m(log, geo).max() < 0.5
