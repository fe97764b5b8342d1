"""Tables of a log are read line by line, within bounds."""

import tracemalloc
from pathlib import Path

import pytest

from wayloom.errors import LogError
from wayloom.files import text_files
from wayloom.files.text_files import read_lines, stream_lines
from wayloom.files.timestamps import ns_from_seconds, read_times


@pytest.mark.parametrize("text", ["", "\n\n", "a\n\nb", "\ufeffa\r\n  \r\nb\r\n\r\n \r\n", "a\nb\n"])
def test_streamed_lines_are_those_that_are_read_at_once(tmp_path: Path, text: str) -> None:
    file = tmp_path / "t.txt"
    file.write_bytes(text.encode())
    assert list(stream_lines(file, remedy="x")) == read_lines(file, remedy="x")


def test_a_long_list_of_times_takes_little_more_memory_than_its_numbers(tmp_path: Path) -> None:
    count = 200_000
    file = tmp_path / "times.txt"
    file.write_text("".join(f"{i}.000000000\n" for i in range(count)))
    tracemalloc.start()
    times = read_times(file, ns_from_seconds, remedy="x")
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(times) == count
    assert most < 3 * 8 * count + (1 << 20)  # the numbers twice (growing, and as an array), an eighth of growth, and the stream


def test_a_line_that_never_ends_and_lines_without_end_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "times.txt"
    file.write_text("1\n" + "2" * 100_000)
    with pytest.raises(LogError, match="line 2: has more than 65536 bytes") as refused:
        read_times(file, ns_from_seconds, remedy="x")
    assert refused.value.reason == "file.too_large"
    monkeypatch.setattr(text_files, "MOST_LINES", 10)
    file.write_text("".join(f"{i}\n" for i in range(11)))
    with pytest.raises(LogError, match="line 11: has more than 10 lines"):
        read_times(file, ns_from_seconds, remedy="x")


def test_a_byte_that_is_no_text_is_told_with_its_line(tmp_path: Path) -> None:
    file = tmp_path / "times.txt"
    file.write_bytes(b"1\n2\xff\n")
    with pytest.raises(LogError, match="line 2: byte 1 of the line is not UTF-8") as refused:
        list(stream_lines(file, remedy="x"))
    assert refused.value.reason == "file.not_text"
