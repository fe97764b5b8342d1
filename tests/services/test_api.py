"""Drives and maps over HTTP; errors as problem+json; who may ask."""

import hashlib
import json
import threading
import time
from dataclasses import replace
from pathlib import Path

import httpx2
import numpy as np
import pytest

from service_kit.running import ApiAlone
from service_kit.tus import CHUNK, V, checksum, create, head, register
from wayloom.store import drives, gate, maps
from wayloom.store.blobs import BlobStore
from wayloom.store.database import Database
from wayloom.store.manifest import Manifest
from wayloom.store.map_versions import NewVersion, TileEntry, publish
from wayloom.store.migrate import upgrade
from wayloom.store.tables.drives import SubmapRow
from wayloom_services import events
from wayloom_services.etas import Past
from workers.test_stitching import placed

DIGEST = hashlib.sha256(b"").hexdigest()
FILE = {"path": "log/a", "size": 3, "sha256": "0" * 64}


def test_the_same_manifest_twice_is_the_same_drive(http: httpx2.Client) -> None:
    manifest = {"name": "twice", "vehicle_id": "car 7", "files": [{"path": "log/a", "size": 3, "sha256": "0" * 64}]}
    first, again = http.post("/v1/drives", json=manifest), http.post("/v1/drives", json=manifest)
    assert (first.status_code, again.status_code) == (201, 200)
    assert first.json()["id"] == again.json()["id"] == Manifest.model_validate(manifest).drive_id
    assert first.headers["Location"] == f"/v1/drives/{first.json()['id']}"
    assert [file["path"] for file in again.json()["missing"]] == ["log/a"]


HTML, JSON = "text/html,application/xhtml+xml;q=0.9,*/*;q=0.8", "application/json"


@pytest.mark.parametrize("path", ["/drives/nonsense", "/nonsense", "/v1/nonsense", "/static/nonsense"])
@pytest.mark.parametrize("accept", [HTML, JSON, "*/*"])
def test_programs_get_a_problem_of_what_is_not_there_and_browsers_a_page(http: httpx2.Client, path: str, accept: str) -> None:
    answer = http.get(path, headers={"Accept": accept})
    assert answer.status_code == 404
    is_page = accept == HTML and not path.startswith(("/v1", "/static"))
    assert answer.headers["content-type"] == ("text/html; charset=utf-8" if is_page else "application/problem+json")
    if is_page:
        assert (answer.headers["cache-control"], answer.headers["vary"]) == ("no-store", "Accept, Accept-Encoding")
        assert "script-src 'self'" in answer.headers["content-security-policy"]
    else:
        assert answer.json()["code"] == "not-found"


def test_a_file_that_was_begun_says_where_to_go_on(http: httpx2.Client) -> None:
    drive = register(http, "begun", a=b"0123456789")
    address = create(http, drive, "log/a", 10, b"0123").headers["Location"]
    files = [{"path": "log/a", "size": 10, "sha256": hashlib.sha256(b"0123456789").hexdigest()}]
    (missing,) = http.post("/v1/drives", json={"name": "begun", "files": files}).json()["missing"]
    assert (missing["upload"], missing["offset"]) == (address, 4)


@pytest.mark.parametrize(
    "change",
    [
        {"files": []},
        {"files": [{"path": "log/../a", "size": 1, "sha256": DIGEST}]},
        {"files": [{"path": "log/a", "size": -1, "sha256": DIGEST}]},
        {"files": [{"path": "log/a", "size": 1, "sha256": "abc"}]},
        {"files": [{"path": "log/a", "size": 1, "sha256": DIGEST}, {"path": "log/A", "size": 1, "sha256": DIGEST}]},
        {"name": ""},
        {"state": "done"},
        {"id": "f" * 64},
    ],
)
def test_a_bad_manifest_is_refused_with_the_place_of_the_fault(http: httpx2.Client, change: dict[str, object]) -> None:
    manifest = {"name": "bad", "files": [{"path": "log/a", "size": 1, "sha256": DIGEST}], **change}
    answer = http.post("/v1/drives", json=manifest)
    assert answer.status_code == 422
    assert answer.headers["Content-Type"] == "application/problem+json"
    assert answer.json()["code"] == "malformed-request"
    assert answer.json()["errors"][0]["where"].startswith("body")


