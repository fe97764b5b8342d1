"""A long drive is tracked in parts: the same bytes however many processes do it and however often they are killed."""

import hashlib
import json
import shutil
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from pipeline.real_log import damage, first_frames
from wayloom.errors import LogError
from wayloom.odometry.odometry import track
from wayloom.odometry.result.odometry_file import load_odometry
from wayloom.odometry.rig.calibration_file import load_observations
from wayloom.odometry.settings import OdometrySettings
from wayloom.pipeline.log_source import LogSource
from wayloom.pipeline.odometry_parts import missing_parts, parts_of
from wayloom.pipeline.settings import ProcessSettings
from wayloom.pipeline.stage_context import StageContext
from wayloom.pipeline.stages.odometry import run

FRAMES = 80
IN_PARTS = OdometrySettings(part_frames=44, part_overlap=20, self_calibration=False)


class KilledError(Exception):
    """Stands for kill -9: the stage ends here."""


@pytest.fixture(scope="module")
def log_path(clip_a: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return first_frames(clip_a, tmp_path_factory.mktemp("log") / "street", FRAMES)


def context(log_path: Path, folder: Path, threads: int = 1, settings: OdometrySettings = IN_PARTS) -> StageContext:
    return StageContext(
        LogSource(log_path), folder, ProcessSettings(threads=threads, odometry=settings), parts_dir=folder / "parts"
    )


def furthest(a: np.ndarray, b: np.ndarray) -> float:
    """m: the largest distance of two trajectories (n, 4, 4) that begin alike."""
    return float(np.linalg.norm(a[:, :3, 3] - b[:, :3, 3], axis=1).max())


def odometry(at: StageContext, out: Path, progress=lambda share, what: None) -> dict[str, str]:
    """Run the stage; the digests of what it left."""
    out.mkdir(parents=True)
    run(at, out, progress)
    return {name: hashlib.sha256((out / name).read_bytes()).hexdigest() for name in ("odometry.npz", "evidence.npz")}


@pytest.fixture(scope="module")
def done(log_path: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, str]]:
    folder = tmp_path_factory.mktemp("done")
    return folder, odometry(context(log_path, folder), folder / "out")


def test_the_drive_is_whole_and_knows_its_parts(done: tuple[Path, dict[str, str]], log_path: Path) -> None:
    result = load_odometry(done[0] / "out" / "odometry.npz")
    assert len(result.trajectory) == FRAMES
    assert result.trajectory.tracked.all()
    assert not result.trajectory.segment.any()
    assert [(row["first_frame"], row["last_frame"]) for row in result.report["parts"]] == [(0, 39), (20, 59), (40, 79)]
    assert [row["frame"] for row in result.report["joints"]] == [30, 50]
    report = json.loads((done[0] / "out" / "report.json").read_text())
    assert report["seconds"]["track"] > 0
    evidence = load_observations(done[0] / "out" / "evidence.npz")
    assert (np.diff(evidence.host_frame) > 0).all()
    assert evidence.host_frame[-1] > 60


def test_in_parts_it_is_as_exact_as_in_one_piece(done: tuple[Path, dict[str, str]], log_path: Path) -> None:
    parts, log = load_odometry(done[0] / "out" / "odometry.npz"), LogSource(log_path).log
    seeds = [track(log, OdometrySettings(self_calibration=False, seed=seed)) for seed in range(4)]
    ways = [result.trajectory.T_world_cam for result in seeds]
    noise = max(furthest(a, b) for a, b in combinations(ways, 2))
    assert furthest(parts.trajectory.T_world_cam, ways[0]) < 1.5 * noise  # of four runs: that of a fifth may be a little larger
    assert 0.8 < len(parts.points) / len(seeds[0].points) < 1.25


def test_processes_make_the_same_bytes(done: tuple[Path, dict[str, str]], log_path: Path, tmp_path: Path) -> None:
    shares: list[float] = []
    assert odometry(context(log_path, tmp_path, threads=2), tmp_path / "out", lambda share, _: shares.append(share)) == done[1]
    assert 0.3 < max(shares) <= 1.0


def test_a_run_that_was_killed_between_two_parts_goes_on(done: tuple[Path, dict[str, str]], log_path: Path, tmp_path: Path) -> None:
    at = context(log_path, tmp_path)

    def kill_in_the_third(share: float, what: str, /) -> None:
        if what.startswith("part 3") and "keyframes" in what:
            raise KilledError

    with pytest.raises(KilledError):
        odometry(at, tmp_path / "first", kill_in_the_third)
    assert at.parts_dir is not None
    assert [part.number for part in missing_parts(at, at.parts_dir)] == [2]
    told: list[str] = []
    assert odometry(at, tmp_path / "second", lambda _, what: told.append(what)) == done[1]
    assert {what.split(":")[0] for what in told} == {"part 3 of 3"}


def test_a_part_that_the_disk_lost_is_tracked_again(done: tuple[Path, dict[str, str]], log_path: Path, tmp_path: Path) -> None:
    shutil.copytree(done[0] / "parts", tmp_path / "parts")
    (tmp_path / "parts" / "0001" / "odometry.npz").write_bytes(b"")
    at = context(log_path, tmp_path)
    assert [part.number for part in missing_parts(at, tmp_path / "parts")] == [1]
    assert odometry(at, tmp_path / "out") == done[1]


@pytest.mark.parametrize("threads", [1, 2])
def test_a_damaged_image_is_told_as_ever(log_path: Path, tmp_path: Path, threads: int) -> None:
    shutil.copytree(log_path, tmp_path / "log")
    damage(tmp_path / "log" / "image_0" / "000035.png")
    with pytest.raises(LogError, match=r"000035\.png"):
        odometry(context(tmp_path / "log", tmp_path, threads), tmp_path / "out")


def test_a_short_drive_is_tracked_in_one_piece_to_the_bit(log_path: Path, tmp_path: Path) -> None:
    at = context(log_path, tmp_path, settings=OdometrySettings(self_calibration=False))
    assert len(parts_of(at)) == 1
    odometry(at, tmp_path / "out")
    result, plain = load_odometry(tmp_path / "out" / "odometry.npz"), track(at.log, at.settings.odometry)
    np.testing.assert_array_equal(result.trajectory.T_world_cam, plain.trajectory.T_world_cam)
    np.testing.assert_array_equal(result.points.inverse_depth, plain.points.inverse_depth)
    assert "parts" not in result.report
    assert not (tmp_path / "parts").exists()
