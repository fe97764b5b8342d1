"""Time stamp conversion: decimal seconds or wall clock in text, int64 nanoseconds inside, exact both ways."""

import re
from array import array
from collections.abc import Callable, Sequence
from datetime import date
from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import LogError
from wayloom.files.text_files import quoted, stream_lines

NS = 1_000_000_000
LARGEST_SECONDS = Decimal(9_000_000_000)
_WALL_CLOCK = re.compile(r"(\d{4})-(\d\d)-(\d\d)[ T](\d\d):(\d\d):(\d\d)(?:\.(\d{1,9}))?", re.ASCII)
_EPOCH = date(1970, 1, 1).toordinal()


def ns_from_seconds(text: str) -> int:
    """Decimal seconds, such as 1.037359e-01, to nanoseconds, rounded half to even. Raises ValueError."""
    try:
        seconds = Decimal(text)
    except InvalidOperation:
        raise ValueError(f"{quoted(text)} is not a time in seconds") from None
    if not seconds.is_finite() or seconds.adjusted() > 10 or abs(seconds) > LARGEST_SECONDS:
        raise ValueError(f"{quoted(text)} is no possible time in seconds")
    return round(seconds * NS)


def seconds_from_ns(t_ns: int) -> str:
    """Nanoseconds to decimal seconds with nine decimals."""
    sign = "-" if t_ns < 0 else ""
    return f"{sign}{abs(t_ns) // NS}.{abs(t_ns) % NS:09d}"


def ns_from_wall_clock(text: str) -> int:
    """`2011-09-26 13:04:32.349659964` to nanoseconds since 1970, the wall clock taken as UTC. Raises ValueError."""
    match = _WALL_CLOCK.fullmatch(text)
    if match is None:
        raise ValueError(f"{quoted(text)} is not a time like 2011-09-26 13:04:32.349659964")
    year, month, day, hour, minute, second = (int(group) for group in match.groups()[:6])
    if hour > 23 or minute > 59 or second > 60:
        raise ValueError(f"{quoted(text)} is no time of a day")
    try:
        days = date(year, month, day).toordinal() - _EPOCH
    except ValueError:
        raise ValueError(f"{quoted(text)} is no day of the calendar") from None
    nanoseconds = int((match.group(7) or "").ljust(9, "0"))
    t_ns = ((days * 24 + hour) * 60 + minute) * 60 * NS + second * NS + nanoseconds
    if abs(t_ns) > LARGEST_SECONDS * NS:
        raise ValueError(f"{quoted(text)} is outside the years that a 64-bit nanosecond clock counts")
    return t_ns


def wall_clock_from_ns(t_ns: int) -> str:
    """Nanoseconds since 1970 to `2011-09-26 13:04:32.349659964`."""
    days, rest = divmod(t_ns, 86_400 * NS)
    second, nanoseconds = divmod(rest, NS)
    day = date.fromordinal(_EPOCH + days)
    return f"{day.isoformat()} {second // 3600:02d}:{second // 60 % 60:02d}:{second % 60:02d}.{nanoseconds:09d}"


def read_times(file: Path, parse: Callable[[str], int], *, remedy: str) -> NDArray[np.int64]:
    """One time stamp a line, (N,) int64 ns. Raises LogError naming the line that cannot be read."""
    times = array("q")  # eight bytes each: a list of whole numbers takes five times as much
    for number, line in enumerate(stream_lines(file, remedy=remedy), start=1):
        try:
            times.append(parse(line))
        except ValueError as problem:
            raise LogError(
                str(problem), file=file, record=f"line {number}", remedy="correct the line", reason="times.malformed"
            ) from None
    return np.array(times, dtype=np.int64)


def times_of_numbers(t_ns: NDArray[np.int64], numbers: Sequence[int], *, file: Path, what: str) -> NDArray[np.int64]:
    """The time stamps of the images (or packets) with these file numbers, (len(numbers),) int64 ns, strictly increasing.

    As many lines as files: line i belongs to file i. More lines than files, as where a clip was cut from a drive:
    line n belongs to the file numbered n (from 0). Raises LogError for fewer lines, and where time stands still or goes back.
    """
    if len(t_ns) == len(numbers):
        lines = list(range(len(numbers)))
    elif len(t_ns) > len(numbers) and max(numbers, default=0) < len(t_ns):
        lines = list(numbers)
    else:
        last = max(len(numbers), max(numbers, default=0) + 1) if len(t_ns) > len(numbers) else len(numbers)
        message = f"{len(t_ns)} time stamps for {last} {what}"
        remedy = f"give one line for each of the {what}, or remove those without a time stamp"
        raise LogError(message, file=file, remedy=remedy, reason="times.count")
    chosen = t_ns[lines]
    check_increasing(chosen, file=file, lines=[line + 1 for line in lines])
    return chosen


def check_increasing(t_ns: NDArray[np.int64], *, file: Path, lines: Sequence[int]) -> None:
    """Raises LogError naming the first line (lines[i] is that of t_ns[i]) whose time stamp is not after the one before it."""
    bad = np.flatnonzero(np.diff(t_ns) <= 0)
    if not len(bad):
        return
    i = int(bad[0]) + 1
    step_ns = int(t_ns[i] - t_ns[i - 1])
    what = "time stamp repeats the one before it" if step_ns == 0 else f"time stamp goes back by {-step_ns / NS:.6f} s"
    remedy = "sort or correct the time stamps, or leave the frame out"
    raise LogError(what, file=file, record=f"line {lines[i]}", remedy=remedy, reason="times.not_increasing")
