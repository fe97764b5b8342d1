"""Parsed sources are kept by their content, and no state of the file that keeps them changes what is found."""

import os
import stat
from pathlib import Path

import pytest

from wayloom.pipeline import parsed_source as module
from wayloom.pipeline.parsed_source import ParsedSources, kept_sources, parsed

FIRST = b"from wayloom.tiles import png\n\nSIZE = 1\n"
SECOND = b"import numpy\n\nSIZE = 2\n"


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "cache" / "sources.json"


@pytest.fixture
def parsings(monkeypatch: pytest.MonkeyPatch) -> list[bytes]:
    """The contents that are parsed, as they are."""
    seen: list[bytes] = []

    def parsed_and_seen(content: bytes) -> module.ParsedSource:
        seen.append(content)
        return parsed(content)

    monkeypatch.setattr(module, "parsed", parsed_and_seen)
    return seen


def keep(file: Path | None, *contents: bytes) -> ParsedSources:
    sources = ParsedSources(file)
    for content in contents:
        assert sources.of(content) == parsed(content)
    sources.keep()
    return sources


def test_what_one_process_parsed_another_one_reads(file, parsings):
    keep(file, FIRST, SECOND)
    keep(file, SECOND, FIRST)
    assert parsings == [FIRST, SECOND]
    assert stat.S_IMODE(file.stat().st_mode) & 0o600 == 0o600
    assert [path.name for path in file.parent.iterdir()] == ["sources.json"]


def test_a_source_that_changed_is_parsed_whatever_its_name_and_time(tmp_path, file, parsings):
    source = tmp_path / "source.py"
    source.write_bytes(FIRST)
    times = source.stat()
    keep(file, source.read_bytes())
    source.write_bytes(FIRST.replace(b"1", b"3"))  # of the same length
    os.utime(source, ns=(times.st_atime_ns, times.st_mtime_ns))
    assert keep(file, source.read_bytes()).of(source.read_bytes()) != parsed(FIRST)
    assert len(parsings) == 2


@pytest.mark.parametrize(
    "damage",
    [
        lambda whole: b"",
        lambda whole: whole[: len(whole) // 2],
        lambda whole: whole.replace(b"png", b"jpg"),
        lambda whole: b"\n".join([b"0" * 64, whole.partition(b"\n")[2]]),
        lambda whole: b"\xff\x00" * 40,
        lambda whole: whole + b"\n",
    ],
    ids=["empty", "cut", "altered", "other checksum", "noise", "longer"],
)
def test_a_damaged_file_is_written_anew(file, parsings, damage):
    keep(file, FIRST)
    whole = file.read_bytes()
    file.write_bytes(damage(whole))
    keep(file, FIRST)
    assert parsings == [FIRST, FIRST]
    assert file.read_bytes() == whole


def test_of_two_writers_at_the_same_time_both_are_kept_where_they_follow_each_other(file, parsings):
    one, other = ParsedSources(file), ParsedSources(file)
    one.of(FIRST)
    other.of(SECOND)
    one.keep()
    other.keep()
    keep(file, FIRST, SECOND)
    assert parsings == [FIRST, SECOND]


def test_a_folder_that_cannot_be_made_or_written_only_costs_time(tmp_path, parsings):
    (tmp_path / "taken").write_text("")
    for _ in range(2):
        keep(tmp_path / "taken" / "sources.json", FIRST)
    (tmp_path / "folder").mkdir()
    keep(tmp_path / "folder", FIRST)
    assert parsings == [FIRST, FIRST, FIRST]
    assert not [*(tmp_path / "folder").iterdir()]
    keep(None, FIRST)


def test_a_pipe_in_its_place_does_not_wait(tmp_path, parsings):
    os.mkfifo(tmp_path / "pipe")
    keep(tmp_path / "pipe", FIRST)
    assert parsings == [FIRST]


def test_a_file_that_would_grow_too_long_starts_anew(file, parsings, monkeypatch):
    monkeypatch.setattr(module, "MOST_KEPT", 2)
    keep(file, FIRST, SECOND)
    keep(file, b"import os\n")
    keep(file, b"import os\n")
    keep(file, FIRST)
    assert parsings == [FIRST, SECOND, b"import os\n", FIRST]


def test_a_source_that_is_no_python_is_told_each_time(file):
    for _ in range(2):
        with pytest.raises(SyntaxError):
            keep(file, b"import = 1")


def test_the_file_lies_beside_the_kernels_and_another_python_has_another_one(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    ours = kept_sources().file
    assert ours is not None
    assert ours.parent == tmp_path
    monkeypatch.setattr(module.sys, "version", "3.99")
    assert kept_sources().file != ours
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    assert kept_sources().file is None
