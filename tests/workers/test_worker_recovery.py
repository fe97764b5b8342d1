"""Whatever is killed, lost or delivered twice, the drive ends in the map, and no finished stage is done again."""

import os
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from redis import Redis

from service_kit.little_stages import held_up, waits_at
from service_kit.packed_drives import packed_drive
from service_kit.running import Up, environment, service, until
from wayloom.client.api import AnswerError, Api
from wayloom.client.upload import upload
from wayloom.client.watch import wait_for_drive
from wayloom.config.service import ServiceSettings
from wayloom.config.stages import drive_stages, map_stages, queues
from wayloom.store.queues import TASK_NAME

ALL = (*drive_stages(), *map_stages())


@pytest.fixture(scope="module")
def up(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Up]:
    """A service with two workers for the tests that leave it as it is."""
    with service(tmp_path_factory.mktemp("shared") / "data", "--workers", "2") as running:
        yield running


def starts(up: Up, drive_id: str) -> dict[str, int]:
    """How often each stage of the drive was begun."""
    counted: dict[str, int] = {}
    for what, stage, _, _, drive in up.runs():
        if what == "start" and drive == drive_id:
            counted[stage] = counted.get(stage, 0) + 1
    return counted


def process_at(up: Up, stage: str, drive_id: str) -> str:
    """Process id of the worker that began the drive's stage first: of two workers either may."""
    return next(process for what, name, _, process, drive in up.runs() if (what, name, drive) == ("start", stage, drive_id))


def stage(api: Api, drive_id: str, name: str) -> dict[str, Any]:
    return next(one for one in api.drive(drive_id)["stages"] if one["stage"] == name)


def outputs(up: Up, drive_id: str) -> dict[str, int]:
    """For each finished stage, when its output was written."""
    folder = up.data / "drives" / drive_id / "stages"
    return {path.parent.parent.name: path.stat().st_mtime_ns for path in folder.glob("*/*/result.json")}


def test_a_drive_goes_through_every_stage_into_the_map_and_out_again(up: Up, tmp_path: Path) -> None:
    api = up.api()
    first = upload(api, packed_drive(tmp_path / "a", "first", sizes=(10,) * 20))["id"]
    second = upload(api, packed_drive(tmp_path / "b", "second"))["id"]
    drives = [wait_for_drive(api, drive_id) for drive_id in (first, second)]
    for drive in drives:
        assert drive["state"] == "done"
        assert [one["stage"] for one in drive["stages"]] == list(ALL)
        assert {one["state"] for one in drive["stages"]} == {"done"}
        assert {one["attempt"] for one in drive["stages"]} == {1}
        assert starts(up, drive["id"]) == dict.fromkeys(drive_stages(), 1)
    assert {first, second} <= set(api.json("GET", "/v1/maps/city")["drives"])
    assert upload(api, packed_drive(tmp_path / "a", "first", sizes=(10,) * 20))["created"] is False
    api.once("DELETE", f"/v1/drives/{first}")
    until(lambda: first not in api.json("GET", "/v1/maps/city")["drives"])
    assert second in api.json("GET", "/v1/maps/city")["drives"]
    assert not (up.data / "drives" / first).exists()


def test_a_worker_killed_in_the_middle_of_a_stage_loses_that_stage_only(tmp_path: Path) -> None:
    with service(tmp_path / "data") as up:
        api = up.api()
        with held_up(up.data, "labelling"):
            drive_id = upload(api, packed_drive(tmp_path / "a"))["id"]
            until(lambda: stage(api, drive_id, "labelling")["progress"] > 0.2)
            before = outputs(up, drive_id)
            killed = process_at(up, "labelling", drive_id)
            up.kill_process(int(killed))
        started = time.monotonic()
        drive = wait_for_drive(api, drive_id)
        assert drive["state"] == "done"
        assert time.monotonic() - started < 25
        assert starts(up, drive_id) == {**dict.fromkeys(drive_stages(), 1), "labelling": 2}
        assert (stage(api, drive_id, "labelling")["attempt"], len(stage(api, drive_id, "labelling")["losses"])) == (1, 1)
        assert set(before) == {"ingest", "odometry", "segmentation"}
        assert {name: when for name, when in outputs(up, drive_id).items() if name in before} == before
        assert killed not in {run[3] for run in up.runs() if run[0] == "end" and run[1] == "labelling"}
        assert list((up.data / "drives" / drive_id / "attempts").iterdir()) == []


