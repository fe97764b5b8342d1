import os
from pathlib import Path

import pytest

from wayloom.files import regular
from wayloom.files.regular import IrregularFileError, LargeFileError, open_regular, read_regular


def test_a_file_is_read_whole_even_in_small_pieces(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file, content, read = tmp_path / "a", bytes(range(256)) * 9, os.read
    file.write_bytes(content)
    assert read_regular(file) == content
    monkeypatch.setattr(regular.os, "read", lambda fd, size: read(fd, min(size, 100)))  # as a network's file system may
    assert read_regular(file) == content
    (tmp_path / "empty").touch()
    assert read_regular(tmp_path / "empty") == b""


def test_a_file_that_shrinks_while_it_is_read_gives_what_is_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file, read = tmp_path / "a", os.read
    file.write_bytes(b"x" * 1000)

    def shrink(fd: int, size: int) -> bytes:
        os.truncate(file, 300)
        return read(fd, min(size, 100))

    monkeypatch.setattr(regular.os, "read", shrink)
    assert read_regular(file) == b"x" * 300


def test_what_is_no_file_or_too_large_is_refused_and_nothing_stays_open(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "large").write_bytes(b"12345")
    before = len(os.listdir("/dev/fd"))
    for opened in (open_regular, read_regular):
        for irregular in (tmp_path / "pipe", tmp_path):
            with pytest.raises(IrregularFileError):
                opened(irregular)
    with pytest.raises(LargeFileError, match="5 bytes, 4 are allowed"):
        read_regular(tmp_path / "large", 4)
    assert len(os.listdir("/dev/fd")) == before
