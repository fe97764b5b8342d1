"""The odometry is as accurate as the committed table of benchmarks/odometry.json says, within the noise of its seeds."""

from pathlib import Path

import pytest

from committed_odometry import committed_row, least, most
from wayloom.evaluation.odometry import ABLATIONS, measures, timed_track
from wayloom.evaluation.odometry_recordings import Recording, clip_recordings
from wayloom.odometry.settings import OdometrySettings

pytestmark = pytest.mark.real_data
NOISE = 3.0
"""times the spread over the seeds"""
LEAST_SPREAD = {"ATE m": {"A": 0.012, "B": 0.04}, "t_rel %": {"A": 0.03, "B": 0.1}, "length ratio": {"A": 0.001, "B": 0.003}}
"""Differences that mean nothing, from many seeds; a few may by chance lie closer together."""


def clip(name: str, data_dir: Path) -> Recording:
    return next(recording for recording in clip_recordings(data_dir) if recording.name == name)


@pytest.mark.parametrize("name", ["A", "B"])
def test_accuracy_and_density_are_those_of_the_committed_table(name: str, data_dir: Path) -> None:
    recording = clip(name, data_dir)
    row, now = committed_row(name), measures(recording, *timed_track(recording, OdometrySettings()))
    assert now["tracked"] == now["frames"] == row["median"]["frames"]
    assert now["segments"] == 1
    for measure, floor in LEAST_SPREAD.items():
        for truth in recording.truths:
            key = f"{measure} ({truth})"
            limit = NOISE * max(row["spread"][key], floor[name])
            worse = abs(now[key] - 1) - abs(row["median"][key] - 1) if measure == "length ratio" else now[key] - row["median"][key]
            assert worse < limit, f"{key}: {now[key]:.3f}, the table says {row['median'][key]:.3f}, noise {limit:.3f}"
    assert now["points/m"] >= least(name, "points/m")
    assert now["blocks covered"] >= least(name, "blocks covered")
    if recording.depth is not None:
        assert now["depth beyond_2_px"] <= most(name, "depth beyond_2_px")


def test_without_static_stereo_terms_scale_drifts_and_nothing_is_lost(data_dir: Path) -> None:
    recording, settings = clip("A", data_dir), OdometrySettings.model_validate(ABLATIONS["no static stereo terms"])
    now = measures(recording, *timed_track(recording, settings))
    assert now["tracked"] == now["frames"] == 201
    assert now["segments"] == 1
    assert 0.5 < now["ATE m (poses from frame 16)"] < 2.5
    assert now["points/m"] > 100