def test_a_manifest_of_very_many_files_holds_up_nobody_else(http: httpx2.Client, api_process: ApiAlone) -> None:
    files = [{"path": f"log/image_0/{i:010}.png", "size": 1, "sha256": hashlib.sha256(b"x").hexdigest()} for i in range(20_000)]
    content = json.dumps({"name": "many", "files": files}).encode()
    answers: list[httpx2.Response] = []

    def send() -> None:
        with httpx2.Client(base_url=api_process.url, timeout=120.0, trust_env=False) as own:
            answers.append(own.post("/v1/drives", content=content, headers={"Content-Type": "application/json"}))

    register(http, "the first", a=b"1")  # what a process does once is not asked for here
    sender, longest = threading.Thread(target=send), 0.0
    started = time.monotonic()
    sender.start()
    while sender.is_alive():
        asked = time.monotonic()
        assert http.get("/healthz").status_code == 200
        longest = max(longest, time.monotonic() - asked)
    took = time.monotonic() - started
    assert answers[0].status_code == 201
    missing = answers[0].json()["missing"]
    assert [file["path"] for file in missing] == [file["path"] for file in files]
    assert longest < took / 4
    assert http.delete(f"/v1/drives/{answers[0].json()['id']}").status_code == 202


def test_a_drive_is_listed_with_its_stages_and_what_has_come(http: httpx2.Client) -> None:
    drive = register(http, "listed", a=b"0123456789", b=b"xx")
    create(http, drive, "log/a", 10, b"0123456789", **checksum(b"0123456789"))
    found = next(one for one in http.get("/v1/drives").json()["drives"] if one["id"] == drive)
    assert (found["state"], found["received_files"], found["received_bytes"], found["bytes"]) == ("uploading", 1, 10, 12)
    assert [stage["stage"] for stage in found["stages"]][:2] == ["ingest", "odometry"]
    assert http.get(f"/v1/drives/{drive}").json()["progress"] == pytest.approx(10 / 12)


def test_drives_come_in_pages(http: httpx2.Client) -> None:
    ids = [register(http, f"page {i}", a=bytes([i])) for i in range(3)]
    first = http.get("/v1/drives?limit=2").json()
    second = http.get(f"/v1/drives?limit=2&before={first['next_before']}").json()
    assert [drive["id"] for drive in first["drives"] + second["drives"]][:3] == ids[::-1]


def test_without_a_broker_a_whole_drive_waits_for_better_times(http: httpx2.Client) -> None:
    started = time.monotonic()
    drive = register(http, "no broker", a=b"abc")
    assert create(http, drive, "log/a", 3, b"abc").status_code == 201
    assert time.monotonic() - started < 15
    found = http.get(f"/v1/drives/{drive}").json()
    assert (found["state"], found["stage"]) == ("queued", "ingest")
    ready = http.get("/readyz")
    assert ready.status_code == 200
    assert ready.json()["status"] == "degraded"


def test_a_drive_to_be_removed_is_shown_as_such_and_cannot_come_back_meanwhile(http: httpx2.Client) -> None:
    drive = register(http, "removed", a=b"abc")
    assert http.delete(f"/v1/drives/{drive}").json()["state"] == "removing"
    assert http.delete(f"/v1/drives/{drive}").status_code == 409
    files = [{"path": "log/a", "size": 3, "sha256": hashlib.sha256(b"abc").hexdigest()}]
    assert http.post("/v1/drives", json={"name": "removed", "files": files}).status_code == 409


@pytest.mark.parametrize("path", ["/v1/drives/" + "f" * 64, "/v1/nothing", "/v1/maps/nowhere", "/v1/submaps/" + "f" * 64, "/other"])
def test_what_is_not_there_is_a_problem_document(http: httpx2.Client, path: str) -> None:
    answer = http.get(path)
    assert answer.status_code == 404
    assert answer.headers["Content-Type"] == "application/problem+json"
    assert answer.json()["code"] == "not-found"
    assert set(answer.json()) >= {"type", "title", "status", "code", "detail"}


def test_a_drive_without_a_failure_cannot_be_retried(http: httpx2.Client) -> None:
    assert http.post(f"/v1/drives/{register(http, 'fine', a=b'1')}/retry").status_code == 409
    assert http.post(f"/v1/drives/{'e' * 64}/retry").status_code == 404


