"""Files that are whole or not there, and files that share their bytes."""

import os
import tempfile
from pathlib import Path

import pytest

from wayloom.files.atomic import UNFINISHED, link_or_copy, remove_unfinished, write_atomically


def test_a_linked_file_is_the_same_file(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"picture")
    (tmp_path / "new").mkdir()
    (tmp_path / "new" / "b").write_bytes(b"older")
    link_or_copy(tmp_path / "a", tmp_path / "new" / "b")
    assert (tmp_path / "a").samefile(tmp_path / "new" / "b")


def test_where_links_fail_the_file_is_copied(tmp_path: Path) -> None:
    other_disk = Path("/dev/shm")
    if not other_disk.is_dir() or other_disk.stat().st_dev == tmp_path.stat().st_dev:
        pytest.skip("needs a second file system at /dev/shm")
    with tempfile.TemporaryDirectory(dir=other_disk) as folder:
        (tmp_path / "a").write_bytes(b"picture")
        link_or_copy(tmp_path / "a", Path(folder) / "b")
        assert (Path(folder) / "b").read_bytes() == b"picture"
        assert os.listdir(folder) == ["b"]


def test_what_killed_writers_left_is_removed_and_nothing_else(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / f"{UNFINISHED}x1").write_bytes(b"cut")
    write_atomically(tmp_path / "in" / "whole", [b"wh", b"ole"])
    remove_unfinished(tmp_path)
    assert [file.name for file in (tmp_path / "in").iterdir()] == ["whole"]
    assert (tmp_path / "in" / "whole").read_bytes() == b"whole"


def test_a_file_that_cannot_be_written_is_named_and_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(OSError, match="file") as told:
        write_atomically(tmp_path / "file" / "below", b"x")
    assert told.value.filename == str(tmp_path / "file" / "below")
    assert os.listdir(tmp_path) == ["file"]
