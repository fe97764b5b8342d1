"""The client: what it packs, and that it ends with every byte on the server whatever happens on the way."""

import hashlib
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx2
import pytest

from service_kit import tus
from service_kit.packed_drives import packed_drive, packed_drive_of
from service_kit.running import ApiAlone, Up, environment, service, until
from wayloom.client.api import AnswerError, Api
from wayloom.client.manifests import pack
from wayloom.client.upload import upload
from wayloom.client.watch import NEARLY_DONE, wait_for_drive
from wayloom.config.backoff import Backoff
from wayloom.errors import ConfigError, LogError, ServiceError


@pytest.fixture
def api(alone: ApiAlone) -> Iterator[Api]:
    with Api(alone.url) as found:
        yield found


def arrived(server: ApiAlone, drive_id: str) -> dict[str, bytes]:
    folder = server.data / "drives" / drive_id
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_every_byte_of_a_drive_arrives(alone: ApiAlone, api: Api, tmp_path: Path) -> None:
    sent = packed_drive(tmp_path, "whole", sizes=(0, 1, 1000, 70_000, 3 << 20))
    told: list[float] = []
    registration = upload(api, sent, lambda share, _what: told.append(share), chunk=1 << 20)
    assert registration["missing"] == []
    assert arrived(alone, registration["id"]) == {name: path.read_bytes() for name, path in sent.sources.items()}
    assert told[-1] == 1.0
    assert told == sorted(told)


def test_a_drive_that_is_there_is_not_sent_again(api: Api, tmp_path: Path) -> None:
    sent = packed_drive(tmp_path, "again", sizes=(5000,))
    first = upload(api, sent)
    for path in sent.sources.values():
        path.unlink()
    again = upload(api, sent)
    assert (first["id"], again["created"], again["missing"]) == (again["id"], False, [])


def test_an_upload_goes_on_while_the_server_is_killed_and_comes_back(tmp_path: Path) -> None:
    server = ApiAlone(tmp_path / "data")
    sent = packed_drive(tmp_path / "files", "killed", sizes=(4 << 20,) * 10)
    reached = threading.Event()
    results: list[dict[str, object]] = []

    def told(share: float, what: str, /) -> None:
        if share > 0.25:
            reached.set()

    def send() -> None:
        with Api(server.url) as api:
            try:
                results.append(upload(api, sent, told, chunk=1 << 20))
            except Exception as error:
                results.append({"error": repr(error)})

    sender = threading.Thread(target=send)
    try:
        sender.start()
        assert reached.wait(30)
        server.kill()
        time.sleep(0.3)
        server.start()
        sender.join(60)
        assert len(results) == 1
        assert "error" not in results[0], results[0]
        assert arrived(server, str(results[0]["id"])) == {name: path.read_bytes() for name, path in sent.sources.items()}
    finally:
        server.close()


def test_a_client_that_was_killed_goes_on_where_it_was(alone: ApiAlone, tmp_path: Path) -> None:
    sent = packed_drive(tmp_path, "client killed", sizes=(2 << 20,) * 12)
    script = "import sys, pickle; from wayloom.client.api import Api; from wayloom.client.upload import upload\n"
    script += "import time; slow = lambda share, what: time.sleep(0.1)\n"
    script += "upload(Api(sys.argv[1]), pickle.load(open(sys.argv[2], 'rb')), slow, chunk=1 << 19)"
    import pickle

    (tmp_path / "packed_drive").write_bytes(pickle.dumps(sent))
    process = subprocess.Popen([sys.executable, "-c", script, alone.url, str(tmp_path / "packed_drive")], env=environment())
    drive_id = sent.manifest.drive_id
    with Api(alone.url) as api:
        until(lambda: (alone.data / "drives" / drive_id).exists() and any((alone.data / "drives" / drive_id).rglob("*.png")))
        process.kill()
        process.wait()
        told: list[float] = []
        upload(api, sent, lambda share, _what: told.append(share))
    assert 0 < told[0] < 1
    assert arrived(alone, drive_id) == {name: path.read_bytes() for name, path in sent.sources.items()}


