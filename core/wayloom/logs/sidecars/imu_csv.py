"""IMU samples in `imu.csv`, one a line, under a header that names the columns."""

from array import array
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from wayloom.errors import LogError
from wayloom.files.atomic import write_atomically
from wayloom.files.text_files import QUOTE_CHARACTERS, parse_numbers, quoted, stream_lines
from wayloom.files.timestamps import check_increasing, ns_from_seconds
from wayloom.logs.types import ImuTrack

IMU_NAME: Final = "imu.csv"
COLUMNS: Final = ("fx_m_s2", "fy_m_s2", "fz_m_s2", "wx_rad_s", "wy_rad_s", "wz_rad_s")
"""Specific force (9.81 upwards at rest) and angular rate in the IMU's own axes."""
HEADER_REMEDY: Final = f"the columns are t_ns or t_s, {', '.join(COLUMNS)}"
RANGES: Final = (("a specific force", 2000.0, "m/s^2"), ("an angular rate", 200.0, "rad/s"))


def read_imu_csv(file: Path) -> ImuTrack:
    """Raises LogError naming the line that is wrong."""
    lines = stream_lines(file, remedy="give the IMU's samples")
    columns = [name.strip() for name in next(lines, "").split(",")]
    clock = next((name for name in ("t_ns", "t_s") if name in columns), None)
    lacking = [name for name in COLUMNS if name not in columns]
    if clock is None or lacking:
        what = f"column {(lacking or ['t_ns'])[0]} is missing"
        raise LogError(what, file=file, record="line 1", remedy=HEADER_REMEDY)
    at, where = columns.index(clock), [columns.index(name) for name in COLUMNS]
    times, numbers = array("q"), array("d")
    for row, line in enumerate(lines):
        record, words = f"line {row + 2}", line.split(",")
        if len(words) != len(columns):
            what = f"{len(words)} fields where {len(columns)} belong"
            raise LogError(what, file=file, record=record, remedy="the line is cut or damaged", reason="file.cut")
        times.append(_time(words[at].strip(), clock, file, record))
        numbers.extend(parse_numbers(" ".join(words[k] for k in where), file=file, record=record, count=len(COLUMNS)))
    if not times:
        raise LogError("no samples", file=file, remedy="give the IMU's samples, or remove the file")
    t_ns, values = np.array(times, np.int64), np.array(numbers).reshape(-1, len(COLUMNS))
    of_file = range(2, len(times) + 2)
    check_increasing(t_ns, file=file, lines=of_file)
    check_ranges(values, file, of_file)
    return ImuTrack(t_ns, values[:, :3].copy(), values[:, 3:].copy())


def write_imu_csv(file: Path, track: ImuTrack) -> None:
    """Write samples; read_imu_csv gives them back exactly."""
    rows = np.column_stack([track.specific_force, track.angular_rate]).tolist()
    lines = (f"{t},{','.join(map(repr, row))}\n".encode() for t, row in zip(track.t_ns.tolist(), rows, strict=True))
    write_atomically(file, (f"t_ns,{','.join(COLUMNS)}\n".encode(), *lines))


def _time(text: str, clock: str, file: Path, record: str) -> int:
    try:
        if clock == "t_ns" and not text.lstrip("-").isdecimal():
            raise ValueError(f"{quoted(text)} is not a time in nanoseconds")
        t_ns = int(text[:QUOTE_CHARACTERS]) if clock == "t_ns" else ns_from_seconds(text)
        if abs(t_ns) > 9 * 10**18:
            raise ValueError(f"{quoted(text)} is no possible time")
    except ValueError as problem:
        raise LogError(str(problem), file=file, record=record, remedy="correct the time stamp", reason="times.malformed") from None
    return t_ns


def check_ranges(values: np.ndarray, file: Path, lines: Sequence[int]) -> None:
    """Raises LogError where specific force and angular rate (N, 6) of these lines are beyond what any IMU measures."""
    for (what, most, unit), part in zip(RANGES, (values[:, :3], values[:, 3:]), strict=True):
        bad = np.flatnonzero(np.abs(part).max(axis=1) > most)
        if len(bad):
            message = f"{what} of {np.abs(part[bad[0]]).max():g} {unit} is impossible"
            raise LogError(message, file=file, record=f"line {lines[int(bad[0])]}", remedy="the columns are in m/s^2 and rad/s")
