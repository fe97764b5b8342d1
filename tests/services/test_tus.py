"""The upload keeps to tus 1.0.0: creation, creation-with-upload, checksum, expiration, termination."""

import hashlib
import os
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import httpx2
import pytest

from service_kit.object_store import WHEREVER, ObjectStoreServer, arrived, database_of, is_stored, stored_bytes
from service_kit.running import ApiAlone, until
from service_kit.tus import CHUNK, V, b64, checksum, create, head, metadata, offset, patch, register
from wayloom.store.receiving import parts

DATA = bytes(range(256)) * 40
IN_FOLDER = pytest.mark.parametrize("api_process", ["folder"], indirect=True)
"""The test looks at files that are not there where uploads are kept in an object store."""


@pytest.fixture(scope="module", params=WHEREVER)
def api_process(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ApiAlone]:
    store = request.getfixturevalue("object_store") if request.param == "objects" else None
    alone = ApiAlone(tmp_path_factory.mktemp("api") / "data", store, WAYLOOM_MAX_FILE_BYTES=str(64 << 20))
    yield alone
    alone.close()


@pytest.fixture
def drive(http: httpx2.Client) -> str:
    """A drive of one file `a`, whose bytes are DATA, and one that never comes."""
    return register(http, f"drive {time.monotonic_ns()}", a=DATA, never=b"x")


@pytest.fixture
def address(http: httpx2.Client, drive: str) -> str:
    return str(create(http, drive, "log/a", len(DATA)).headers["Location"])


def code(answer: httpx2.Response) -> str:
    assert answer.headers["Content-Type"] == "application/problem+json"
    return str(answer.json()["code"])


def test_options_say_what_the_server_can_do(http: httpx2.Client) -> None:
    answer = http.options("/v1/uploads")
    assert answer.status_code == 204
    assert answer.headers["Tus-Version"] == "1.0.0"
    assert set(answer.headers["Tus-Extension"].split(",")) == {
        "creation",
        "creation-with-upload",
        "checksum",
        "expiration",
        "termination",
    }
    assert answer.headers["Tus-Checksum-Algorithm"] == "sha1,sha256"
    assert answer.headers["Tus-Max-Size"] == str(64 << 20)


def test_a_file_sent_in_pieces_arrives_whole(http: httpx2.Client, drive: str, address: str, api_process: ApiAlone) -> None:
    at = 0
    for piece in (DATA[:1], DATA[1:5000], DATA[5000:]):
        answer = patch(http, address, at, piece)
        at += len(piece)
        assert answer.status_code == 204
        assert answer.headers["Tus-Resumable"] == "1.0.0"
        assert answer.headers["Upload-Offset"] == str(at)
        assert answer.headers["Upload-Expires"].endswith("GMT")
    assert arrived(api_process, drive, "log/a") == DATA
    assert offset(http, address) == len(DATA)


def test_a_file_can_come_with_its_creation(http: httpx2.Client, drive: str, api_process: ApiAlone) -> None:
    answer = create(http, drive, "log/a", len(DATA), DATA, **checksum(DATA))
    assert answer.status_code == 201
    assert answer.headers["Upload-Offset"] == str(len(DATA))
    assert arrived(api_process, drive, "log/a") == DATA


def test_the_first_bytes_can_come_with_the_creation(http: httpx2.Client, drive: str) -> None:
    answer = create(http, drive, "log/a", len(DATA), DATA[:100])
    assert answer.headers["Upload-Offset"] == "100"
    assert patch(http, answer.headers["Location"], 100, DATA[100:]).status_code == 204


def test_head_tells_offset_length_and_metadata_and_is_never_cached(http: httpx2.Client, drive: str, address: str) -> None:
    patch(http, address, 0, DATA[:77])
    answer = head(http, address)
    assert answer.status_code == 200
    assert answer.headers["Upload-Offset"] == "77"
    assert answer.headers["Upload-Length"] == str(len(DATA))
    assert answer.headers["Upload-Metadata"] == metadata(drive, "log/a")
    assert "no-store" in answer.headers["Cache-Control"]


@pytest.mark.parametrize("wrong", [1, 50, 101, 10**6])
def test_a_chunk_that_starts_elsewhere_is_refused_and_changes_nothing(http: httpx2.Client, address: str, wrong: int) -> None:
    patch(http, address, 0, DATA[:100])
    answer = patch(http, address, wrong, b"zzz")
    assert (answer.status_code, code(answer)) == (409, "offset-conflict")
    assert offset(http, address) == 100


@pytest.mark.parametrize("text", ["", "-1", "1.5", "ten", "1" * 30, "٣"])
def test_an_offset_that_is_no_number_is_refused(http: httpx2.Client, address: str, text: str) -> None:
    answer = http.patch(address, headers={**CHUNK, "Upload-Offset": text.encode()}, content=b"x")
    assert answer.status_code == 400


