"""A rig's file in `wayloom process` and `wayloom odometry`, and the evidence that each drive leaves."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pipeline.real_log import first_frames
from wayloom.calibration.rig_file import RigFile, lens_for_log, write_rig_file
from wayloom.errors import CalibrationError
from wayloom.geometry.lens import RightLens
from wayloom.logs.registry import open_log
from wayloom.odometry.result.odometry_file import load_odometry
from wayloom.odometry.rig.calibration_file import load_observations
from wayloom.pipeline.drive import process_drive
from wayloom.pipeline.log_source import LogSource
from wayloom.pipeline.running import run_stage, stage_key
from wayloom.pipeline.settings import ProcessSettings
from wayloom.pipeline.stage_context import StageContext

FRAMES = 8
LENS = RightLens(yaw_rad=1e-3, cx_shift_px=-0.7, ty=1e-3)


@pytest.fixture(scope="module")
def log_path(clip_a: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = first_frames(clip_a, tmp_path_factory.mktemp("rig") / "street", FRAMES)
    (path / "wayloom.json").write_text('{"rig_id": "car-7"}')
    return path


def written(log_path: Path, file: Path, lens: RightLens = LENS, rig_id: str = "car-7") -> Path:
    """A rig file for the log's own rig."""
    rig = RigFile(rig_id, open_log(log_path).rig, ("another drive",), lens, np.full(10, 1e-4), np.ones(10, bool))
    write_rig_file(rig, file)
    return file


def odometry_stage(log_path: Path, folder: Path, settings: ProcessSettings) -> Path:
    """The stages ingest and odometry in a folder, without a network."""
    for name in ("ingest", "odometry"):
        (folder / name).mkdir(parents=True)
        run_stage(name, StageContext(LogSource(log_path), folder, settings), folder / name)
    return folder / "odometry"


def test_every_drive_leaves_its_evidence_and_uses_the_lens_that_it_is_given(log_path: Path, tmp_path: Path) -> None:
    plain = odometry_stage(log_path, tmp_path / "plain", ProcessSettings())
    file = written(log_path, tmp_path / "RIG.toml")
    known = odometry_stage(log_path, tmp_path / "known", ProcessSettings(rig=file))
    for folder in (plain, known):
        evidence = load_observations(folder / "evidence.npz")
        assert (evidence.rig_id, evidence.name.split("#")[0]) == ("car-7", "street")
        assert evidence.groups >= 1
        assert (folder / "evidence.npz").stat().st_size < 300_000
        assert evidence.rig == open_log(log_path).rig
    one, other = (load_odometry(folder / "odometry.npz") for folder in (plain, known))
    assert (one.lens, other.lens) == (RightLens(), LENS)
    assert other.rig.t_right_left[1] == pytest.approx(one.rig.t_right_left[1] + 1e-3 * one.rig.baseline_m)
    assert np.abs(one.trajectory.T_world_cam - other.trajectory.T_world_cam).max() > 1e-6


def test_the_odometrys_key_depends_on_the_lens_and_not_on_the_files_name(log_path: Path, tmp_path: Path) -> None:
    (tmp_path / "ingest").mkdir()
    run_stage("ingest", StageContext(LogSource(log_path), tmp_path, ProcessSettings()), tmp_path / "ingest")

    def key(file: Path | None) -> str:
        settings = ProcessSettings(rig=file)
        return stage_key("odometry", StageContext(LogSource(log_path), tmp_path, settings)).hex

    one, same = written(log_path, tmp_path / "one.toml"), written(log_path, tmp_path / "same.toml")
    other = written(log_path, tmp_path / "other.toml", RightLens(k1=1e-3))
    assert key(one) == key(same)
    assert len({key(None), key(one), key(other)}) == 3


def test_the_file_of_another_rig_is_told_before_anything_is_made(log_path: Path, tmp_path: Path) -> None:
    file = written(log_path, tmp_path / "RIG.toml", rig_id="car-8")
    with pytest.raises(CalibrationError, match="is of the rig car-8, the log of car-7"):
        process_drive(log_path, tmp_path / "out", ProcessSettings(rig=file))
    assert not (tmp_path / "out").exists()


def test_a_folder_of_rigs_gives_a_log_its_own(log_path: Path, tmp_path: Path) -> None:
    log = open_log(log_path)
    assert lens_for_log(tmp_path, log) == (None, ())
    written(log_path, tmp_path / "car-7.toml")
    assert lens_for_log(tmp_path, log) == (LENS, ())
    assert lens_for_log(None, log) == (None, ())


def test_the_odometry_command_takes_a_rig_and_leaves_evidence(log_path: Path, tmp_path: Path) -> None:
    def odometry(*more: object) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "wayloom.cli.main", "odometry", str(log_path), "--out", str(tmp_path / "t.tum")]
        return subprocess.run([*command, *(str(m) for m in more)], capture_output=True, text=True, check=False)

    (log_path / "wayloom.json").write_text("{}")
    file = written(log_path, tmp_path / "RIG.toml")
    done = odometry("--rig", file, "--evidence", tmp_path / "e.npz")
    assert done.returncode == 0, done.stderr
    assert "warning: the rig file says rig car-7, the log unknown" in done.stderr
    assert load_observations(tmp_path / "e.npz").groups >= 1
    bad = odometry("--rig", tmp_path / "missing.toml")
    assert (bad.returncode, bad.stderr.count("\n")) == (2, 1)
