"""Large bodies, which threads receive past the HTTP parser: stored as any other, and the connection goes on behind them."""

import os
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import httpx2
import pytest

from service_kit import tus
from service_kit.object_store import WHEREVER, arrived, is_stored, stored_bytes
from service_kit.running import ApiAlone, until
from wayloom.store.uploads import Part, open_past_cache, write_past_cache

MIB = 1 << 20
SIZE = 5 * MIB + 12_345
PAUSE_S = 6
"""After which a body of which nothing comes is given up."""


@pytest.fixture(scope="module", params=WHEREVER)
def server(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ApiAlone]:
    store = request.getfixturevalue("object_store") if request.param == "objects" else None
    alone = ApiAlone(tmp_path_factory.mktemp("direct") / "data", store, WAYLOOM_BODY_PAUSE_S=str(PAUSE_S))
    with httpx2.Client(base_url=alone.url, trust_env=False, timeout=30.0) as client:
        until(lambda: client.get("/healthz"))
    yield alone
    alone.close()


@pytest.fixture
def http(server: ApiAlone) -> Iterator[httpx2.Client]:
    with httpx2.Client(base_url=server.url, timeout=60.0, trust_env=False) as client:
        yield client


def begin(http: httpx2.Client, name: str, content: bytes) -> tuple[str, str]:
    """The ids of a new drive and of the upload of its file."""
    drive = tus.register(http, name, a=content)
    return drive, str(tus.create(http, drive, "log/a", len(content)).headers["Location"])


def link_with(server: ApiAlone, address: str, content: bytes, sent: int) -> socket.socket:
    """A connection on which so many bytes of a chunk have been sent."""
    where = urlsplit(server.url)
    head = f"PATCH {address} HTTP/1.1\r\nHost: localhost\r\nTus-Resumable: 1.0.0\r\nUpload-Offset: 0\r\n"
    lines = f"{head}Content-Type: application/offset+octet-stream\r\nContent-Length: {len(content)}\r\n"
    sums = "".join(f"{name}: {value}\r\n" for name, value in tus.pieces(content, 65536).items())
    link = socket.create_connection((str(where.hostname), int(where.port or 80)))
    link.settimeout(60)
    link.sendall(f"{lines}{sums}\r\n".encode() + content[:sent])
    return link


def stored(server: ApiAlone, drive: str) -> bytes:
    return arrived(server, drive, "log/a")


def test_a_large_chunk_is_stored_byte_by_byte_and_what_comes_behind_it_is_the_next_request(
    server: ApiAlone, http: httpx2.Client
) -> None:
    content = os.urandom(SIZE)
    drive, address = begin(http, "behind", content)
    with link_with(server, address, content, SIZE) as link:
        link.sendall(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
        said = b"".join(iter(lambda: link.recv(10_000), b""))
    assert said.startswith(b"HTTP/1.1 204")
    assert said.count(b"HTTP/1.1 ") == 2
    assert b"HTTP/1.1 200" in said
    assert stored(server, drive) == content


def test_a_large_chunk_that_stops_coming_is_given_up_and_its_whole_pieces_are_kept(server: ApiAlone, http: httpx2.Client) -> None:
    content = os.urandom(SIZE)
    _, address = begin(http, "stops", content)
    sent = 2 * MIB + 70_000
    with link_with(server, address, content, sent) as link:
        assert link.recv(10_000).startswith(b"HTTP/1.1 408")
    assert tus.offset(http, address) == sent - sent % 65536


def test_a_large_chunk_whose_link_breaks_leaves_its_whole_pieces(server: ApiAlone, http: httpx2.Client) -> None:
    content = os.urandom(SIZE)
    _, address = begin(http, "breaks", content)
    sent = 3 * MIB + 70_000
    whole = sent - sent % 65536
    link_with(server, address, content, sent).close()
    until(lambda: stored_bytes(server, address) >= whole)  # whoever asks before takes over what has come until then
    assert tus.offset(http, address) == whole


def test_a_large_chunk_that_is_under_way_is_taken_over_by_whoever_asks_for_the_offset(
    server: ApiAlone, http: httpx2.Client
) -> None:
    content = os.urandom(SIZE)
    drive, address = begin(http, "taken over", content)
    before = tus.received(server.url)
    with link_with(server, address, content, 2 * MIB + 1000) as link:
        until(lambda: is_stored(server, address, MIB) and tus.received(server.url) - before >= 2 * MIB)
        started = time.monotonic()
        assert tus.offset(http, address) == 2 * MIB
        assert time.monotonic() - started < PAUSE_S - 1  # not by the pause after which a body is given up
        assert link.recv(10_000).startswith(b"HTTP/1.1 423")
    rest = content[2 * MIB :]
    assert tus.patch(http, address, 2 * MIB, rest).status_code == 204
    assert stored(server, drive) == content


def test_bodies_that_trickle_hold_up_no_query(server: ApiAlone, http: httpx2.Client) -> None:
    content = os.urandom(SIZE)
    links = [link_with(server, begin(http, f"trickles {i}", content)[1], content, 1000) for i in range(24)]
    ended = threading.Event()

    def trickle() -> None:
        while not ended.is_set():
            for link in links:
                link.sendall(b"0")
            ended.wait(0.005)

    trickling = threading.Thread(target=trickle)
    trickling.start()
    try:
        time.sleep(0.5)  # longer than a turn
        answers = [http.get("/v1/drives", timeout=5.0).status_code for _ in range(10)]
    finally:
        ended.set()
        trickling.join()
        for link in links:
            link.close()
    assert answers == [200] * 10


def test_a_connection_whose_large_chunk_was_refused_serves_the_next_request(server: ApiAlone, http: httpx2.Client) -> None:
    content = os.urandom(SIZE)
    _, address = begin(http, "refused", content)
    damaged = bytearray(content)
    damaged[MIB + 5] ^= 1
    answer = tus.patch(http, address, 0, bytes(damaged), **tus.pieces(content, 65536))
    assert (answer.status_code, answer.json()["code"]) == (460, "checksum-mismatch")
    assert tus.offset(http, address) == MIB


def test_memory_that_begins_anywhere_and_lengths_of_any_size_are_written_past_the_cache_as_through_it(tmp_path: Path) -> None:
    part, content, at = Part(tmp_path / "part"), memoryview(bytearray(os.urandom(MIB))), 0
    fd, direct = part.open(), open_past_cache(tmp_path / "part")
    for count in (4096, 65536, 1, 4095, 100_000, 12_288, 3):
        write_past_cache(direct, fd, content[at : at + count], at)
        at += count
    os.close(fd)
    if direct is not None:
        os.close(direct)
    assert part.path.read_bytes() == content[:at]