@pytest.mark.parametrize("version", [None, "0.2.2", "2.0.0"])
def test_another_version_of_the_protocol_is_refused(http: httpx2.Client, address: str, version: str | None) -> None:
    headers = {**CHUNK, "Upload-Offset": "0", "Tus-Resumable": version or ""}
    for answer in (http.patch(address, headers=headers, content=b"x"), http.post("/v1/uploads", headers=headers)):
        assert answer.status_code == 412
        assert answer.headers["Tus-Version"] == "1.0.0"
    assert http.head(address, headers={"Tus-Resumable": version or ""}).status_code == 412
    assert http.delete(address, headers={"Tus-Resumable": version or ""}).status_code == 412


def test_another_content_type_is_refused(http: httpx2.Client, address: str) -> None:
    answer = http.patch(address, headers={**V, "Upload-Offset": "0", "Content-Type": "application/octet-stream"}, content=b"x")
    assert answer.status_code == 415
    assert offset(http, address) == 0


def test_a_file_that_is_too_large_is_refused_before_it_comes(http: httpx2.Client, drive: str) -> None:
    assert create(http, drive, "log/a", (64 << 20) + 1).status_code == 413


def test_more_bytes_than_announced_are_refused(http: httpx2.Client, address: str) -> None:
    assert patch(http, address, 0, DATA + b"!").status_code == 413
    assert offset(http, address) == 0


def test_more_bytes_than_announced_are_refused_without_a_content_length_too(http: httpx2.Client, address: str) -> None:
    def pieces() -> Iterator[bytes]:
        yield DATA
        yield b"!"

    assert patch(http, address, 0, pieces()).status_code == 413
    assert offset(http, address) <= len(DATA)


@pytest.mark.parametrize("algorithm", ["sha1", "sha256"])
def test_a_chunk_with_the_right_checksum_is_kept(http: httpx2.Client, address: str, algorithm: str) -> None:
    assert patch(http, address, 0, DATA[:99], **checksum(DATA[:99], algorithm)).status_code == 204
    assert patch(http, address, 99, DATA[99:300], **checksum(DATA[99:300], algorithm)).status_code == 204
    assert offset(http, address) == 300


def test_a_chunk_with_a_wrong_checksum_is_dropped(http: httpx2.Client, address: str) -> None:
    patch(http, address, 0, DATA[:10])
    answer = patch(http, address, 10, b"damaged", **checksum(b"as sent"))
    assert (answer.status_code, code(answer)) == (460, "checksum-mismatch")
    assert offset(http, address) == 10


@pytest.mark.parametrize("more", [{}, checksum(b"bytes")])
@IN_FOLDER
def test_bytes_that_the_disk_does_not_take_are_said(
    http: httpx2.Client, address: str, api_process: ApiAlone, more: dict[str, str]
) -> None:
    in_the_way = api_process.data / "uploads" / f"{address.rsplit('/', 1)[1]}.part"
    in_the_way.mkdir(parents=True)
    answer = patch(http, address, offset(http, address), b"bytes", **more)
    in_the_way.rmdir()
    assert (answer.status_code, code(answer)) == (507, "no-space")
    assert patch(http, address, 0, DATA[:5], **checksum(DATA[:5])).status_code == 204


@pytest.mark.parametrize("header", ["md5 abc", "sha256", "sha256 ***", "crc32 AAAA"])
def test_a_checksum_that_the_server_does_not_know_is_refused(http: httpx2.Client, address: str, header: str) -> None:
    answer = patch(http, address, 0, b"x", **{"Upload-Checksum": header})
    assert answer.status_code in (400, 460)
    assert offset(http, address) == 0


def test_a_whole_file_with_another_hash_than_the_manifest_is_dropped(http: httpx2.Client, address: str, drive: str) -> None:
    answer = patch(http, address, 0, bytes(len(DATA)))
    assert answer.status_code == 460
    assert head(http, address).status_code == 404
    assert http.get(f"/v1/drives/{drive}").json()["received_files"] == 0


def test_a_terminated_upload_is_gone(http: httpx2.Client, address: str, api_process: ApiAlone) -> None:
    patch(http, address, 0, DATA[:10])
    assert http.delete(address, headers=V).status_code == 204
    assert head(http, address).status_code == 404
    assert patch(http, address, 10, b"x").status_code == 404
    assert stored_bytes(api_process, address) == 0


def test_an_unknown_upload_is_not_found(http: httpx2.Client) -> None:
    assert head(http, "/v1/uploads/0123456789abcdef0123456789abcdef").status_code == 404
    assert head(http, "/v1/uploads/..%2f..%2fwayloom.db").status_code == 404


