"""Uploads over links that break or flip bits: every byte arrives, and few are sent twice."""

import os
import sqlite3
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import httpx2
import pytest

from service_kit import tus
from service_kit.links import BadLink
from service_kit.packed_drives import packed_drive_of
from service_kit.running import ApiAlone, until
from wayloom.client.api import Api
from wayloom.client.chunks import ChunkSize
from wayloom.client.manifests import PackedDrive
from wayloom.client.upload import upload
from wayloom.errors import LogError
from wayloom.store import uploads
from wayloom.store.database import Database
from wayloom.store.folders import Folders

MIB = 1 << 20


def one_file(folder: Path, size: int) -> PackedDrive:
    """A drive of one file of random bytes."""
    folder.mkdir(parents=True, exist_ok=True)
    return packed_drive_of(folder, folder.name, {"log/a": os.urandom(size)})


def check_arrived(server: ApiAlone, drive: PackedDrive) -> None:
    folder = server.data / "drives" / drive.manifest.drive_id
    assert (folder / "log" / "a").read_bytes() == drive.sources["log/a"].read_bytes()


@pytest.mark.parametrize("break_after", [8 * MIB, MIB, MIB // 2])
def test_a_link_that_breaks_again_and_again_brings_the_file_all_the_same(alone: ApiAlone, tmp_path: Path, break_after: int) -> None:
    size = min(24 * MIB, 12 * break_after)
    drive = one_file(tmp_path / f"breaks {break_after}", size)
    link = BadLink(alone.url, break_after=break_after)
    with Api(link.url) as api:
        assert upload(api, drive, connections=1)["missing"] == []
    link.close()
    assert link.broken >= size // break_after - 1
    assert link.sent < 1.5 * size + link.broken * MIB // 4
    check_arrived(alone, drive)


def test_one_flipped_byte_has_no_more_than_a_chunk_sent_again(alone: ApiAlone, tmp_path: Path) -> None:
    drive = one_file(tmp_path / "flipped", 40 * MIB)
    link = BadLink(alone.url, flip_at=30 * MIB)
    largest = 4 * MIB
    with Api(link.url) as api:
        assert upload(api, drive, connections=1, chunk=largest)["missing"] == []
    link.close()
    assert 40 * MIB < link.sent < 40 * MIB + largest + MIB // 4
    check_arrived(alone, drive)


def test_of_a_damaged_chunk_the_server_keeps_the_pieces_before_the_damage(alone: ApiAlone, tmp_path: Path) -> None:
    content = os.urandom(300_000)
    damaged = bytearray(content)
    damaged[200_000] ^= 1
    with httpx2.Client(base_url=alone.url, trust_env=False) as http:
        drive = tus.register(http, "damaged", a=content)
        address = str(tus.create(http, drive, "log/a", len(content)).headers["Location"])
        answer = tus.patch(http, address, 0, bytes(damaged), **tus.pieces(content, 65536))
        assert (answer.status_code, answer.json()["code"]) == (460, "checksum-mismatch")
        assert tus.offset(http, address) == 3 * 65536
        rest = content[3 * 65536 :]
        assert tus.patch(http, address, 3 * 65536, rest, **tus.pieces(rest, 65536)).status_code == 204


BAD_SUMS = ("crc32", "md5 65536 AAAA", "crc32 1 AAAA", "crc32 65536 A", "crc32 65536 AAAAAAA=", "crc32 99999999 AAAA")


@pytest.mark.parametrize("header", BAD_SUMS)
def test_sums_of_pieces_that_cannot_be_read_are_refused(alone: ApiAlone, header: str) -> None:
    with httpx2.Client(base_url=alone.url, trust_env=False) as http:
        drive = tus.register(http, f"bad sums {header}", a=b"abc")
        address = str(tus.create(http, drive, "log/a", 3).headers["Location"])
        assert tus.patch(http, address, 0, b"abc", **{"Upload-Pieces": header}).status_code in (400, 460)
        assert tus.offset(http, address) == 0


def test_a_file_that_was_rewritten_after_it_was_announced_is_said_and_not_sent_for_ever(alone: ApiAlone, tmp_path: Path) -> None:
    drive = one_file(tmp_path / "rewritten", 100_000)
    drive.sources["log/a"].write_bytes(os.urandom(100_000))
    with Api(alone.url) as api, pytest.raises(LogError, match="changed since"):
        upload(api, drive)


def test_the_chunk_grows_on_a_good_link_and_shrinks_on_a_bad_one() -> None:
    size = ChunkSize(now=4 * MIB)
    size.arrived(0.1)
    assert size.now == 8 * MIB
    size.broke()
    assert size.now == 2 * MIB
    for _ in range(20):
        size.broke()
    assert size.now == size.least
    for _ in range(20):
        size.arrived(0.1)
    assert size.now == size.largest
    size.arrived(20.0)
    assert size.now == size.largest // 2


def test_a_server_killed_between_the_file_and_its_row_has_the_file(tmp_path: Path) -> None:
    server = ApiAlone(tmp_path / "data")
    try:
        drive = one_file(tmp_path / "finished", 2 * MIB)
        content = drive.sources["log/a"].read_bytes()
        with httpx2.Client(base_url=server.url, timeout=30.0, trust_env=False) as http:
            drive_id = http.post("/v1/drives", json=drive.manifest.model_dump(mode="json", exclude_none=True)).json()["id"]
            address = str(tus.create(http, drive_id, "log/a", len(content)).headers["Location"])
            assert tus.patch(http, address, 0, content[:MIB]).status_code == 204
        place = server.data / "drives" / drive_id / "log" / "a"
        lock = sqlite3.connect(server.data / "wayloom.db", isolation_level=None)
        lock.execute("BEGIN IMMEDIATE")  # the row cannot be committed
        sender = threading.Thread(target=_send_last_chunk, args=(server.url, address, content[MIB:]))
        sender.start()
        until(place.is_file)
        server.kill()
        lock.execute("ROLLBACK")
        lock.close()
        sender.join()
        server.start()
        link = BadLink(server.url)
        with Api(link.url) as api:
            assert upload(api, drive)["missing"] == []
        link.close()
        assert link.sent < 10_000  # no byte of the file
        check_arrived(server, drive)
    finally:
        server.close()


def _send_last_chunk(url: str, address: str, content: bytes) -> None:
    with httpx2.Client(base_url=url, timeout=30.0, trust_env=False) as http, pytest.raises(httpx2.HTTPError):
        tus.patch(http, address, MIB, content)


def test_a_damaged_file_in_its_place_is_not_taken_for_the_one_announced(alone: ApiAlone) -> None:
    content = os.urandom(5000)
    with httpx2.Client(base_url=alone.url, trust_env=False) as http:
        drive = tus.register(http, "damaged in its place", a=content)
        address = str(tus.create(http, drive, "log/a", len(content)).headers["Location"])
        place = alone.data / "drives" / drive / "log" / "a"
        place.parent.mkdir(parents=True)
        place.write_bytes(bytes(5000))  # as a power cut may leave it
        assert tus.head(http, address).status_code == 460
        assert not place.exists()
        assert tus.create(http, drive, "log/a", len(content), content).status_code == 201
        assert place.read_bytes() == content


def test_an_upload_that_is_slower_than_its_expiry_lives_while_bytes_arrive(tmp_path: Path) -> None:
    server = ApiAlone(tmp_path / "data", WAYLOOM_UPLOAD_EXPIRY_S="6")
    database = Database(f"sqlite:///{server.data / 'wayloom.db'}")
    content = os.urandom(3 * MIB)

    def slowly() -> Iterator[bytes]:
        for start in range(0, len(content), MIB // 8):
            time.sleep(0.28)
            with database.write() as session:
                uploads.drop_expired(session, Folders(server.data))
            yield content[start : start + MIB // 8]

    try:
        with httpx2.Client(base_url=server.url, timeout=30.0, trust_env=False) as http:
            drive = tus.register(http, "slow", a=content)
            address = str(tus.create(http, drive, "log/a", len(content)).headers["Location"])
            answer = tus.patch(http, address, 0, slowly())
            assert (answer.status_code, answer.headers.get("Upload-Offset")) == (204, str(len(content)))
        assert (server.data / "drives" / drive / "log" / "a").read_bytes() == content
    finally:
        database.close()
        server.close()