def test_a_service_killed_as_a_whole_leaves_no_process_and_goes_on_when_started_again(tmp_path: Path) -> None:
    up = Up(tmp_path / "data").wait()
    with held_up(up.data, "odometry"):
        try:
            api = up.api()
            drive_id = upload(api, packed_drive(tmp_path / "a"))["id"]
            until(lambda: stage(api, drive_id, "odometry")["progress"] > 0.1)
            children = up.children("")
            assert len(children) >= 4
            up.process.kill()
        finally:
            up.stop()
        until(lambda: not any(is_running(pid) for pid in children))
    up.ready.unlink(missing_ok=True)
    with service(tmp_path / "data") as again:
        drive = wait_for_drive(again.api(), drive_id)
        assert drive["state"] == "done"
        assert starts(again, drive_id) == {**dict.fromkeys(drive_stages(), 1), "odometry": 2}


def is_running(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


def test_a_service_that_is_stopped_gives_its_job_back_and_counts_no_attempt(tmp_path: Path) -> None:
    with service(tmp_path / "data") as up:
        api = up.api()
        waits_at(up.data, "odometry").touch()
        drive_id = upload(api, packed_drive(tmp_path / "a"))["id"]
        until(lambda: stage(api, drive_id, "odometry")["progress"] > 0.05)
        children = up.children("")
    assert up.process.returncode == 0
    assert not any(is_running(pid) for pid in children)
    with sqlite3.connect(up.data / "wayloom.db") as database:
        assert database.execute("SELECT state, attempt FROM jobs WHERE stage = 'odometry'").fetchone() == ("queued", 0)
    database.close()


def test_a_broker_that_lost_everything_delays_a_drive_and_no_more(up: Up, tmp_path: Path) -> None:
    api = up.api()
    with held_up(up.data, "ingest"):
        busy = upload(api, packed_drive(tmp_path / "a", "busy"))["id"]
        until(lambda: stage(api, busy, "ingest")["state"] == "running")
        waiting = upload(api, packed_drive(tmp_path / "b", "waiting"))["id"]
        with Redis(unix_socket_path=str(ServiceSettings(data_dir=up.data).broker_socket)) as broker:
            broker.flushall()
    assert wait_for_drive(api, waiting)["state"] == "done"
    assert wait_for_drive(api, busy)["state"] == "done"


def test_a_broker_that_is_killed_is_started_again_and_the_drive_goes_on(tmp_path: Path) -> None:
    with service(tmp_path / "data") as up:
        api = up.api()
        drive_id = upload(api, packed_drive(tmp_path / "a", play={"odometry": {"seconds": 0.5}}))["id"]
        up.kill("unixsocket")
        assert wait_for_drive(api, drive_id)["state"] == "done"
        assert starts(up, drive_id) == dict.fromkeys(drive_stages(), 1)


def test_messages_delivered_many_times_and_a_second_sweeper_do_no_harm(up: Up, tmp_path: Path) -> None:
    from celery import Celery

    from wayloom.store.queues import celery_settings

    broker = Celery(set_as_current=False)
    broker.conf.update(celery_settings(ServiceSettings(data_dir=up.data).broker))
    second = subprocess.Popen(
        [sys.executable, "-m", "wayloom_workers", "sweep"],
        env=environment(WAYLOOM_DATA_DIR=str(up.data), WAYLOOM_SWEEP_S="0.1", WAYLOOM_RESEND_S="0.2"),
        stderr=subprocess.DEVNULL,
    )
    try:
        api = up.api()
        drive_id = upload(api, packed_drive(tmp_path / "a", play={name: {"seconds": 0.2} for name in drive_stages()}))["id"]
        deadline = time.monotonic() + 30
        while api.drive(drive_id)["state"] not in ("done", "failed") and time.monotonic() < deadline:
            for job_id in range(1, 60):
                for queue in queues()[:1]:
                    broker.send_task(TASK_NAME, args=[job_id], queue=queue)
            time.sleep(0.3)
        assert api.drive(drive_id)["state"] == "done"
        assert starts(up, drive_id) == dict.fromkeys(drive_stages(), 1)
    finally:
        broker.close()
        second.send_signal(signal.SIGTERM)
        second.wait(10)


def test_a_stage_that_fails_is_tried_again_and_then_given_up_with_its_reason(up: Up, tmp_path: Path) -> None:
    api = up.api()
    twice = wait_for_drive(api, upload(api, packed_drive(tmp_path / "a", "twice", {"odometry": {"fail": 2}}))["id"])
    assert (twice["state"], twice["stages"][1]["attempt"]) == ("done", 3)
    always = wait_for_drive(api, upload(api, packed_drive(tmp_path / "b", "always", {"odometry": {"fail": 9}}))["id"])
    assert (always["state"], always["error"]) == ("failed", "odometry: RuntimeError: no luck this time")
    assert always["stages"][1]["attempt"] == 3
    bad = wait_for_drive(api, upload(api, packed_drive(tmp_path / "c", "bad", {"segmentation": {"bad": True}}))["id"])
    assert bad["error"] == "segmentation: left.png, line 1: is damaged; record it again"
    assert bad["stages"][2]["attempt"] == 1
    (up.data / "drives" / bad["id"] / "log" / "play.json").write_text("{}")
    api.once("POST", f"/v1/drives/{bad['id']}/retry")
    assert wait_for_drive(api, bad["id"])["state"] == "done"
    assert starts(up, bad["id"]) == {**dict.fromkeys(drive_stages(), 1), "segmentation": 2}


def test_a_stage_that_kills_its_worker_each_time_is_quarantined_with_its_traceback(up: Up, tmp_path: Path) -> None:
    api = up.api()
    drive = wait_for_drive(api, upload(api, packed_drive(tmp_path / "a", "crash", {"odometry": {"crash": True}}))["id"])
    assert drive["state"] == "failed"
    assert "quarantined" in drive["error"]
    assert "Fatal Python error: Aborted" in drive["error"]
    assert "little_stages.py" in drive["error"]
    assert starts(up, drive["id"])["odometry"] == 3


def test_a_full_disk_and_killed_workers_use_up_no_attempt(up: Up, tmp_path: Path) -> None:
    api = up.api()
    drive_id = upload(api, packed_drive(tmp_path / "a", "full", {"odometry": {"full": 4}}))["id"]
    killed: set[str] = set()

    def at_work() -> set[str]:
        return {run[3] for run in up.runs() if run[:2] == ["start", "labelling"] and run[4] == drive_id} - killed

    with held_up(up.data, "labelling"):
        for lost in range(4):
            (pid,) = until(at_work)
            killed.add(pid)
            Up.kill_process(int(pid))
            until(lambda lost=lost: len(stage(api, drive_id, "labelling")["losses"]) == lost + 1)
    drive = wait_for_drive(api, drive_id)
    assert drive["state"] == "done"
    assert {one["attempt"] for one in drive["stages"]} == {1}
    assert starts(up, drive_id)["odometry"] == 5


def test_a_stage_that_takes_too_long_or_too_much_memory_fails_and_says_so(tmp_path: Path) -> None:
    limits = {"WAYLOOM_STAGE_LIMIT_S": "8", "WAYLOOM_STAGE_MEMORY_BYTES": str(4 << 30), "WAYLOOM_MAX_ATTEMPTS": "1"}
    with service(tmp_path / "data", **limits) as up:
        api = up.api()
        hangs = wait_for_drive(api, upload(api, packed_drive(tmp_path / "a", "hangs", {"odometry": {"hang": True}}))["id"])
        assert (hangs["state"], "longer than 8 s" in hangs["error"]) == ("failed", True)
        hoards = wait_for_drive(api, upload(api, packed_drive(tmp_path / "b", "hoards", {"odometry": {"hoard": 8 << 30}}))["id"])
        assert (hoards["state"], "MemoryError" in hoards["error"]) == ("failed", True)
        assert wait_for_drive(api, upload(api, packed_drive(tmp_path / "c", "good"))["id"])["state"] == "done"


def test_a_drive_is_cancelled_and_begun_again_at_a_stage_that_was_done(up: Up, tmp_path: Path) -> None:
    api = up.api()
    with held_up(up.data, "labelling"):
        drive_id = upload(api, packed_drive(tmp_path / "a", "cancelled"))["id"]
        until(lambda: stage(api, drive_id, "labelling")["progress"] > 0.1)
        assert api.once("POST", f"/v1/drives/{drive_id}/cancel").json()["error"] == "labelling: cancelled"
    time.sleep(1.0)
    assert api.drive(drive_id)["state"] == "failed"
    with pytest.raises(AnswerError, match="no stage to cancel"):
        api.once("POST", f"/v1/drives/{drive_id}/cancel")
    output = next((up.data / "drives" / drive_id / "stages" / "odometry").glob("*/result.json"))
    output.write_text("damaged")
    api.once("POST", f"/v1/drives/{drive_id}/retry", json={"stage": "odometry"})
    assert wait_for_drive(api, drive_id)["state"] == "done"
    assert output.read_text() != "damaged"
    assert starts(up, drive_id) == {**dict.fromkeys(drive_stages(), 1), "odometry": 2, "segmentation": 2, "labelling": 2}


def test_a_drive_without_a_place_on_earth_ends_outside_of_the_map_and_says_so(up: Up, tmp_path: Path) -> None:
    api = up.api()
    drive = wait_for_drive(api, upload(api, packed_drive(tmp_path / "a", play={"placed": False}))["id"])
    assert (drive["state"], drive["placed"], drive["quality"]["gate"]) == ("held", False, "hold")
    assert "not geo-referenced" in drive["note"]
    assert drive["stages"][-1]["stage"] == "objects"


def test_a_killed_child_is_started_again(tmp_path: Path) -> None:
    with service(tmp_path / "data") as up:
        for what in ("wayloom_services", "wayloom_workers sweep"):
            pid = up.kill(what)
            until(lambda what=what, pid=pid: [found for found in up.children(what) if found != pid])
        until(lambda: up.api().json("GET", "/readyz")["status"] == "ok")


@pytest.mark.parametrize(
    ("arguments", "variables", "said"),
    [
        (("--host", "0.0.0.0"), {}, "no API key"),
        (("--port", "99999"), {}, "--port"),
        (("--host", "no.such.host.invalid"), {"WAYLOOM_API_KEY": "k" * 20}, "no address"),
        ((), {"WAYLOOM_LEASE_S": "soon"}, "WAYLOOM_LEASE_S"),
        (("--data", "/proc/nothing"), {}, "/proc/nothing"),
    ],
)
def test_up_refuses_what_cannot_be_with_one_line(
    tmp_path: Path, arguments: tuple[str, ...], variables: dict[str, str], said: str
) -> None:
    code, error = run_up(tmp_path / "data", *arguments, **variables)
    assert (code, len(error.splitlines())) == (2, 1)
    assert said in error
    assert "Traceback" not in error


def test_a_taken_port_and_a_folder_in_use_are_said(tmp_path: Path) -> None:
    with service(tmp_path / "data") as up:
        code, error = run_up(tmp_path / "other", "--port", up.url.rpartition(":")[2])
        assert (code, "cannot listen" in error) == (2, True)
        code, error = run_up(tmp_path / "data", "--port", "0")
        assert (code, "another `wayloom up`" in error) == (2, True)


def run_up(data: Path, *arguments: str, **variables: str) -> tuple[int, str]:
    given = [] if "--data" in arguments else ["--data", str(data)]
    command = [sys.executable, "-m", "wayloom.cli.main", "up", *given, *arguments]
    done = subprocess.run(
        command, env=environment(**variables), capture_output=True, text=True, timeout=60, cwd=os.fspath(data.parent)
    )
    return done.returncode, done.stderr
