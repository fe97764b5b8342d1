"""Two API processes on one data folder or object store: each goes on with what the other has received."""

import os
from collections.abc import Iterator

import httpx2
import pytest

from service_kit import tus
from service_kit.object_store import WHEREVER, ObjectStoreServer, arrived
from service_kit.running import ApiAlone, until

PIECE = 65536


@pytest.fixture(scope="module", params=WHEREVER)
def pair(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[ApiAlone, ApiAlone]]:
    data = tmp_path_factory.mktemp("both") / "data"
    if request.param == "objects":
        store: ObjectStoreServer = request.getfixturevalue("object_store")
        first = ApiAlone(data, store)
        second = ApiAlone(data, store, WAYLOOM_UPLOADS__URL=str(first.uploads_url))
    else:
        first, second = ApiAlone(data), ApiAlone(data)
    yield first, second
    first.close()
    second.close()


@pytest.fixture
def both(pair: tuple[ApiAlone, ApiAlone]) -> Iterator[list[httpx2.Client]]:
    clients = [httpx2.Client(base_url=server.url, timeout=30.0, trust_env=False) for server in pair]
    for client in clients:
        until(lambda client=client: client.get("/healthz").status_code == 200)
    yield clients
    for client in clients:
        client.close()


def send_in_turn(both: list[httpx2.Client], address: str, content: bytes, chunk: int) -> None:
    """Chunk by chunk, each to the other process than the one before, which is asked for the offset, too."""
    for number, start in enumerate(range(0, len(content), chunk)):
        here, there = both[number % 2], both[1 - number % 2]
        part = content[start : start + chunk]
        assert tus.offset(there, address) == start
        assert tus.patch(here, address, start, part, **tus.pieces(part, PIECE)).headers["Upload-Offset"] == str(start + len(part))


def test_a_file_is_received_by_two_processes_in_turn(both: list[httpx2.Client], pair: tuple[ApiAlone, ApiAlone]) -> None:
    content = os.urandom(10 * PIECE + 123)
    drive = tus.register(both[0], "file in turn", a=content)
    address = str(tus.create(both[0], drive, "log/a", len(content)).headers["Location"])
    send_in_turn(both, address, content, 3 * PIECE)
    assert arrived(pair[0], drive, "log/a") == content


def test_a_pack_is_received_by_two_processes_in_turn(both: list[httpx2.Client], pair: tuple[ApiAlone, ApiAlone]) -> None:
    contents = {f"{i:03}": os.urandom(10_000 + i) for i in range(60)}
    drive = tus.register(both[0], "pack in turn", **contents)
    begun = both[1].post(f"/v1/drives/{drive}/packs", json={"paths": [f"log/{name}" for name in contents]}).json()
    send_in_turn(both, begun["upload"], b"".join(contents.values()), 77_777)
    assert {name: arrived(pair[0], drive, f"log/{name}") for name in contents} == contents
    assert both[0].get(f"/v1/drives/{drive}").json()["state"] == "queued"
