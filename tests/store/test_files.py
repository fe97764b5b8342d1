"""Blobs and the bytes of uploads."""

import hashlib
import os
from pathlib import Path

import pytest

from wayloom.errors import NotFoundError
from wayloom.store.blobs import BlobStore
from wayloom.store.processes import identity, is_dead
from wayloom.store.uploads import Part, write_at


@pytest.fixture(params=["folder", "memory"])
def blobs(request: pytest.FixtureRequest, tmp_path: Path) -> BlobStore:
    return BlobStore(tmp_path / "blobs", "memory:///" if request.param == "memory" else None)


def test_a_blob_has_the_name_of_its_hash_and_is_stored_once(blobs: BlobStore) -> None:
    digest = blobs.put(b"some bytes")
    assert digest == hashlib.sha256(b"some bytes").hexdigest()
    assert blobs.put(b"some bytes") == digest
    assert blobs.get(digest) == b"some bytes"
    assert blobs.has(digest)


def test_a_blob_that_is_not_there_is_said_to_be_missing(blobs: BlobStore) -> None:
    digest = hashlib.sha256(b"never").hexdigest()
    assert not blobs.has(digest)
    with pytest.raises(NotFoundError):
        blobs.get(digest)
    blobs.delete(digest)


def test_a_deleted_blob_is_gone(blobs: BlobStore) -> None:
    digest = blobs.put(b"x")
    blobs.delete(digest)
    assert not blobs.has(digest)


def test_the_offset_of_an_upload_is_the_size_of_its_file(tmp_path: Path) -> None:
    part = Part(tmp_path / "uploads" / "u.part")
    assert part.size() == 0
    fd = part.open()
    write_at(fd, b"abc", 0)
    write_at(fd, b"def", 3)
    os.close(fd)
    assert part.size() == 6
    assert part.digest() == hashlib.sha256(b"abcdef").hexdigest()


def test_a_staged_chunk_goes_behind_what_is_stored(tmp_path: Path) -> None:
    part, staged = Part(tmp_path / "u.part"), Part(tmp_path / "u.chunk")
    for content in (b"first", b"second"):
        staged.path.write_bytes(content)
        part.append(staged)
        assert not staged.path.exists()
    assert part.path.read_bytes() == b"firstsecond"


def test_an_installed_file_is_in_its_place_and_nowhere_else(tmp_path: Path) -> None:
    part = Part(tmp_path / "u.part")
    part.path.write_bytes(b"content")
    part.install(tmp_path / "drives" / "d" / "log" / "a.png")
    assert (tmp_path / "drives" / "d" / "log" / "a.png").read_bytes() == b"content"
    assert not part.path.exists()


def test_this_process_lives_and_one_of_another_start_time_does_not() -> None:
    assert not is_dead(identity())
    assert is_dead(identity()[:-1] + "x")
    assert is_dead(identity(999_999_999))


def test_nothing_is_known_of_a_process_on_another_machine() -> None:
    assert not is_dead("elsewhere/boot|1|1")