@pytest.mark.parametrize(
    ("header", "status"),
    [
        ("", 404),
        ("drive x", 400),
        ("drive ***,path ***", 400),
        (metadata("f" * 64, "log/a"), 404),
        (f"drive {b64(bytes([255]))}", 400),
    ],
)
def test_an_upload_of_nothing_that_was_announced_is_refused(http: httpx2.Client, header: str, status: int) -> None:
    answer = http.post("/v1/uploads", headers={**V, "Upload-Length": "5", "Upload-Metadata": header})
    assert answer.status_code == status


@pytest.mark.parametrize("path", ["log/b", "../a", "log/../a", "/etc/passwd", "log/a\0"])
def test_a_path_that_the_manifest_does_not_name_is_refused(http: httpx2.Client, drive: str, path: str) -> None:
    assert create(http, drive, path, len(DATA)).status_code == 404


def test_another_length_than_the_manifest_says_is_refused(http: httpx2.Client, drive: str) -> None:
    assert create(http, drive, "log/a", len(DATA) + 1).status_code == 409


def test_a_file_that_has_arrived_is_not_taken_twice(http: httpx2.Client, drive: str) -> None:
    create(http, drive, "log/a", len(DATA), DATA)
    assert create(http, drive, "log/a", len(DATA)).status_code == 409


def test_the_method_can_be_said_in_a_header(http: httpx2.Client, address: str) -> None:
    headers = {**CHUNK, "Upload-Offset": "0", "X-HTTP-Method-Override": "PATCH"}
    assert http.post(address, headers=headers, content=DATA[:5]).headers["Upload-Offset"] == "5"
    assert http.post(address, headers={**V, "X-HTTP-Method-Override": "DELETE"}).status_code == 204


def test_a_head_that_is_said_in_a_header_is_answered_as_the_post_that_it_is(http: httpx2.Client, address: str) -> None:
    said = {**V, "X-HTTP-Method-Override": "HEAD"}
    refused = http.post(f"{address}0", headers=said)
    assert (refused.status_code, refused.json()["code"]) == (404, "not-found")
    assert http.post(address, headers=said).headers["Upload-Offset"] == "0"


def test_an_empty_file_is_complete_at_its_creation(http: httpx2.Client, api_process: ApiAlone) -> None:
    drive = register(http, f"with an empty file {time.monotonic_ns()}", empty=b"", never=b"x")
    assert create(http, drive, "log/empty", 0).status_code == 201
    assert arrived(api_process, drive, "log/empty") == b""


@IN_FOLDER
def test_a_file_that_was_whole_but_not_verified_when_the_server_died_is_finished(
    http: httpx2.Client, api_process: ApiAlone
) -> None:
    for finish in (head, lambda http, address: patch(http, address, len(DATA), b"")):
        own = register(http, f"whole {time.monotonic_ns()}", a=DATA, never=b"x")
        address = str(create(http, own, "log/a", len(DATA)).headers["Location"])
        (api_process.data / "uploads" / f"{address.rpartition('/')[2]}.part").write_bytes(DATA)
        assert finish(http, address).status_code in (200, 204)
        assert arrived(api_process, own, "log/a") == DATA
        assert offset(http, address) == len(DATA)


def broken_link(url: str, address: str, at: int, promised: int, sent: bytes) -> socket.socket:
    """A PATCH that promises more bytes than it sends; the link stays open. The server waits for them when this returns."""
    where = urlsplit(url)
    link = socket.create_connection((str(where.hostname), int(where.port or 80)))
    lines = [
        f"PATCH {address} HTTP/1.1", f"Host: {where.netloc}", "Tus-Resumable: 1.0.0", f"Upload-Offset: {at}",
        "Content-Type: application/offset+octet-stream", f"Content-Length: {promised}", "Expect: 100-continue", "", "",
    ]  # fmt: skip
    link.settimeout(60)
    link.sendall("\r\n".join(lines).encode())
    assert link.recv(1000).startswith(b"HTTP/1.1 100")
    link.sendall(sent)
    return link


def test_what_came_before_the_link_broke_is_kept(http: httpx2.Client, address: str, api_process: ApiAlone) -> None:
    link = broken_link(api_process.url, address, 0, len(DATA), DATA[:1000])
    time.sleep(1.0)  # what the server's HTTP layer has not handed on when it hears of the end is lost
    link.close()
    assert until(lambda: offset(http, address)) == 1000
    assert patch(http, address, 1000, DATA[1000:]).status_code == 204


def test_whoever_continues_takes_over_from_a_link_that_hangs(http: httpx2.Client, address: str, api_process: ApiAlone) -> None:
    link = broken_link(api_process.url, address, 0, len(DATA), b"")
    started = time.monotonic()
    assert patch(http, address, 0, DATA).status_code == 204
    assert time.monotonic() - started < 5
    link.close()