def test_submaps_of_a_box_and_their_bytes(http: httpx2.Client, api_process: ApiAlone) -> None:
    drive = register(http, "with submap", a=b"1")
    digest = BlobStore(api_process.data / "blobs").put(placed("a", 1).submap.encoded)
    database = Database(f"sqlite:///{api_process.data / 'wayloom.db'}")
    with database.write() as session:
        row = SubmapRow(
            drive_id=drive, map_id="city", position=0, digest=digest, point_count=6, frame=[8.5, 49.5, 0.0],
            T_enu_submap=np.eye(4).tolist(), covariance=np.eye(6).tolist(), min_lon=8.0, min_lat=49.0, max_lon=8.1, max_lat=49.1,
        )  # fmt: skip
        maps.place_submaps(session, drive, [row])
        gate.judge(session, drive, "A", [], "merge")
        drives.get(session, drive).track = [[8.0, 49.0, 1.0], [8.1, 49.1, 1.0]]
    database.close()
    (found,) = http.get("/v1/maps/city/submaps?bbox=8.05,49.05,9,50").json()["submaps"]
    assert (found["digest"], found["points"]) == (digest, 6)
    assert http.get("/v1/maps/city/submaps?bbox=8.2,49.05,9,50").json()["submaps"] == []
    assert http.get(f"/v1/submaps/{digest}").content == placed("a", 1).submap.encoded
    line = {"type": "LineString", "coordinates": [[8.0, 49.0, 1.0], [8.1, 49.1, 1.0]]}
    assert http.get(f"/v1/drives/{drive}/track").json()["geometry"] == line


@pytest.mark.parametrize("box", ["", "1,2,3", "a,b,c,d", "8,50,9,49", "8,49,190,50", "-999,0,999,1", "nan,0,1,1"])
def test_a_box_that_is_none_is_refused(http: httpx2.Client, box: str) -> None:
    assert http.get("/v1/maps/city/submaps", params={"bbox": box}).status_code == 400


def test_events_begin_with_everything_and_go_on_with_changes(http: httpx2.Client) -> None:
    drive = register(http, "watched", a=b"12")
    seen: list[tuple[str, int]] = []
    with http.stream("GET", "/v1/events") as answer:
        assert answer.headers["Content-Type"].startswith("text/event-stream")
        event = ""
        for line in answer.iter_lines():
            event = line.removeprefix("event: ") if line.startswith("event: ") else event
            if not line.startswith("data: ") or event != "drive":
                continue
            data = json.loads(line.removeprefix("data: "))
            if data["id"] == drive:
                seen.append((data["state"], data["received_files"]))
                if len(seen) == 1:
                    create(http, drive, "log/a", 2, b"12")
                if seen[-1][0] == "queued":
                    break
    assert seen[0] == ("uploading", 0)
    assert seen[-1] == ("queued", 1)


def test_a_drive_that_newer_ones_push_out_of_sight_is_not_told_as_removed(tmp_path: Path) -> None:
    database = Database(f"sqlite:///{tmp_path / 'wayloom.db'}")
    upgrade(database)
    with database.write() as session:
        first, second = (
            drives.register(session, Manifest.model_validate({"name": name, "files": [FILE]}), "city")[0].id for name in "ab"
        )
        drives.delete_rows(session, second)
    before = {("drive", first): "{}", ("drive", second): "{}"}
    with database.read() as session:
        _, removed, _ = events._look(Past(), before, session)
    assert removed == [second]
    database.close()


def test_a_publication_names_its_tiles_once_and_after_a_pause_those_of_every_version(tmp_path: Path) -> None:
    database = Database(f"sqlite:///{tmp_path / 'wayloom.db'}")
    upgrade(database)
    tiles = [TileEntry("semantic", 18, x, 2, f"{x:064}", "image/png", 1) for x in range(3)]
    new = NewVersion(0, (8.5, 49.5, 0.0), (), 1, None, tiles[:2])
    with database.write() as session:
        maps.ensure_map(session, "city")
        publish(session, "city", new, kept=9)
    with database.read() as session:
        first, _, named = events._look(Past(), {("map", "city"): '{"id": "city", "version": 0}'}, session)
        changed = {"semantic": ["18/0/2", "18/1/2"]}
        said = {"map": "city", "version": 1, "count": 2, "whole": True, "changed": changed, "gone": {}}
        assert [(one.event, json.loads(one.data)) for one in named] == [("tiles", said)]
        nothing, again = events._look(Past(), {}, session)[2], events._look(Past(), first, session)[2]
    assert nothing == again == []  # the first look tells no history
    with database.write() as session:
        publish(session, "city", replace(new, base=1, tiles=tiles[2:], dropped_tiles=[tiles[0].key]), kept=9)
        publish(session, "city", replace(new, base=2, tiles=[]), kept=9)
    with database.read() as session:
        later = [json.loads(one.data) for one in events._look(Past(), first, session)[2]]
    assert [(one["version"], one["count"]) for one in later] == [(2, 2), (3, 0)]
    assert (later[0]["changed"], later[0]["gone"]) == ({"semantic": ["18/2/2"]}, {"semantic": ["18/0/2"]})
    database.close()


