"""File of loop closures: one npz file whose bytes depend on the closures alone."""

import io
import json
import zipfile
import zlib
from pathlib import Path
from typing import Final

import numpy as np

from wayloom.errors import StageError
from wayloom.files.atomic import write_atomically
from wayloom.loops.types import LoopClosures

LOOPS_FILE: Final = "loops.npz"
FORMAT: Final = "wayloom-loops"
VERSION: Final = 1


def save_loops(loops: LoopClosures, path: Path) -> None:
    """Write the closures; the file appears whole or not at all. (A zip of NumPy carries no time: equal closures, equal bytes.)"""
    header = json.dumps({"format": FORMAT, "version": VERSION, "report": loops.report}, sort_keys=True)
    buffer = io.BytesIO()
    np.savez(
        buffer,
        header=np.frombuffer(header.encode(), np.uint8),
        first=np.asarray(loops.first, np.int32),
        second=np.asarray(loops.second, np.int32),
        T_first_second=np.asarray(loops.T_first_second, np.float64, order="C"),
        covariance=np.asarray(loops.covariance, np.float64, order="C"),
    )
    write_atomically(path, buffer.getvalue())


def load_loops(path: Path) -> LoopClosures:
    """Read what `save_loops` wrote. Raises StageError where the file is missing, damaged or of another version."""
    remedy = "run the stage loops again"
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            header = json.loads(file["header"].tobytes())
            first, second, T_first_second, covariance = (file[name] for name in ("first", "second", "T_first_second", "covariance"))
    except (OSError, EOFError, ValueError, KeyError, zipfile.BadZipFile, zlib.error) as error:
        raise StageError(f"{path}: no readable file of loop closures ({type(error).__name__}); {remedy}") from error
    if header.get("format") != FORMAT or header.get("version") != VERSION:
        raise StageError(f"{path}: version {header.get('version')}, this program reads {VERSION}; {remedy}")
    return LoopClosures(first, second, T_first_second, covariance, header["report"])
