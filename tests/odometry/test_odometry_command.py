import json
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from made_street import CAMERA, RIG, MadeLog, curve
from typer.testing import CliRunner

from wayloom.cli.main import app
from wayloom.errors import ConfigError, InputError, LogError
from wayloom.files.ply import read_ply
from wayloom.files.trajectory_files import read_kitti, read_tum
from wayloom.odometry.settings import ImuSettings, OdometrySettings

FRAMES = 8


def write_log(folder: Path, black: tuple[int, ...] = ()) -> Path:
    """The made street in KITTI odometry layout."""
    log = MadeLog(curve(FRAMES))
    for side in (0, 1):
        (folder / f"image_{side}").mkdir(parents=True)
    for frame in log.frames():
        for side, image in enumerate((frame.left, frame.right)):
            cv2.imwrite(str(folder / f"image_{side}" / f"{frame.index:06d}.png"), image * (frame.index not in black))
    P = np.column_stack([CAMERA.K, np.zeros(3)])
    Q = P.copy()
    Q[0, 3] = -RIG.bf
    lines = [f"{name}: {' '.join(str(x) for x in M.ravel())}" for name, M in (("P0", P), ("P1", Q))]
    (folder / "calib.txt").write_text("\n".join(lines) + "\n")
    (folder / "times.txt").write_text("\n".join(f"{0.1 * i:.6f}" for i in range(FRAMES)) + "\n")
    return folder


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_log(tmp_path_factory.mktemp("drive") / "00")


def test_trajectory_cloud_and_report_are_written(log: Path, tmp_path: Path) -> None:
    out, cloud = tmp_path / "traj.tum", tmp_path / "cloud.ply"
    done = CliRunner().invoke(app, ["odometry", str(log), "--out", str(out), "--points", str(cloud), "--json"])
    assert done.exit_code == 0, done.output
    t_ns, T = read_tum(out)
    assert t_ns.tolist() == [i * 100_000_000 for i in range(FRAMES)]
    assert np.linalg.norm(T[:, :3, 3] - curve(FRAMES)[:, :3, 3], axis=1).max() < 0.03
    facts = json.loads(done.stdout)
    assert (facts["frames"], facts["tracked"]) == (FRAMES, FRAMES)
    assert len(read_ply(cloud).points) == facts["points"] > 50
    assert "warning" not in done.output


def test_kitti_format_has_one_line_a_frame_relative_to_the_first(log: Path, tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["odometry", str(log), "--out", str(tmp_path / "t.txt"), "--format", "kitti", "--threads", "2"])
    assert done.exit_code == 0, done.output
    poses = read_kitti(tmp_path / "t.txt")
    assert len(poses) == FRAMES
    np.testing.assert_allclose(poses[0], np.eye(4), atol=1e-9)


def test_lost_frames_are_a_warning_and_no_failure(tmp_path: Path) -> None:
    folder = write_log(tmp_path / "00", black=(4,))
    done = CliRunner().invoke(app, ["odometry", str(folder), "--out", str(tmp_path / "t.tum")])
    assert done.exit_code == 0, done.output
    assert "1 of 8 frames not tracked, 1 segments, the first: frame 4, the image is blank" in done.output
    assert len(read_tum(tmp_path / "t.tum")[0]) == FRAMES
    comments = [line for line in (tmp_path / "t.tum").read_text().splitlines() if line.startswith("#")]
    assert [line.partition(":")[0] for line in comments] == ["# guessed", "# tracked"]


def test_settings_of_a_file_and_of_the_environment_reach_the_odometry(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: list[Any] = []

    def noted(drive: Any, settings: Any, progress: Any, threads: int, **_: Any) -> None:
        given.extend((settings, threads))
        raise ConfigError("that is enough")

    monkeypatch.setattr("wayloom.calibration.self_calibration.track_calibrated", noted)
    monkeypatch.setenv("WAYLOOM_ODOMETRY__POINTS", "600")
    (tmp_path / "fleet.toml").write_text("threads = 3\n[odometry]\nwindow = 8\n[odometry.imu]\nuse = false\n")
    arguments = ["odometry", str(log), "--out", str(tmp_path / "t.tum"), "--config", str(tmp_path / "fleet.toml")]
    CliRunner().invoke(app, arguments)
    assert given == [OdometrySettings(window=8, points=600, imu=ImuSettings(use=False)), 3]


def test_a_rig_file_that_is_not_there_is_refused_by_the_options_name(log: Path, tmp_path: Path) -> None:
    arguments = ["odometry", str(log), "--out", str(tmp_path / "t.tum"), "--rig", str(tmp_path / "none.toml")]
    with pytest.raises(ConfigError, match=r"--rig: .*none\.toml: no such file or folder"):
        CliRunner().invoke(app, arguments, catch_exceptions=False)


@pytest.mark.parametrize("option", ["--out", "--points"])
def test_a_file_that_cannot_be_written_is_told_before_the_tracking(log: Path, tmp_path: Path, option: str) -> None:
    (tmp_path / "file").write_text("mine")
    for bad in (tmp_path, tmp_path / "file" / "below", Path("/proc/no/where"), tmp_path / ("x" * 300)):
        arguments = ["odometry", str(log), *(() if option == "--out" else ("--out", str(tmp_path / "t.tum"))), option, str(bad)]
        done = CliRunner().invoke(app, arguments)
        assert isinstance(done.exception, InputError)
        assert str(done.exception).startswith(f"{bad}: cannot be written (")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_nothing_is_written_into_a_log(log: Path, tmp_path: Path) -> None:
    before = sorted(log.rglob("*"))
    (tmp_path / "link").symlink_to(log)
    for out in (log / "poses.txt", log / "new" / "t.tum", log / "image_0" / "000000.png", tmp_path / "link" / "t.tum"):
        done = CliRunner().invoke(app, ["odometry", str(log), "--out", str(out)])
        assert isinstance(done.exception, ConfigError)
        assert str(done.exception).startswith(f"{out}: lies inside the log")
    assert sorted(log.rglob("*")) == before


def test_exchanged_images_are_told(log: Path, tmp_path: Path) -> None:
    folder = write_log(tmp_path / "00")
    (folder / "image_0").rename(folder / "aside")
    (folder / "image_1").rename(folder / "image_0")
    (folder / "aside").rename(folder / "image_1")
    done = CliRunner().invoke(app, ["odometry", str(folder), "--out", str(tmp_path / "t.tum")])
    assert isinstance(done.exception, LogError)
    assert "left and right images are exchanged" in str(done.exception)
    assert not (tmp_path / "t.tum").exists()


def test_ctrl_c_ends_in_one_short_line_and_leaves_nothing(log: Path, tmp_path: Path) -> None:
    out = tmp_path / "out" / "t.tum"
    command = [sys.executable, "-m", "wayloom.cli.main", "odometry", str(log), "--out", str(out)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        started = process.stderr.readline()
        process.send_signal(signal.SIGINT)
        said = process.stderr.read().splitlines()
    assert started.startswith("odometry   0 %")
    assert process.returncode == 130
    assert said[-1] == "wayloom: stopped"
    assert all(line.startswith("odometry ") for line in said[:-1])
    assert not out.parent.exists()
