"""Exposure times of the frames in `exposure.csv` beside a log, left and right."""

from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import LogError
from wayloom.files.atomic import write_atomically
from wayloom.files.text_files import parse_numbers, read_lines

EXPOSURE_NAME: Final = "exposure.csv"
HEADER: Final = "left_s,right_s"
REMEDY: Final = f"the header is {HEADER}; one line a frame, seconds (times the amplifier's gain)"
LONGEST_S: Final = 100.0


def read_exposure_csv(file: Path, frames: int) -> NDArray[np.float64]:
    """(frames, 2) seconds, left and right. Raises LogError naming the line that is wrong."""
    lines = read_lines(file, remedy="remove it or restore it")
    if not lines or lines[0].replace(" ", "") != HEADER:
        raise LogError("no header of exposures", file=file, record="line 1", remedy=REMEDY)
    if len(lines) - 1 != frames:
        raise LogError(f"{len(lines) - 1} exposures for {frames} frames", file=file, remedy=REMEDY)
    rows = np.array(
        [
            parse_numbers(line.replace(",", " "), file=file, record=f"line {number}", count=2)
            for number, line in enumerate(lines[1:], start=2)
        ]
    )
    bad = np.flatnonzero(((rows <= 0) | (rows > LONGEST_S)).any(axis=1))
    if len(bad):
        raise LogError("is no exposure", file=file, record=f"line {bad[0] + 2}", remedy=REMEDY)
    return rows


def write_exposure_csv(file: Path, exposure_s: NDArray[np.float64]) -> None:
    """(N, 2) seconds; read_exposure_csv gives them back exactly."""
    lines = (f"{left!r},{right!r}\n" for left, right in exposure_s.tolist())
    write_atomically(file, f"{HEADER}\n{''.join(lines)}".encode())
