"""Time stamps, exact both ways."""

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wayloom.errors import LogError
from wayloom.files.timestamps import (
    ns_from_seconds,
    ns_from_wall_clock,
    read_times,
    seconds_from_ns,
    times_of_numbers,
    wall_clock_from_ns,
)

nanoseconds = st.integers(-8 * 10**18, 8 * 10**18)


@given(nanoseconds)
def test_seconds_come_back_to_the_nanosecond(t_ns: int) -> None:
    assert ns_from_seconds(seconds_from_ns(t_ns)) == t_ns


@given(nanoseconds)
def test_wall_clock_comes_back_to_the_nanosecond(t_ns: int) -> None:
    assert ns_from_wall_clock(wall_clock_from_ns(t_ns)) == t_ns


def test_wall_clock_is_that_of_the_calendar() -> None:
    moment = datetime(2012, 2, 29, 23, 59, 58, tzinfo=UTC)
    assert ns_from_wall_clock("2012-02-29 23:59:58.000000001") == int(moment.timestamp()) * 10**9 + 1


@pytest.mark.parametrize(
    ("text", "t_ns"), [("1.037359e-01", 103_735_900), ("0", 0), ("12", 12 * 10**9), ("-0.5", -500_000_000), ("1e-9", 1)]
)
def test_seconds_are_read_as_decimals_without_rounding(text: str, t_ns: int) -> None:
    assert ns_from_seconds(text) == t_ns


@pytest.mark.parametrize("text", ["", "noon", "nan", "inf", "1e30", "0x10", "1,5"])
def test_what_is_no_time_in_seconds_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="time in seconds"):
        ns_from_seconds(text)


NO_WALL_CLOCKS = [
    "", "2011-09-26", "2011-13-01 00:00:00", "2011-02-29 00:00:00", "2011-01-01 24:00:00", "9999-01-01 00:00:00",
    "２０１１-01-01 00:00:00",
]  # fmt: skip


@pytest.mark.parametrize("text", NO_WALL_CLOCKS)
def test_what_is_no_wall_clock_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"time|day|years"):
        ns_from_wall_clock(text)


def test_blank_lines_count_only_between_others(tmp_path: Path) -> None:
    file = tmp_path / "times.txt"
    file.write_text("0.0\n1.0\r\n2.0\n\n\n")
    assert read_times(file, ns_from_seconds, remedy="").tolist() == [0, 10**9, 2 * 10**9]
    file.write_text("0.0\n\n2.0\n")
    with pytest.raises(LogError, match=r"line 2: '' is not a time"):
        read_times(file, ns_from_seconds, remedy="")


def test_a_cut_clip_finds_its_lines_by_file_number(tmp_path: Path) -> None:
    t_ns = np.arange(10, dtype=np.int64) * 100
    assert times_of_numbers(t_ns, [4, 5, 7], file=tmp_path, what="frames").tolist() == [400, 500, 700]
    assert times_of_numbers(t_ns[:3], [4, 5, 7], file=tmp_path, what="frames").tolist() == [0, 100, 200]
    with pytest.raises(LogError, match="10 time stamps for 13 frames"):
        times_of_numbers(t_ns, [4, 5, 12], file=tmp_path, what="frames")
