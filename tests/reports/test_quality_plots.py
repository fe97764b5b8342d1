"""The pictures of a quality report: each where its numbers are, the same for the same numbers, small for any drive."""

import re
from dataclasses import replace

import numpy as np
import pytest

from georeference.made_gnss_drives import made_drive
from wayloom.georeference.alignment import georeference
from wayloom.loops.types import LoopClosures
from wayloom.pipeline.drive_quality import MOST, drive_quality
from wayloom.reports.quality_plots import quality_pictures


@pytest.fixture(scope="module")
def quality():
    drive = made_drive(sigma_m=0.05)
    loops = LoopClosures(np.array([0], np.int32), np.array([60], np.int32), np.eye(4)[None], np.eye(6)[None])
    found = drive_quality(drive.odometry, georeference(drive.log, drive.odometry), loops)
    return found | {"bursts": [{"from_s": 3.0, "to_s": 6.0, "offset_enu_m": [1.0, 2.0, 3.0]}]}


def test_every_picture_is_drawn_and_again_with_the_same_bytes(quality):
    pictures = quality_pictures(quality)
    assert list(pictures) == ["residuals", "drift", "sigma", "track"]
    assert quality_pictures(quality) == pictures
    for svg in pictures.values():
        assert svg.startswith("<svg")
        assert not re.search(r"(href|src)=\"(?!#)", svg)


def test_bursts_and_loops_are_drawn_and_named_where_there_are_any(quality):
    pictures, without = quality_pictures(quality), quality_pictures(quality | {"bursts": [], "loops": None})
    assert ">burst<" in pictures["residuals"]
    assert "loop closures (1)" in pictures["track"]
    assert ">burst<" not in without["residuals"]
    assert "loop closures" not in without["track"]


def test_a_drive_without_gnss_has_its_track_and_its_own_sigma_alone():
    drive = made_drive()
    geo = georeference(replace(drive.log, gnss=None), drive.odometry)
    assert list(quality_pictures(drive_quality(drive.odometry, geo))) == ["sigma", "track"]


def test_the_pictures_of_hours_are_no_larger_than_a_megabyte(quality):
    rows = np.linspace(0, 1, MOST)
    many = {"road_m": (1e5 * rows).tolist(), "t_s": (7200 * rows).tolist()}
    fixes = {name: np.resize(quality["fixes"][name], (3, 1600)).tolist() for name in ("residual_enu_m", "sigma_enu_m")}
    fixes |= {"t_s": np.linspace(0, 7200, 1600).tolist(), "used": ([True, False] * 800)}
    track = quality["track"] | many | {"plane_m": [np.cumsum(np.sin(9 * rows)).tolist()] * 3}
    track["sigma"] = {"enu_m": np.random.default_rng(0).random((3, MOST)).tolist(), "heading_deg": rows.tolist()}
    drift = quality["drift"] | {"road_m": many["road_m"], "odometry_m": rows.tolist()}
    pictures = quality_pictures(quality | {"fixes": fixes, "track": track, "drift": drift})
    assert max(len(svg) for svg in pictures.values()) < 1_000_000
