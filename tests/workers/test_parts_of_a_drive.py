"""Two workers track the parts of one drive, whoever of them is killed meanwhile, to the bytes of one process."""

import hashlib
from pathlib import Path
from typing import Any

import pytest

from pipeline.real_log import first_frames
from service_kit.running import Up, service, until
from wayloom.client.api import Api
from wayloom.client.manifests import pack
from wayloom.client.upload import upload
from wayloom.client.watch import wait_for_drive
from wayloom.odometry.settings import OdometrySettings
from wayloom.pipeline.log_source import LogSource
from wayloom.pipeline.settings import ProcessSettings
from wayloom.pipeline.stage_context import StageContext
from wayloom.pipeline.stages.odometry import run

FRAMES = 110
IN_PARTS = OdometrySettings(part_frames=50, part_overlap=20, self_calibration=False)
VARIABLES = {
    "WAYLOOM_STAGE_HOOKS": "service_kit.little_stages:odometry_hooks",
    "WAYLOOM_ODOMETRY__PART_FRAMES": "50",
    "WAYLOOM_ODOMETRY__PART_OVERLAP": "20",
    "WAYLOOM_ODOMETRY__SELF_CALIBRATION": "false",
}
PARTS = 3


@pytest.fixture(scope="module")
def log_path(clip_a: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return first_frames(clip_a, tmp_path_factory.mktemp("log") / "street", FRAMES)


@pytest.fixture(scope="module")
def digest(log_path: Path, tmp_path_factory: pytest.TempPathFactory) -> str:
    """Of the odometry's file as one process makes it."""
    folder = tmp_path_factory.mktemp("alone")
    run(StageContext(LogSource(log_path), folder, ProcessSettings(odometry=IN_PARTS)), folder, lambda share, what: None)
    return hashlib.sha256((folder / "odometry.npz").read_bytes()).hexdigest()


def odometry(api: Api, drive_id: str) -> dict[str, Any]:
    return next(stage for stage in api.drive(drive_id)["stages"] if stage["stage"] == "odometry")


def made(up: Up, drive_id: str) -> str:
    (file,) = (up.data / "drives" / drive_id / "stages" / "odometry").glob("*/odometry.npz")
    return hashlib.sha256(file.read_bytes()).hexdigest()


def test_two_workers_share_the_parts_of_a_drive(log_path: Path, digest: str, tmp_path: Path) -> None:
    with service(tmp_path / "data", "--workers", "2", **VARIABLES) as up:
        api = up.api()
        drive_id = upload(api, pack(log_path))["id"]
        shown = until(lambda: odometry(api, drive_id)["message"] and odometry(api, drive_id), 120)
        assert shown["state"] in ("running", "queued")
        assert wait_for_drive(api, drive_id)["state"] == "done"
        runs = [line for line in up.runs() if line[1].startswith("odometry")]
        assert made(up, drive_id) == digest
        assert sorted(stage for what, stage, *_ in runs if what == "end") == [
            "odometry",
            *(f"odometry/{n}" for n in range(1, PARTS + 1)),
        ]
        assert runs[-1][:2] == ["end", "odometry"]
        assert len({pid for _, stage, _, pid, _ in runs if stage != "odometry"}) == 2
        assert odometry(api, drive_id)["attempt"] == 1
        assert not (up.data / "drives" / drive_id / "parts" / "odometry").exists()


def test_a_worker_killed_in_a_part_loses_that_part_only(log_path: Path, digest: str, tmp_path: Path) -> None:
    with service(tmp_path / "data", "--workers", "2", **VARIABLES) as up:
        api = up.api()
        drive_id = upload(api, pack(log_path))["id"]
        until(lambda: sum(what == "end" and "/" in stage for what, stage, *_ in up.runs()) >= 1, 120)
        begun = until(lambda: unfinished(up))
        up.kill_process(int(begun[0][3]))
        assert wait_for_drive(api, drive_id)["state"] == "done"
        starts = [stage for what, stage, *_ in up.runs() if what == "start" and "/" in stage]
        assert made(up, drive_id) == digest
        assert {stage for stage in starts if starts.count(stage) > 1} <= {line[1] for line in begun}
        assert len(starts) <= PARTS + 1


def unfinished(up: Up) -> list[list[str]]:
    """The parts that have begun and not ended."""
    runs = [line for line in up.runs() if "/" in line[1]]
    ended = {line[1] for line in runs if line[0] == "end"}
    return [line for line in runs if line[0] == "start" and line[1] not in ended]