def test_a_file_that_was_whole_but_not_verified_when_the_server_died_is_finished(alone: ApiAlone, api: Api, tmp_path: Path) -> None:
    content = os.urandom(5000)
    sent = packed_drive_of(tmp_path, "unverified", {"log/a": content})
    drive_id = api.json("POST", "/v1/drives", json=sent.manifest.model_dump(mode="json", exclude_none=True))["id"]
    with httpx2.Client(base_url=alone.url, trust_env=False) as http:
        address = str(tus.create(http, drive_id, "log/a", len(content)).headers["Location"])
    (alone.data / "uploads" / f"{address.rpartition('/')[2]}.part").write_bytes(content)
    assert upload(api, sent)["missing"] == []
    assert arrived(alone, drive_id) == {"log/a": content}


def test_a_file_that_changes_on_the_way_is_said(api: Api, tmp_path: Path) -> None:
    sent = packed_drive_of(tmp_path, "changed", {"log/a": os.urandom(5000)})
    sent.sources["log/a"].write_bytes(b"short")
    with pytest.raises(LogError, match="shorter"):
        upload(api, sent)
    sent.sources["log/a"].unlink()
    with pytest.raises(LogError, match="cannot be read"):
        upload(api, sent)


def test_a_refusal_that_does_not_pass_soon_is_not_tried_again(alone: ApiAlone, tmp_path: Path) -> None:
    tried: list[str] = []

    class UsedUp(Api):
        """A server whose quota is used up for an hour when bytes come."""

        def once(self, method: str, path: str, **request: Any) -> httpx2.Response:
            if method == "PATCH":
                tried.append(path)
                raise AnswerError(429, "quota", "used up", after_s=3600.0)
            return super().once(method, path, **request)

    with UsedUp(alone.url) as api, pytest.raises(AnswerError, match="used up"):
        upload(api, packed_drive_of(tmp_path, "used up", {"log/a": b"a"}))
    assert len(tried) == 1


def test_a_file_that_was_rewritten_is_said_though_the_server_is_away_after_its_refusal(alone: ApiAlone, tmp_path: Path) -> None:
    asked: list[str] = []

    class AwayOnce(Api):
        """A server that does not answer the first HEAD."""

        def once(self, method: str, path: str, **request: Any) -> httpx2.Response:
            asked.append(method)
            if method == "HEAD" and asked.count("HEAD") == 1:
                raise AnswerError(503, "away", "is being restarted")
            return super().once(method, path, **request)

    sent = packed_drive_of(tmp_path, "rewritten", {"log/a": b"before"})
    sent.sources["log/a"].write_bytes(b"after!")
    with AwayOnce(alone.url) as api, pytest.raises(LogError, match="has changed since it was announced"):
        upload(api, sent)
    assert asked.count("PATCH") == 1


def test_a_server_that_is_not_there_is_said() -> None:
    with Api("http://127.0.0.1:9", retries=Backoff(0.01, 0.01, 2)) as api, pytest.raises(ServiceError, match="does not answer"):
        api.json("GET", "/v1/drives")


def test_a_server_that_nobody_runs_is_asked_after_and_an_address_without_a_scheme_is_given_one() -> None:
    with (
        Api("http://127.0.0.1:9", retries=Backoff(0.01, 0.01, 1)) as api,
        pytest.raises(ServiceError, match="is `wayloom up` running"),
    ):
        api.json("GET", "/v1/drives")
    with pytest.raises(ConfigError, match=r"give it with its scheme: http://127\.0\.0\.1:9$"):
        Api("127.0.0.1:9")


def test_a_refusal_carries_its_status_and_code(api: Api) -> None:
    with pytest.raises(AnswerError, match="there is no drive") as caught:
        api.json("GET", f"/v1/drives/{'a' * 64}")
    assert (caught.value.status, caught.value.code) == (404, "not-found")


def few_frames(clip: Path, folder: Path, count: int = 4) -> Path:
    """The first frames of a recording in KITTI odometry layout."""
    for side in ("image_0", "image_1"):
        (folder / side).mkdir(parents=True)
        for name in sorted(os.listdir(clip / side))[:count]:
            (folder / side / name).write_bytes((clip / side / name).read_bytes())
    (folder / "calib.txt").write_bytes((clip / "calib.txt").read_bytes())
    (folder / "times.txt").write_text("".join((clip / "times.txt").read_text().splitlines(keepends=True)[:count]))
    return folder


