"""Opening of files that someone else has named: regular ones only, and none that would not fit into memory."""

import os
import stat
from io import BufferedReader, FileIO
from pathlib import Path
from typing import Final

MOST_BYTES: Final = 512 << 20
"""Of a file that is read as a whole: an hour of 1 kHz IMU samples as text, or an image a hundred times larger than any camera's."""


class IrregularFileError(OSError):
    """A pipe, device, socket or folder where a file should be. Opening one may wait for ever."""


class LargeFileError(OSError):
    """A file that is too large to be read as a whole."""


def open_regular(file: Path) -> BufferedReader:
    """The file, opened for reading without waiting. Raises OSError; IrregularFileError where it is no regular file."""
    fd, _ = _opened(file)
    try:
        return BufferedReader(FileIO(fd))
    except BaseException:
        os.close(fd)
        raise


def read_regular(file: Path, most: int = MOST_BYTES) -> bytes:
    """All bytes of the file. Raises OSError as `open_regular`; LargeFileError before a byte is read."""
    fd, size = _opened(file)
    try:
        if size > most:
            raise LargeFileError(None, f"it has {size} bytes, {most} are allowed")
        data = os.read(fd, size)  # of a bound that is larger all would be set aside first
        while len(data) < size and (more := os.read(fd, size - len(data))):
            data += more
        return data
    finally:
        os.close(fd)


def _opened(file: Path) -> tuple[int, int]:
    """Descriptor and size of a regular file.

    It is looked at before it is opened, for opening a device may do something, and again after, for it may have been exchanged.
    """
    if not stat.S_ISREG(os.stat(file).st_mode):
        raise IrregularFileError(None, "it is no regular file")
    fd = os.open(file, os.O_RDONLY | os.O_CLOEXEC | getattr(os, "O_NONBLOCK", 0))
    try:
        status = os.fstat(fd)
        if not stat.S_ISREG(status.st_mode):
            raise IrregularFileError(None, "it is no regular file")
        return fd, status.st_size
    except BaseException:
        os.close(fd)
        raise
