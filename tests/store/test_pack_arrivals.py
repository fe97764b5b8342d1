"""Arrival of a pack's bytes: where they go on, and what is let go of when they cannot."""

import hashlib
from pathlib import Path

import pytest

from wayloom.store.folders import Folders
from wayloom.store.pack_arrivals import PackArrival
from wayloom.store.packs import Pack, PackedFile

CONTENTS = (b"first", b"second")


@pytest.fixture
def folders(tmp_path: Path) -> Folders:
    found = Folders(tmp_path)
    found.uploads.mkdir(parents=True)
    (found.uploads / "u.pack").touch()
    return found


@pytest.fixture
def pack() -> Pack:
    files = tuple(PackedFile(f"log/{content.decode()}", len(content), hashlib.sha256(content).hexdigest()) for content in CONTENTS)
    return Pack("d" * 64, "u", files, (0, 5, 11))


def arrival(folders: Folders, pack: Pack) -> PackArrival:
    return PackArrival(folders, pack, None, lambda _end: None)


def test_bytes_that_another_writer_has_stored_before_the_lock_is_held_are_gone_on_after(folders: Folders, pack: Pack) -> None:
    late = arrival(folders, pack)
    pack.part(folders, 0).path.write_bytes(b"fir")
    late.begin(0)
    assert late.offset == 3
    late.take(memoryview(b"stsecond"))
    late.close()
    assert [pack.place(folders, number).path.read_bytes() for number in range(2)] == list(CONTENTS)


def test_an_arrival_that_cannot_begin_lets_the_next_one_have_the_pack(folders: Folders, pack: Pack) -> None:
    pack.part(folders, 0).path.mkdir()
    with pytest.raises(OSError, match="directory"):
        arrival(folders, pack).begin(0)
    pack.part(folders, 0).path.rmdir()
    again = arrival(folders, pack)  # raises BlockingIOError where the lock is still held
    again.begin(0)
    again.close()
