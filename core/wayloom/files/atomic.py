"""Atomic file writes: a temporary file put in place by one rename, so that a file is whole or not there."""

import errno
import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Final


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


UMASK: Final = _umask()
"""Asked once: asking sets it for a moment, in all threads."""
UNFINISHED: Final = ".unfinished-"
NO_LINKS: Final = (errno.EPERM, errno.ENOTSUP, errno.EXDEV, errno.EMLINK, errno.ENOSYS, errno.EACCES)
"""What a disk without hard links, or with too many of one file, answers to one more."""


def write_atomically(file: Path, data: bytes | Iterable[bytes | memoryview]) -> None:
    """Write to a temporary name beside `file`, then put it in place in one step. Missing parent folders are made.

    Raises OSError that names `file`.
    """
    with replacing(file) as stream:
        for part in (data,) if isinstance(data, bytes) else data:
            stream.write(part)


@contextmanager
def replacing(file: Path) -> Iterator[IO[bytes]]:
    """A stream under a temporary name beside `file`, which it replaces in one step when the block ends well; else it vanishes.

    Missing parent folders are made. Raises OSError that names `file`.
    """
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=UNFINISHED, dir=file.parent)
        try:
            with os.fdopen(handle, "w+b") as stream:
                yield stream
            os.chmod(name, 0o666 & ~UMASK)
            os.replace(name, file)
        except BaseException:
            os.unlink(name)
            raise
    except OSError as problem:
        raise OSError(problem.errno, problem.strerror, str(file)) from problem


@contextmanager
def replacing_by_name(file: Path) -> Iterator[Path]:
    """As `replacing`, for writers that open their file by its name: the temporary name, of a file that is empty yet."""
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=UNFINISHED, dir=file.parent)
        os.close(handle)
        try:
            yield Path(name)
            os.chmod(name, 0o666 & ~UMASK)
            os.replace(name, file)
        except BaseException:
            os.unlink(name)
            raise
    except OSError as problem:
        raise OSError(problem.errno, problem.strerror, str(file)) from problem


@contextmanager
def new_folder(folder: Path) -> Iterator[Path]:
    """A folder under a temporary name beside `folder`, which it becomes in one step when the block ends well; else it vanishes.

    Raises OSError that names `folder`, FileExistsError where there is something in it already.
    """
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise FileExistsError(errno.EEXIST, "is not empty; name a new folder", str(folder))
        with tempfile.TemporaryDirectory(prefix=UNFINISHED, dir=folder.parent, ignore_cleanup_errors=True) as name:
            whole = Path(name) / folder.name
            whole.mkdir()
            yield whole
            os.replace(whole, folder)
    except OSError as problem:
        raise OSError(problem.errno, problem.strerror, str(folder)) from problem


def check_writable(file: Path) -> None:
    """Raises OSError that names `file` where it could not be written now; to be told before long work. Leaves nothing."""
    try:
        if file.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        folder = next(parent for parent in file.absolute().parents if parent.exists())
        with tempfile.TemporaryFile(prefix=UNFINISHED, dir=folder):
            pass
    except OSError as problem:
        raise OSError(problem.errno, problem.strerror, str(file)) from problem


def link_or_copy(source: Path, target: Path) -> None:
    """Make `target` the same file as `source`, or, where the disk has no hard links, a whole copy of it. Replaces `target`."""
    target.parent.mkdir(parents=True, exist_ok=True)
    target.unlink(missing_ok=True)
    try:
        os.link(source, target)
    except OSError as problem:
        if problem.errno not in NO_LINKS:
            raise
        write_atomically(target, source.read_bytes())


def remove_unfinished(folder: Path) -> None:
    """Remove what writers that were killed left below `folder` under temporary names."""
    for file in [*folder.rglob(f"{UNFINISHED}*")]:
        if file.is_dir():
            shutil.rmtree(file)
        else:
            file.unlink(missing_ok=True)