@pytest.mark.real_data
def test_a_log_and_the_gnss_log_beside_it_are_packed_so_that_the_server_can_open_them(
    alone: ApiAlone, api: Api, clip_a: Path, clip_a_gnss: Path, tmp_path: Path
) -> None:
    from wayloom.logs.registry import open_log

    few = few_frames(clip_a, tmp_path / "few")
    packed = pack(few, clip_a_gnss, "car 7")
    registration = upload(api, packed)
    folder = alone.data / "drives" / registration["id"]
    here = open_log(few, gnss=clip_a_gnss)
    there = open_log(folder / packed.manifest.log, gnss=folder / str(packed.manifest.gnss))
    assert there.files == here.files
    assert there.gnss is not None
    assert here.gnss is not None
    assert (there.gnss.lon_lat_height == here.gnss.lon_lat_height).all()
    assert (there.p_cam_gnss == here.p_cam_gnss).all()
    assert packed.manifest.vehicle_id == "car 7"


@pytest.mark.real_data
def test_a_kitti_raw_log_with_its_calibration_beside_it_is_packed_whole(alone: ApiAlone, api: Api, clip_b: Path) -> None:
    from wayloom.logs.registry import open_log

    packed = pack(clip_b)
    assert packed.manifest.log == f"log/{clip_b.name}"
    registration = upload(api, packed)
    there = open_log(alone.data / "drives" / registration["id"] / packed.manifest.log)
    assert (len(there), there.gnss is not None) == (154, True)
    for file in packed.manifest.files[:5]:
        assert hashlib.sha256((alone.data / "drives" / registration["id"] / file.path).read_bytes()).hexdigest() == file.sha256


@pytest.mark.real_data
def test_the_command_uploads_waits_and_tells(tmp_path: Path, clip_a: Path) -> None:
    with service(tmp_path / "data", WAYLOOM_STAGE_HOOKS="service_kit.little_stages:easy_hooks") as up:
        few = few_frames(clip_a, tmp_path / "few")
        done = run_upload(up, few, "--wait", "--json")
        assert done.returncode == 0, done.stderr
        assert "in the map" in done.stderr
        (drive,) = json.loads(done.stdout)["drives"]
        assert (drive["state"], drive["files"]) == ("done", 10)
        on_terminal = run_upload(up, few, "--wait", on_terminal=True)
        assert (on_terminal.returncode, "publish" in on_terminal.stdout) == (0, True)
        (tmp_path / "nothing").mkdir()
        bad = run_upload(up, tmp_path / "nothing")
        assert (bad.returncode, len(bad.stderr.splitlines())) == (2, 1)
        two = run_upload(up, clip_a, str(clip_a), "--gnss", str(clip_a))
        assert two.returncode == 2


def run_upload(up: Up, log: Path, *arguments: str, on_terminal: bool = False) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "wayloom.cli.main", "upload", str(log), *arguments, "--to", up.url]
    terminal = "import os, pty, sys; sys.exit(os.waitstatus_to_exitcode(pty.spawn(sys.argv[1:])))"
    command = [sys.executable, "-c", terminal, *command] if on_terminal else command
    return subprocess.run(command, env=environment(), capture_output=True, text=True, timeout=120)


def answers(*drives: dict[str, object]) -> Api:
    """A server that says these things of a drive, one after the other."""

    class Answers(Api):
        def __init__(self) -> None:
            self._said = iter(drives)

        def drive(self, drive_id: str) -> dict[str, object]:
            return next(self._said)

    return Answers()


def test_waiting_for_a_drive_tells_the_progress_of_each_stage() -> None:
    def stage(name: str, state: str, progress: float, message: str = "", seconds: float | None = None) -> dict[str, object]:
        return {"stage": name, "state": state, "progress": progress, "message": message, "seconds": seconds}

    api = answers(
        {"state": "running", "stages": [stage("ingest", "done", 1.0, seconds=0.5), stage("odometry", "waiting", 0.0)]},
        {"state": "running", "stages": [stage("odometry", "running", 0.25, "frame 5 of 20")]},
        {"state": "running", "stages": [stage("odometry", "running", 1.0, "all frames")]},
        {"state": "done", "stages": [stage("odometry", "done", 1.0, seconds=3.25)]},
    )
    heard: list[tuple[str, float, str]] = []
    last = wait_for_drive(api, "d", lambda name: lambda share, what: heard.append((name, share, what)), {"ingest"}, poll_s=0.0)
    assert heard == [
        ("ingest", 1.0, "done before"),
        ("odometry", 0.25, "frame 5 of 20"),
        ("odometry", NEARLY_DONE, "all frames"),  # a stage is done when its result is kept, not when its work is
        ("odometry", 1.0, "done in 3.2 s"),
    ]
    assert last["state"] == "done"