def test_two_clients_that_send_the_same_file_at_once_do_no_harm(http: httpx2.Client, api_process: ApiAlone) -> None:
    data = os.urandom(3 << 20)
    drive = register(http, f"twice {time.monotonic_ns()}", a=data, never=b"x")
    address = str(create(http, drive, "log/a", len(data)).headers["Location"])
    statuses = []

    def send() -> None:
        with httpx2.Client(base_url=api_process.url, timeout=30.0, trust_env=False) as own:
            statuses.append(patch(own, address, 0, data).status_code)

    threads = [threading.Thread(target=send) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert set(statuses) <= {204, 409, 423}
    if offset(http, address) < len(data):
        patch(http, address, offset(http, address), data[offset(http, address) :])
    assert arrived(api_process, drive, "log/a") == data


def test_an_expired_upload_is_gone(tmp_path: Path) -> None:
    alone = ApiAlone(tmp_path / "data", WAYLOOM_UPLOAD_EXPIRY_S="0.2")
    try:
        with httpx2.Client(base_url=alone.url, timeout=30.0, trust_env=False) as http:
            drive = register(http, "slow", a=DATA)
            address = str(create(http, drive, "log/a", len(DATA), DATA[:10]).headers["Location"])
            time.sleep(0.4)
            assert head(http, address).status_code == 410
            assert patch(http, address, 10, DATA[10:]).status_code == 410
            assert http.post("/v1/drives", json=manifest(DATA)).json()["missing"][0]["offset"] == 0
    finally:
        alone.close()


def test_a_full_disk_is_said_before_the_first_byte(tmp_path: Path) -> None:
    alone = ApiAlone(tmp_path / "data", WAYLOOM_MIN_FREE_BYTES=str(1 << 60))
    try:
        with httpx2.Client(base_url=alone.url, timeout=30.0, trust_env=False) as http:
            answer = create(http, register(http, "large", a=DATA), "log/a", len(DATA))
            assert (answer.status_code, code(answer)) == (507, "no-space")
    finally:
        alone.close()


def manifest(data: bytes) -> dict[str, object]:
    return {"name": "slow", "files": [{"path": "log/a", "size": len(data), "sha256": hashlib.sha256(data).hexdigest()}]}


@pytest.mark.parametrize("with_checksum", [False, True])
@pytest.mark.parametrize("wherever", WHEREVER)
def test_a_server_killed_in_the_middle_of_a_chunk_goes_on_where_its_bytes_end(
    tmp_path: Path, object_store: ObjectStoreServer, wherever: str, with_checksum: bool
) -> None:
    data = os.urandom(12 << 20)
    alone = ApiAlone(tmp_path / "data", object_store if wherever == "objects" else None)
    try:
        with httpx2.Client(base_url=alone.url, timeout=30.0, trust_env=False) as http:
            drive = register(http, "killed", a=data)
            address = str(create(http, drive, "log/a", len(data)).headers["Location"])
            patch(http, address, 0, data[: 2 << 20])

        def is_in_the_middle() -> bool:
            if not with_checksum:
                return is_stored(alone, address, 7 << 20, start=2 << 20)
            chunk = alone.data / "uploads" / f"{address.rpartition('/')[2]}.chunk"
            return chunk.exists() and chunk.stat().st_size > 1 << 20 if alone.objects is None else bool(_on_hold(alone))

        killed = threading.Event()

        def slowly() -> Iterator[bytes]:
            for start in range(2 << 20, len(data), 1 << 20):
                if start + (1 << 20) == len(data):
                    killed.wait(60)  # a server that is late must not get the whole chunk
                yield data[start : start + (1 << 20)]
                time.sleep(0.05)

        more = checksum(data[2 << 20 :]) if with_checksum else {}
        sender = threading.Thread(target=lambda: _send_into_the_void(alone.url, address, slowly(), more))
        sender.start()
        until(is_in_the_middle)
        alone.kill()
        killed.set()
        sender.join()
        alone.start()
        with httpx2.Client(base_url=alone.url, timeout=30.0, trust_env=False) as http:
            stored = offset(http, address)
            assert stored == (2 << 20) if with_checksum else (2 << 20) < stored < len(data)
            assert patch(http, address, stored, data[stored:]).status_code == 204
        assert arrived(alone, drive, "log/a") == data
    finally:
        alone.close()


def _send_into_the_void(url: str, address: str, content: Iterator[bytes], headers: dict[str, str]) -> None:
    with httpx2.Client(base_url=url, timeout=30.0, trust_env=False) as http, pytest.raises(httpx2.HTTPError):
        patch(http, address, 2 << 20, content, **headers)


def _on_hold(server: ApiAlone) -> list[str]:
    """Objects that the database does not know."""
    assert server.objects is not None
    names = [name for some in server.objects.older_than(0.0, parts.BELOW) for name in some]
    with database_of(server).read() as session:
        return parts.orphans(session, names)
