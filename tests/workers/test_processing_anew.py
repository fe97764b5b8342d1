"""A drive is processed anew while the map and its pages keep what they have, whatever happens to the new run."""

import json
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx2
import pytest

from service_kit.little_stages import held_up
from service_kit.packed_drives import packed_drive
from service_kit.running import Up, service, until
from wayloom.client.api import Api
from wayloom.client.upload import upload
from wayloom.client.watch import wait_for_drive
from wayloom.errors import ServiceError


@pytest.fixture(scope="module")
def up(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Up]:
    with service(tmp_path_factory.mktemp("shared") / "data", "--workers", "2") as running:
        yield running


@pytest.fixture
def drive_id(up: Up, tmp_path: Path) -> str:
    """A drive that is in the map."""
    found: str = upload(up.api(), packed_drive(tmp_path, tmp_path.name))["id"]
    assert wait_for_drive(up.api(), found)["state"] == "done"
    return found


def play(up: Up, drive_id: str, **stages: object) -> None:
    """What the stages of the drive do from now on."""
    (up.data / "drives" / drive_id / "log" / "play.json").write_text(json.dumps(stages))


def reprocess(api: Api, drive_id: str, reach: int = 3) -> dict[str, Any]:
    asked = {"labelling": {"reach": reach}}
    found: dict[str, Any] = api.once("POST", f"/v1/drives/{drive_id}/reprocess", json=asked).json()
    return found


def page(api: Api, drive_id: str) -> tuple[object, ...]:
    """What the drive's pages say of its result."""
    drive = api.drive(drive_id)
    track = api.json("GET", f"/v1/drives/{drive_id}/track")["geometry"]
    return drive["state"], drive["quality"], drive["facts"], drive["placed"], drive["note"], track


class Reader:
    """A client that reads the tile of the newest version again and again."""

    def __init__(self, up: Up) -> None:
        self._up, self._stop = up, threading.Event()
        self.seen: list[tuple[int, bytes]] = []
        self._thread = threading.Thread(target=self._read)

    def __enter__(self) -> "Reader":
        self._thread.start()
        until(lambda: self.seen)
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def _read(self) -> None:
        with httpx2.Client(base_url=self._up.url, timeout=30.0, trust_env=False) as http:
            coverage = http.get("/v1/maps/city/coverage?of=tiles").json()["features"][0]["properties"]
            path = f"/v1/maps/city/tiles/semantic/{coverage['z']}/{coverage['x']}/{coverage['y']}.png"
            while not self._stop.wait(0.05):
                answer = http.get(path)
                self.seen.append((answer.status_code, answer.content))


def test_readers_see_the_old_result_until_the_new_one_is_published(up: Up, drive_id: str) -> None:
    api = up.api()
    play(up, drive_id, labelling={"seconds": 1.0}, grade="B")
    before, version = page(api, drive_id), api.json("GET", "/v1/maps/city")["version"]
    with Reader(up) as reader:
        said = reprocess(api, drive_id)
        assert (said["state"], said["reprocess"]["state"]) == ("done", "running")
        assert said["reprocess"]["asked"] == {"labelling": {"reach": 3}}
        with pytest.raises(ServiceError, match="is being processed anew already"):
            reprocess(api, drive_id)
        shown = page(api, drive_id)
        while api.json("GET", "/v1/maps/city")["version"] == version:
            assert shown[1:] == before[1:]
            shown = page(api, drive_id)
        until(lambda: api.drive(drive_id)["reprocess"] is None)
    drive = api.drive(drive_id)
    assert (drive["state"], drive["quality"]["grade"]) == ("done", "B")
    assert {answer for answer, _ in reader.seen} == {200}
    assert len({content for _, content in reader.seen}) == 1


def test_a_run_that_fails_changes_nothing_and_goes_on_when_it_is_told_to(up: Up, drive_id: str) -> None:
    api = up.api()
    before, version = page(api, drive_id), api.json("GET", "/v1/maps/city")["version"]
    play(up, drive_id, segmentation={"bad": True})
    with Reader(up) as reader:
        reprocess(api, drive_id)
        until(lambda: api.drive(drive_id)["reprocess"]["state"] == "failed")
    assert "record it again" in api.drive(drive_id)["reprocess"]["error"]
    assert page(api, drive_id) == before
    assert api.json("GET", "/v1/maps/city")["version"] == version
    assert {answer for answer, _ in reader.seen} == {200}
    play(up, drive_id)
    api.once("POST", f"/v1/drives/{drive_id}/retry")
    until(lambda: api.drive(drive_id)["reprocess"] is None)
    assert api.json("GET", "/v1/maps/city")["version"] > version


def test_a_run_whose_worker_is_killed_ends_as_one_that_was_not(up: Up, drive_id: str) -> None:
    api = up.api()
    before = page(api, drive_id)
    play(up, drive_id, odometry={"seconds": 0.1})
    with held_up(up.data, "odometry"):
        reprocess(api, drive_id)
        until(lambda: api.drive(drive_id)["stages"][1]["progress"] > 0.2)
        for pid in up.children("wayloom_workers worker"):
            up.kill_process(pid)
        assert page(api, drive_id) == before
    until(lambda: api.drive(drive_id)["reprocess"] is None)
    assert api.drive(drive_id)["state"] == "done"
    tracked = api.drive(drive_id)["stages"][1]
    assert (tracked["attempt"], len(tracked["losses"])) == (1, 1)


def test_a_drive_that_is_removed_while_it_is_processed_anew_is_gone_for_good(up: Up, drive_id: str) -> None:
    api = up.api()
    version = api.json("GET", "/v1/maps/city")["version"]
    play(up, drive_id, odometry={"seconds": 2.0})
    reprocess(api, drive_id)
    until(lambda: api.drive(drive_id)["stages"][1]["progress"] > 0.1)
    with Reader(up) as reader:
        api.once("DELETE", f"/v1/drives/{drive_id}")
        until(lambda: drive_id not in api.json("GET", "/v1/maps/city")["drives"])
    assert {answer for answer, _ in reader.seen} <= {200, 204}
    with httpx2.Client(base_url=up.url, trust_env=False) as http:
        answer = http.get(f"/v1/maps/city/versions/{version}")
        assert (answer.status_code, answer.json()["code"]) == (410, "withdrawn")
    until(lambda: not (up.data / "drives" / drive_id).exists())


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ({"model": "/etc/passwd"}, "unknown network"),
        ({"labelling": {"reach": -1}}, "greater than or equal to 0"),
        ({"odometry": {"no_such_key": 1}}, "no_such_key"),
        ({"rig_version": 3}, "names no rig"),
        ({"threads": 9}, "threads"),
    ],
)
def test_what_cannot_be_asked_for_is_refused(up: Up, drive_id: str, body: dict[str, object], said: str) -> None:
    with pytest.raises(ServiceError, match=said):
        up.api().once("POST", f"/v1/drives/{drive_id}/reprocess", json=body)
    assert up.api().drive(drive_id)["reprocess"] is None
