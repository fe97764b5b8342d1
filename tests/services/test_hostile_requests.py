"""Requests that are no requests: half of one, for another host, with two lengths; and what the service says when parts are away."""

import contextlib
import socket
import time
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import httpx2
import pytest

from service_kit.running import ApiAlone
from service_kit.tus import create, offset, register
from wayloom.store import maps
from wayloom.store.database import Database
from wayloom_workers.submap_rows import submap_row
from workers.test_stitching import placed


@pytest.fixture(scope="module")
def impatient(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ApiAlone]:
    alone = ApiAlone(tmp_path_factory.mktemp("api") / "data", WAYLOOM_REQUEST_HEAD_S="1", WAYLOOM_BODY_PAUSE_S="1")
    yield alone
    alone.close()


@pytest.fixture
def own(impatient: ApiAlone) -> Iterator[httpx2.Client]:
    with httpx2.Client(base_url=impatient.url, timeout=30.0, trust_env=False) as client:
        client.get("/healthz")
        yield client


def connect(server: ApiAlone, sent: bytes) -> socket.socket:
    where = urlsplit(server.url)
    link = socket.create_connection((str(where.hostname), int(where.port or 80)))
    link.settimeout(20)
    link.sendall(sent)
    return link


WHOLE = b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n"


@pytest.mark.parametrize("begun", [b"", b"GET /healthz HT", b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nX-A: b\r\n"])
def test_a_request_whose_head_does_not_come_is_dropped(impatient: ApiAlone, own: httpx2.Client, begun: bytes) -> None:
    link, started = connect(impatient, begun), time.monotonic()
    with link:
        with contextlib.suppress(ConnectionResetError):
            assert link.recv(1000) == b""
        assert time.monotonic() - started > 0.5


def test_the_second_half_request_on_a_connection_is_dropped_too(impatient: ApiAlone, own: httpx2.Client) -> None:
    with connect(impatient, WHOLE) as link:
        assert link.recv(10_000).startswith(b"HTTP/1.1 200")
        link.sendall(b"GET /hea")
        rest = b""
        with contextlib.suppress(ConnectionResetError):
            rest = b"".join(iter(lambda: link.recv(10_000), b""))  # the rest of the first answer, and the end
        assert b"HTTP/1.1" not in rest


def test_a_body_that_stops_coming_is_given_up_and_what_came_of_an_upload_is_kept(impatient: ApiAlone, own: httpx2.Client) -> None:
    head = "POST /v1/drives HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length: 100\r\n\r\n{"
    with connect(impatient, head.encode()) as link:
        assert link.recv(10_000).startswith(b"HTTP/1.1 408")
    drive = register(own, "stops", a=b"0123456789")
    address = create(own, drive, "log/a", 10).headers["Location"]
    head = f"PATCH {address} HTTP/1.1\r\nHost: localhost\r\nTus-Resumable: 1.0.0\r\nUpload-Offset: 0\r\nContent-Length: 10\r\n"
    with connect(impatient, f"{head}Content-Type: application/offset+octet-stream\r\n\r\n01234".encode()) as link:
        assert link.recv(10_000).startswith(b"HTTP/1.1 408")
    assert offset(own, address) == 5


@pytest.mark.parametrize(
    ("host", "status"),
    [
        ("localhost", 200), ("127.0.0.1:8088", 200), ("[::1]:8088", 200), ("LOCALHOST", 200), ("evil.example", 421),
        ("127.0.0.1.evil.example", 421), ("localhost.evil.example:8088", 421), ("", 421), ("169.254.169.254", 421),
    ],
)  # fmt: skip
def test_without_a_key_the_service_answers_to_this_machine_s_names_alone(own: httpx2.Client, host: str, status: int) -> None:
    answer = own.get("/v1/drives", headers={"Host": host})
    assert answer.status_code == status
    if status == 421:
        assert answer.json()["code"] == "wrong-host"


def test_a_request_with_two_lengths_is_refused(impatient: ApiAlone, own: httpx2.Client) -> None:
    head = b"POST /v1/drives HTTP/1.1\r\nHost: localhost\r\nContent-Length: 5\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n"
    with connect(impatient, head) as link:
        said = b"".join(iter(lambda: link.recv(10_000), b""))  # it closes the connection
        assert said.startswith(b"HTTP/1.1 400")
        assert b"bad-header" in said


def test_every_error_is_described_as_the_problem_that_is_sent(own: httpx2.Client) -> None:
    document = own.get("/v1/openapi.json").json()
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            for status, response in operation["responses"].items():
                if status.startswith("4"):
                    assert list(response["content"]) == ["application/problem+json"], (path, method, status)
    assert {"400", "412", "460"} <= document["paths"]["/v1/uploads"]["post"]["responses"].keys()
    body = document["paths"]["/v1/drives"]["post"]["requestBody"]["content"]["application/json"]["schema"]
    assert set(body["properties"]["files"]["items"]["properties"]) == {"path", "size", "sha256"}


def test_an_object_store_that_is_away_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {
        "AWS_ENDPOINT_URL": "http://127.0.0.1:9", "AWS_ALLOW_HTTP": "true", "AWS_ACCESS_KEY_ID": "a",
        "AWS_SECRET_ACCESS_KEY": "b", "AWS_REGION": "here",
    }.items():  # fmt: skip
        monkeypatch.setenv(name, value)
    alone = ApiAlone(tmp_path / "data", WAYLOOM_BLOB_URL="s3://bucket/prefix")
    try:
        with httpx2.Client(base_url=alone.url, timeout=60.0, trust_env=False) as client:
            ready = client.get("/readyz")
            assert ready.status_code == 503
            assert ready.json()["checks"]["objects"] != "ok"
            drive_id = register(client, "away", a=b"away")
            item = placed(drive_id, 1)
            database = Database(f"sqlite:///{alone.data / 'wayloom.db'}")
            with database.write() as session:
                maps.place_submaps(session, drive_id, [submap_row(drive_id, "city", 0, item)])
            database.close()
            answer = client.get(f"/v1/submaps/{item.submap.digest}")
            assert (answer.status_code, answer.json()["code"]) == (503, "away")
    finally:
        alone.close()
