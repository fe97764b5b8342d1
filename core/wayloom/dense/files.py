"""File of a drive's looks, of the same bytes whenever it is written: a `wayloom.files.blob` (`docs/formats.md`, "Looks").

Each look is packed by itself, so that a reader takes those that it wants out of a file of any length.
"""

import mmap
import zlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.dense.packing import PackedLooks, packed_looks, unpacked
from wayloom.dense.types import Looks
from wayloom.errors import InputError
from wayloom.files.atomic import write_atomically
from wayloom.files.blob import Piece, blob_pieces, decode_blob
from wayloom.geometry.camera import PinholeCamera

LOOKS_FILE: Final = "drive.looks"
MAGIC: Final = b"WLLOOKS\0"
VERSION: Final = 1
REMEDY: Final = "run the stage looks again while the drive's images are there"
DTYPES: Final = {"frame": "<u4", "start": "<i8", "packed": "|u1"}


def save_looks(looks: Looks | PackedLooks, path: Path) -> None:
    """Write the file, whole or not at all."""
    write_atomically(path, _pieces(looks))


def encode_looks(looks: Looks | PackedLooks) -> bytes:
    """The bytes of a drive's looks."""
    return b"".join(_pieces(looks))


def _pieces(looks: Looks | PackedLooks) -> Iterator[Piece]:
    """The file's bytes, in pieces."""
    packed = looks if isinstance(looks, PackedLooks) else packed_looks(looks)
    c = packed.camera
    arrays = {
        "frame": packed.frame.astype("<u4"),
        "start": packed.start.astype("<i8"),
        "packed": packed.packed,
    }
    return blob_pieces(MAGIC, VERSION, {"camera": [c.fx, c.fy, c.cx, c.cy, c.width, c.height], "sigma": packed.sigma}, arrays)


class LookFile:
    """A file of looks, of which single ones are read when they are asked for.

    Raises InputError that names the file where it is none, damaged or of another version.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            with path.open("rb") as file:
                header, arrays = decode_blob(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ), MAGIC, VERSION, DTYPES)
            fx, fy, cx, cy, width, height = header["camera"]
            self.camera, self.sigma = PinholeCamera(fx, fy, cx, cy, int(width), int(height)), float(header["sigma"])
            self.frame, self._start, self._packed = (arrays[name] for name in DTYPES)
            if len(self._start) != len(self.frame) + 1 or self._start[-1] != len(self._packed):
                raise ValueError("its tables do not fit each other")
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise InputError(f"holds no looks or is damaged ({error})", file=path, remedy=REMEDY) from error

    def __len__(self) -> int:
        return len(self.frame)

    def of_frames(self, frames: NDArray[np.integer[Any]]) -> Looks:
        """The looks of those of these frames (n,) that have one. Raises InputError where one is damaged."""
        return self.read(np.flatnonzero(np.isin(self.frame, frames)).tolist())

    def read(self, rows: Iterable[int] | None = None) -> Looks:
        """The looks of these rows, increasing; all by default."""
        rows = list(range(len(self)) if rows is None else rows)
        try:
            packed = [self._packed[self._start[row] : self._start[row + 1]].data for row in rows]
            return unpacked(self.camera, self.sigma, self.frame[rows], packed)
        except (ValueError, zlib.error) as error:
            raise InputError(f"holds a look that is damaged ({error})", file=self.path, remedy=REMEDY) from error
