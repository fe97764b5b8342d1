"""`data.csv` of the ASL data set format: image lists, IMU samples and ground-truth poses, by time stamps in nanoseconds."""

from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import LogError
from wayloom.files.text_files import QUOTE_CHARACTERS, parse_numbers, quoted, stream_lines
from wayloom.files.timestamps import check_increasing
from wayloom.geometry import se3
from wayloom.logs.images.image_files import IMAGE_SUFFIXES, FilesOf
from wayloom.logs.sidecars.imu_csv import check_ranges
from wayloom.logs.types import ImuTrack

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
LARGEST_NS: Final = 9 * 10**18
LONGEST_BRIDGE_NS: Final = 100_000_000
"""Between two poses further apart there is no truth."""
IMU_COLUMNS: Final = ("w_RS_S_x", "w_RS_S_y", "w_RS_S_z", "a_RS_S_x", "a_RS_S_y", "a_RS_S_z")
POSE_COLUMNS: Final = ("p_RS_R_x", "p_RS_R_y", "p_RS_R_z", "q_RS_w", "q_RS_x", "q_RS_y", "q_RS_z")


@dataclass(frozen=True, slots=True)
class ImageList:
    """Images of a camera in the order of time: t_ns (N,), their files."""

    t_ns: IntArray
    files: FilesOf


def read_image_list(file: Path, folder: Path) -> ImageList:
    """The images of a camera's data.csv, in `folder`. Raises LogError naming the line that is wrong."""
    t_ns, files, lines = [], [], []
    for number, words in _rows(file, "list the camera's images"):
        record = f"line {number}"
        if len(words) != 2:
            raise LogError(f"{len(words)} fields where 2 belong", file=file, record=record, remedy="a line is: stamp,file name")
        name = words[1]
        leads_out = "/" in name or "\\" in name or "\0" in name or name.startswith(".")
        if leads_out or not name.lower().endswith(IMAGE_SUFFIXES):
            what = f"{quoted(name)} is no name of an image in {folder.name}"
            remedy = f"give the file's name alone ({', '.join(IMAGE_SUFFIXES)})"
            raise LogError(what, file=file, record=record, remedy=remedy, reason="file.outside" if leads_out else None)
        t_ns.append(_stamp(words[0], file, record))
        files.append(name)
        lines.append(number)
    if not files:
        raise LogError("lists no images", file=file, remedy="a line is: stamp,file name")
    stamps = np.array(t_ns, np.int64)
    check_increasing(stamps, file=file, lines=lines)
    return ImageList(stamps, FilesOf(folder, tuple(files)))


def read_imu(file: Path) -> tuple[ImuTrack, int]:
    """The samples, and how many were left out because their stamp was not after the one before. Raises LogError."""
    t_ns, values, lines = _table(file, IMU_COLUMNS, "give the IMU's samples")
    check_ranges(values[:, [3, 4, 5, 0, 1, 2]], file, lines)
    latest = np.maximum.accumulate(t_ns)
    fresh = np.concatenate([[True], t_ns[1:] > latest[:-1]])
    return ImuTrack(t_ns[fresh], values[fresh, 3:].copy(), values[fresh, :3].copy()), int((~fresh).sum())


def read_poses(file: Path) -> tuple[IntArray, FloatArray]:
    """t_ns (N,) and T_world_sensor (N, 4, 4). Raises LogError naming the line that is wrong."""
    t_ns, values, lines = _table(file, POSE_COLUMNS, "give the poses, or remove the folder")
    check_increasing(t_ns, file=file, lines=lines)
    norm = np.linalg.norm(values[:, 3:], axis=1)
    bad = np.flatnonzero(np.abs(norm - 1.0) > 0.1)
    if len(bad):
        what = f"a quaternion of length {norm[bad[0]]:.3g}"
        raise LogError(what, file=file, record=f"line {lines[int(bad[0])]}", remedy="correct the line")
    return t_ns, se3.from_quaternion_wxyz(values[:, 3:], values[:, :3])


def poses_at(times_ns: IntArray, t_ns: IntArray, T: FloatArray) -> FloatArray:
    """T (M, 4, 4) of t_ns (M,), rising, at times_ns (N,): exactly, or between the two nearest, NaN where these are far apart."""
    after = np.clip(np.searchsorted(t_ns, times_ns), 1, max(len(t_ns) - 1, 1))
    before, after = after - 1, np.minimum(after, len(t_ns) - 1)
    span = np.maximum(t_ns[after] - t_ns[before], 1)
    share = (times_ns - t_ns[before]) / span
    q0, q1 = se3.quaternion_wxyz(T[before]), se3.quaternion_wxyz(T[after])
    q1 = np.where((q0 * q1).sum(axis=1, keepdims=True) < 0, -q1, q1)
    q = (1.0 - share[:, None]) * q0 + share[:, None] * q1
    place = (1.0 - share[:, None]) * T[before, :3, 3] + share[:, None] * T[after, :3, 3]
    out = se3.from_quaternion_wxyz(q, place)
    out[times_ns == t_ns[before]] = T[before[times_ns == t_ns[before]]]
    out[times_ns == t_ns[after]] = T[after[times_ns == t_ns[after]]]
    outside = (share < 0) | (share > 1) | ((span > LONGEST_BRIDGE_NS) & (share > 0) & (share < 1))
    out[outside] = np.nan
    return out


def _table(file: Path, columns: Sequence[str], remedy: str) -> tuple[IntArray, FloatArray, Sequence[int]]:
    """Stamps (N,), values (N, C) of the columns, and the lines. Where a header names the columns it counts, else their order."""
    where = _columns(file, columns, remedy)
    t_ns, values, lines = array("q"), array("d"), array("q")
    for number, words in _rows(file, remedy):
        record = f"line {number}"
        if len(words) <= max(where):
            what = f"{len(words)} fields where {max(where) + 1} belong"
            raise LogError(what, file=file, record=record, remedy="the line is cut or damaged", reason="file.cut")
        t_ns.append(_stamp(words[0], file, record))
        values.extend(parse_numbers(" ".join(words[k] or "?" for k in where), file=file, record=record, count=len(where)))
        lines.append(number)
    if not lines:
        raise LogError("no samples", file=file, remedy=remedy)
    return np.array(t_ns, np.int64), np.array(values).reshape(-1, len(where)), lines


def _columns(file: Path, columns: Sequence[str], remedy: str) -> list[int]:
    first = next((line for line in stream_lines(file, remedy=remedy) if line), "")
    if not first.startswith("#"):
        return list(range(1, len(columns) + 1))
    names = [word.split("[")[0].strip() for word in first.lstrip("#").split(",")]
    lacking = [name for name in columns if name not in names]
    if lacking:
        what = f"column {lacking[0]} is missing"
        raise LogError(what, file=file, record="line 1", remedy=f"the columns are timestamp, {', '.join(columns)}")
    return [names.index(name) for name in columns]


def _rows(file: Path, remedy: str) -> Iterator[tuple[int, list[str]]]:
    """Line number and fields of each line that is no comment."""
    for number, line in enumerate(stream_lines(file, remedy=remedy), start=1):
        if line and not line.startswith("#"):
            yield number, [word.strip() for word in line.split(",")]


def _stamp(text: str, file: Path, record: str) -> int:
    if not (text.isascii() and text.isdecimal() and len(text) <= QUOTE_CHARACTERS and int(text) <= LARGEST_NS):
        what = f"{quoted(text)} is no time in nanoseconds"
        raise LogError(what, file=file, record=record, remedy="correct the time stamp", reason="times.malformed")
    return int(text)
