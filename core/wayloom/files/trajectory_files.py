"""Trajectory files in TUM and KITTI format, as evo and the KITTI devkit read them.

TUM: `t x y z qx qy qz qw`, t in seconds, guessed poses between comment lines.
KITTI: the first three rows of T, relative to the first frame.
"""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import LogError
from wayloom.files.atomic import write_atomically
from wayloom.files.text_files import parse_numbers, read_lines
from wayloom.files.timestamps import ns_from_seconds, seconds_from_ns
from wayloom.geometry import se3

FloatArray = NDArray[np.float64]
GUESSED: Final = "# guessed: not tracked, by constant motion or inertia"
TRACKED_AGAIN: Final = "# tracked"


def write_tum(file: Path, t_ns: NDArray[np.int64], T_world_cam: FloatArray, tracked: NDArray[np.bool_] | None = None) -> None:
    """Write `tum_text`. Raises OSError."""
    write_atomically(file, tum_text(t_ns, T_world_cam, tracked))


def tum_text(t_ns: NDArray[np.int64], T_world_cam: FloatArray, tracked: NDArray[np.bool_] | None = None) -> bytes:
    """t_ns (N,) int64 and T_world_cam (N, 4, 4), one line each; time stamps are exact, numbers good to 1e-9.

    tracked : (N,) whether a pose was measured; None for all. Before poses that were not, and before the next that was, stands a
              comment line, which evo and `read_tum` pass over
    """
    x, y, z = T_world_cam[:, :3, 3].T
    qw, qx, qy, qz = se3.quaternion_wxyz(T_world_cam).T
    rows = np.column_stack([x, y, z, qx, qy, qz, qw])
    lines = [f"{seconds_from_ns(int(t))} {_row(row)}" for t, row in zip(t_ns, rows, strict=True)]
    return _text(lines if tracked is None else _with_guesses_marked(lines, tracked))


def read_tum(file: Path) -> tuple[NDArray[np.int64], FloatArray]:
    """t_ns (N,) int64 and T (N, 4, 4). Lines that start with # are comments. Raises LogError naming the line."""
    t_ns, T = [], []
    for number, line in enumerate(read_lines(file, remedy="give a trajectory"), start=1):
        if not line or line.startswith("#"):
            continue
        stamp, _, rest = line.partition(" ")
        record = f"line {number}"
        values = parse_numbers(rest, file=file, record=record, count=7)
        try:
            t_ns.append(ns_from_seconds(stamp))
        except ValueError as problem:
            raise LogError(str(problem), file=file, record=record, remedy="correct the line") from None
        T.append(_from_quaternion(values, file, record))
    return np.array(t_ns, dtype=np.int64), np.array(T).reshape(-1, 4, 4)


def write_kitti(file: Path, T_world_cam: FloatArray) -> None:
    """T_world_cam (N, 4, 4) as KITTI poses: T of each frame relative to the first."""
    relative = se3.inverse(T_world_cam[0]) @ T_world_cam if len(T_world_cam) else T_world_cam
    write_atomically(file, _text(_row(T[:3].ravel()) for T in relative))


def read_kitti(file: Path) -> FloatArray:
    """(N, 4, 4) poses as they stand in the file. Raises LogError naming the line that is cut or no rigid motion (to 1e-2)."""
    poses = []
    for number, line in enumerate(read_lines(file, remedy="give a file of KITTI poses"), start=1):
        record = f"line {number}"
        T = parse_numbers(line, file=file, record=record, count=12).reshape(3, 4)
        if not np.allclose(T[:, :3] @ T[:, :3].T, np.eye(3), atol=1e-2):
            raise LogError("is no rotation", file=file, record=record, remedy="a line is the first three rows of a 4x4 motion")
        poses.append(np.vstack([T, (0.0, 0.0, 0.0, 1.0)]))
    return np.array(poses).reshape(-1, 4, 4)


def _with_guesses_marked(lines: Sequence[str], tracked: NDArray[np.bool_]) -> Iterator[str]:
    """The lines, each stretch of frames that were not tracked between two comments."""
    before = True
    for line, is_tracked in zip(lines, tracked.tolist(), strict=True):
        if is_tracked != before:
            yield TRACKED_AGAIN if is_tracked else GUESSED
        before = is_tracked
        yield line


def _row(values: FloatArray) -> str:
    return " ".join(f"{value:.9f}" for value in values)


def _text(lines: Iterable[str]) -> bytes:
    return "".join(line + "\n" for line in lines).encode()


def _from_quaternion(values: FloatArray, file: Path, record: str) -> FloatArray:
    """x y z qx qy qz qw (7,) to T (4, 4)."""
    norm = float(np.linalg.norm(values[3:]))
    if not 0.9 < norm < 1.1:
        raise LogError(f"a quaternion of length {norm:.3g}", file=file, record=record, remedy="quaternions have length 1")
    return se3.from_quaternion_wxyz(values[[6, 3, 4, 5]], values[:3])
