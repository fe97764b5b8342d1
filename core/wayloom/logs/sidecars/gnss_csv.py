"""GNSS fixes of any receiver in `gnss.csv`, one a line, under a header that names the columns."""

import csv
import io
from array import array
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import LogError
from wayloom.files.atomic import write_atomically
from wayloom.files.text_files import QUOTE_CHARACTERS, parse_numbers, quoted, stream_lines
from wayloom.files.timestamps import check_increasing, ns_from_seconds
from wayloom.logs.types import FixType, GnssTrack

GNSS_NAME = "gnss.csv"
PLACE = ("lon_deg", "lat_deg", "height_m")
SIGMAS = ("sigma_e_m", "sigma_n_m", "sigma_u_m")
COVARIANCES = ("cov_ee", "cov_en", "cov_eu", "cov_nn", "cov_nu", "cov_uu")
HEADER_REMEDY = "the columns are t_ns or t_s, lon_deg, lat_deg, height_m, sigma_e_m, sigma_n_m, sigma_u_m (or cov_ee … cov_uu), fix"


def read_gnss_csv(file: Path) -> GnssTrack:
    """Raises LogError naming the line that is wrong."""
    reader = csv.DictReader(stream_lines(file, remedy="give the GNSS log"))
    times, fixes, numbers = array("q"), bytearray(), array("d")
    try:
        columns = [name.strip() for name in reader.fieldnames or ()]
        reader.fieldnames = columns
        spread = _checked_columns(columns, file)
        for line, row in enumerate(reader, start=2):
            times.append(_time(row, file, line))
            fixes.append(_fix(row, file, line))
            numbers.extend(_numbers(row, (*PLACE, *spread), file, line))
    except csv.Error as problem:
        raise LogError(f"is no CSV ({problem})", file=file, remedy=HEADER_REMEDY) from None
    if not times:
        raise LogError("no fixes", file=file, remedy="give the GNSS log")
    t_ns, values = np.array(times, np.int64), np.array(numbers).reshape(len(times), -1)
    check_increasing(t_ns, file=file, lines=range(2, len(times) + 2))
    check_places(values[:, :3], file, lambda row: f"line {row + 2}")
    covariance = _covariance(values[:, 3:], spread, file)
    return GnssTrack(t_ns, values[:, :3].copy(), covariance, np.frombuffer(bytes(fixes), np.uint8).copy())


def _checked_columns(columns: list[str], file: Path) -> tuple[str, ...]:
    """The columns that say how sure the fixes are. Raises LogError where one that is needed is missing."""
    spread = COVARIANCES if set(COVARIANCES) <= set(columns) else SIGMAS
    lacking = [name for name in (*PLACE, *spread) if name not in columns]
    if lacking or not {"t_ns", "t_s"} & set(columns):
        raise LogError(f"column {(lacking or ['t_ns'])[0]} is missing", file=file, record="line 1", remedy=HEADER_REMEDY)
    return spread


def write_gnss_csv(file: Path, track: GnssTrack) -> None:
    """Write fixes with their whole covariance; read_gnss_csv gives them back exactly."""
    upper = np.triu_indices(3)
    stream = io.StringIO(newline="")
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(("t_ns", *PLACE, *COVARIANCES, "fix"))
    for t, place, covariance, fix in zip(track.t_ns, track.lon_lat_height, track.covariance_enu, track.fix_type, strict=True):
        spread = (repr(float(value)) for value in covariance[upper])
        writer.writerow((int(t), *(repr(float(value)) for value in place), *spread, FixType(int(fix)).name.lower()))
    write_atomically(file, stream.getvalue().encode())


def _time(row: dict[str, str | None], file: Path, line: int) -> int:
    try:
        if row.get("t_ns"):
            t_ns = int(str(row["t_ns"])[:QUOTE_CHARACTERS])
            if abs(t_ns) > 9 * 10**18:
                raise ValueError(f"{quoted(str(t_ns))} is no possible time")
            return t_ns
        return ns_from_seconds(str(row.get("t_s") or "").strip())
    except ValueError as problem:
        raise LogError(
            str(problem), file=file, record=f"line {line}", remedy="correct the time stamp", reason="times.malformed"
        ) from None


def _fix(row: dict[str, str | None], file: Path, line: int) -> FixType:
    name = (row.get("fix") or "single").strip().upper()
    if name not in FixType.__members__:
        known = ", ".join(member.lower() for member in FixType.__members__)
        raise LogError(f"{quoted(name.lower())} is no fix type", file=file, record=f"line {line}", remedy=f"known are {known}")
    return FixType[name]


def _numbers(row: dict[str, str | None], names: tuple[str, ...], file: Path, line: int) -> NDArray[np.float64]:
    text = " ".join(str(row.get(name) or "?") for name in names)
    return parse_numbers(text, file=file, record=f"line {line}", count=len(names))


def check_places(lon_lat_height: NDArray[np.float64], file: Path, record: Callable[[int], str]) -> None:
    """Raises LogError where a row (M, 3) of degrees, degrees, m is no place; `record` names it."""
    lon, lat, h = np.abs(lon_lat_height).T
    bad = np.flatnonzero((lon > 180) | (lat > 90) | (h > 20_000))
    if len(bad):
        raise LogError(
            "is no place on earth", file=file, record=record(int(bad[0])), remedy="lon and lat are degrees, height metres"
        )


def _covariance(values: NDArray[np.float64], spread: tuple[str, ...], file: Path) -> NDArray[np.float64]:
    out = np.zeros((len(values), 3, 3))
    if spread is SIGMAS:
        out[:, range(3), range(3)] = values**2
        out[(values <= 0).any(axis=1)] = -1.0
    else:
        rows, columns = np.triu_indices(3)
        out[:, rows, columns] = out[:, columns, rows] = values
    bad = np.flatnonzero(~np.isfinite(out).all(axis=(1, 2)) | (np.linalg.eigvalsh(np.nan_to_num(out)).min(axis=1) <= 0))
    if len(bad):
        raise LogError("the covariance is not positive", file=file, record=f"line {bad[0] + 2}", remedy="sigmas are metres above 0")
    return out
