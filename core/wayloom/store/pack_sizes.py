"""Size limit of a packed file: what a request that continues a pack reads again of the file that is not whole."""

from collections.abc import Iterable
from typing import Final, Protocol

from wayloom.errors import ConflictError

LARGEST_PACKED: Final = 4 << 20
"""Bytes of one file of a pack. A file of its own costs some 15 ms, in which a pack moves as much."""


class Sized(Protocol):
    """A file by its path and bytes."""

    @property
    def path(self) -> str: ...
    @property
    def size(self) -> int: ...


def check_sizes(files: Iterable[Sized]) -> None:
    """Raises ConflictError where a file is too large for a pack."""
    for file in files:
        if file.size > LARGEST_PACKED:
            what = f"{file.path[:200]!r} has {file.size} bytes, a file of a pack at most {LARGEST_PACKED}: upload it by itself"
            raise ConflictError(what)
