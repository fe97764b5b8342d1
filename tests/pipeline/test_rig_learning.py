"""A local rig file taught by processed drives: lens and receiver, knocks, changed clocks."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from calibration.made_observations import LENS, made_drive
from wayloom.calibration.receiver import learnt_receiver
from wayloom.calibration.rig_file import read_rig_file
from wayloom.geometry.lens import RightLens
from wayloom.odometry.rig.calibration_file import save_observations
from wayloom.pipeline.rig_learning import CHANGED, learn_from_drive

KNOCKED = replace(LENS, pitch_rad=LENS.pitch_rad + 2e-3, yaw_rad=LENS.yaw_rad - 3e-3)
DAY_NS = 86_400 * 10**9


def processed(folder: Path, number: int, late_s: float | None = 0.0, lens: RightLens = LENS, grade: str = "A") -> Path:
    """What `wayloom process` leaves of drive `number`, recorded on that day: as far as a rig file learns from it."""
    stages = folder / str(number) / "stages"
    save_observations(made_drive(lens, number, groups=12, points=40, group_px=0.05), stages / "odometry" / "evidence.npz")
    information = np.diag([4e5, 1e3, 0.0, 1e3])
    told = None
    if late_s is not None:
        pull = information @ [late_s, 0.1, 0.0, -1.0]
        told = {"t_ns": (20_000 + number) * DAY_NS, "information": information.tolist(), "pull": pull.tolist()}
    (stages / "georeference").mkdir(parents=True)
    (stages / "georeference" / "report.json").write_text(json.dumps({"grade": grade, "receiver_told": told}))
    return stages


def test_each_drive_adds_its_lens_and_its_receiver(tmp_path: Path) -> None:
    file = tmp_path / "RIG.toml"
    assert [learn_from_drive(processed(tmp_path, number, 0.02), file) for number in (0, 1)] == [[], []]
    rig = read_rig_file(file)
    assert rig.drives == ("drive 0", "drive 1")
    learnt = learnt_receiver(rig.receivers)
    assert learnt is not None
    assert learnt.epoch.ids == rig.drives
    assert abs(learnt.mean[0] - 0.02) < 1e-4


def test_a_drive_counts_once(tmp_path: Path) -> None:
    file, stages = tmp_path / "RIG.toml", processed(tmp_path, 0)
    learn_from_drive(stages, file)
    before = file.read_bytes()
    (note,) = learn_from_drive(stages, file)
    assert "already" in note
    assert file.read_bytes() == before


def test_a_drive_that_tells_nothing_of_its_clock_or_is_badly_placed_teaches_the_lens_alone(tmp_path: Path) -> None:
    file = tmp_path / "RIG.toml"
    learn_from_drive(processed(tmp_path, 0, None), file)
    learn_from_drive(processed(tmp_path, 1, 0.3, grade="D"), file)
    rig = read_rig_file(file)
    assert (rig.drives, rig.receivers) == (("drive 0", "drive 1"), ())


def test_a_changed_clock_is_said_and_a_knock_begins_the_lens_anew(tmp_path: Path) -> None:
    file = tmp_path / "RIG.toml"
    learn_from_drive(processed(tmp_path, 0), file)
    assert learn_from_drive(processed(tmp_path, 1, 0.09), file) == [CHANGED]
    assert read_rig_file(file).drives == ("drive 0", "drive 1")
    (note,) = learn_from_drive(processed(tmp_path, 2, 0.09, KNOCKED), file)
    assert "knocked" in note
    rig = read_rig_file(file)
    assert rig.drives == ("drive 2",)
    learnt = learnt_receiver(rig.receivers)
    assert learnt is not None
    assert learnt.epoch.ids == ("drive 1", "drive 2")