@pytest.mark.parametrize("announced", [True, False])
def test_a_request_longer_than_any_manifest_is_refused(tmp_path: Path, announced: bool) -> None:
    alone = ApiAlone(tmp_path / "data", WAYLOOM_MAX_MANIFEST_BYTES="5000", WAYLOOM_API_KEY="a key for the test")
    manifest = json.dumps({"name": "long", "files": [FILE], "format": None}).encode()
    try:
        with httpx2.Client(base_url=alone.url, timeout=30.0, trust_env=False) as client:
            for key, length, status in (
                ("a key for the test", 5000, 201),
                ("a key for the test", 5001, 413),
                ("another", 5000, 401),  # a stranger's body is not read
            ):
                body = manifest + b" " * (length - len(manifest))
                content = body if announced else iter([body[:100], body[100:]])
                headers = {"Content-Type": "application/json", "Authorization": f"Bearer {key}"}
                answer = client.post("/v1/drives", content=content, headers=headers)
                assert answer.status_code == status
                assert answer.json().get("code") == {201: None, 401: "unauthorized", 413: "too-large"}[status]
    finally:
        alone.close()


def test_health_metrics_and_info(http: httpx2.Client) -> None:
    assert http.get("/healthz").json()["status"] == "ok"
    http.get("/v1/drives/" + "c" * 64)
    http.request("CHOSEN-BY-A-CLIENT", "/v1/drives")
    text = http.get("/metrics").text
    assert "CHOSEN" not in text
    assert 'wayloom_http_requests_total{method="GET",route="/v1/drives/{drive_id}",status="404"}' in text
    assert "c" * 64 not in text
    assert "wayloom_drives{" in text
    info = http.get("/v1/info").json()
    assert info["classes"][0] == {"id": 0, "name": "road", "colour": "#804080", "in_map": True}
    assert info["needs_key"] is False


def test_the_openapi_document_describes_every_route_with_its_answers(http: httpx2.Client) -> None:
    document = http.get("/v1/openapi.json").json()
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            successes = {
                status: answer for status, answer in operation["responses"].items() if status.startswith("2") or status == "303"
            }
            assert successes, f"{method} {path}"
            for status, answer in successes.items():
                described = "content" in answer or status in ("204", "303") or path.startswith("/v1/uploads")
                assert described, f"{method} {path} {status}"
    assert "Problem" in document["components"]["schemas"]


def test_the_dashboard_loads_nothing_from_elsewhere(http: httpx2.Client) -> None:
    page = http.get("/")
    assert "default-src 'self'" in page.headers["Content-Security-Policy"]
    assert "http://" not in page.text
    assert "https://" not in page.text
    for path in ("app.js", "style.css", "vendor/maplibre-gl/maplibre-gl.mjs", "vendor/maplibre-gl/LICENSE.txt"):
        assert http.get(f"/static/{path}").status_code == 200
    assert "javascript" in http.get("/static/vendor/maplibre-gl/maplibre-gl.mjs").headers["Content-Type"]
    assert http.get("/static/../app.py").status_code == 404


def test_the_vendored_files_are_the_ones_that_their_readme_names() -> None:
    import wayloom_services

    folder = Path(str(wayloom_services.__file__)).parent / "static" / "vendor" / "maplibre-gl"
    listed = [
        line.split()
        for line in (folder / "README.md").read_text().splitlines()
        if len(line.split()) == 2 and len(line.split()[0]) == 64
    ]
    for digest, name in listed[1:]:
        assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == digest
    assert {name for _, name in listed[1:]} == {path.name for path in folder.iterdir()} - {"README.md"}


def test_a_server_with_a_key_answers_only_those_who_have_it(tmp_path: Path) -> None:
    key = "correct horse battery"
    alone = ApiAlone(tmp_path / "data", WAYLOOM_API_KEY=key)
    try:
        with httpx2.Client(base_url=alone.url, timeout=30.0, trust_env=False) as http:
            for path in ("/v1/drives", "/v1/maps", "/v1/events", "/metrics", "/v1/maps/city/tiles/semantic/0/0/0.png"):
                for header in ({}, {"Authorization": "Bearer wrong"}, {"Authorization": f"Basic {key}"}):
                    answer = http.get(path, headers=header)
                    assert (answer.status_code, answer.json()["code"]) == (401, "unauthorized")
            assert http.post("/v1/uploads", headers={**CHUNK, "Upload-Length": "1"}).status_code == 401
            assert head(http, "/v1/uploads/x").status_code == 401
            assert http.get("/v1/drives", headers={"Authorization": f"Bearer {key}"}).status_code == 200
            assert http.get("/healthz").status_code == 200
            assert http.get("/v1/info").json()["needs_key"] is True
            assert http.delete("/v1/uploads/x", headers={**V, "Authorization": f"Bearer {key}"}).status_code == 404
    finally:
        alone.close()
