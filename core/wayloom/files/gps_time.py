"""GPS time of UTC time stamps: adjusted standard GPS time, as LAS 1.4 wants it (GPS seconds less 10^9)."""

from datetime import UTC, datetime
from typing import Final

import numpy as np
from numpy.typing import NDArray

NS: Final = 1_000_000_000
GPS_EPOCH_S: Final = 315_964_800
"""1980-01-06 in seconds since 1970, UTC."""
ADJUSTMENT_S: Final = NS
LEAP_DAYS: Final = (
    "1981-07-01", "1982-07-01", "1983-07-01", "1985-07-01", "1988-01-01", "1990-01-01", "1991-01-01", "1992-07-01", "1993-07-01",
    "1994-07-01", "1996-01-01", "1997-07-01", "1999-01-01", "2006-01-01", "2009-01-01", "2012-07-01", "2015-07-01", "2017-01-01",
)  # fmt: skip
"""The days at whose beginning GPS time was one second more ahead of UTC (IERS bulletin C)."""
LEAPS_S: Final = np.array([int(datetime.fromisoformat(day).replace(tzinfo=UTC).timestamp()) for day in LEAP_DAYS], np.int64)


def is_utc(t_ns: int) -> bool:
    """Whether a time stamp can be of a clock that shows UTC: GPS began in 1980, clocks of recordings often at zero."""
    return t_ns >= GPS_EPOCH_S * NS


def adjusted_gps_s(t_ns: NDArray[np.int64]) -> NDArray[np.float64]:
    """Seconds (N,) of time stamps (N,), ns since 1970 UTC; to some 0.1 us. Those before 1980 go on without leap seconds."""
    whole_s, rest_ns = np.divmod(np.asarray(t_ns, np.int64), NS)
    leaps = np.searchsorted(LEAPS_S, whole_s, side="right")
    return np.asarray((whole_s - GPS_EPOCH_S + leaps - ADJUSTMENT_S) + rest_ns / NS)
