"""GPS time by published pairs of UTC and GPS seconds."""

from datetime import UTC, datetime

import numpy as np
import pytest

from wayloom.files.gps_time import ADJUSTMENT_S, adjusted_gps_s, is_utc


def t_ns(text: str) -> int:
    return int(datetime.fromisoformat(text).replace(tzinfo=UTC).timestamp()) * 10**9


@pytest.mark.parametrize(
    ("utc", "gps_s"),
    [
        ("1980-01-06T00:00:00", 0),
        ("2011-09-14T01:46:25", 1_000_000_000),  # the zero of adjusted standard GPS time
        ("2016-12-31T23:59:59", 1_167_264_016),
        ("2017-01-01T00:00:00", 1_167_264_018),  # a leap second lies between
        ("2012-07-01T00:00:00", 1_025_136_016),
    ],
)
def test_gps_seconds_are_those_that_are_published(utc, gps_s):
    assert adjusted_gps_s(np.array([t_ns(utc)]))[0] == gps_s - ADJUSTMENT_S


def test_parts_of_a_second_are_kept_to_a_tenth_of_a_microsecond():
    stamps = t_ns("2024-05-05T05:05:05") + np.arange(0, 10**9, 77_777_777)
    told = adjusted_gps_s(stamps) - adjusted_gps_s(stamps[:1])
    assert np.abs(told - (stamps - stamps[0]) / 1e9).max() < 1e-7


def test_a_clock_that_starts_at_zero_is_not_utc():
    assert [is_utc(0), is_utc(t_ns("1980-01-06T00:00:00")), is_utc(t_ns("2011-09-26T13:04:32"))] == [False, True, True]
