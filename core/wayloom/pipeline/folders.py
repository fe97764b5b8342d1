"""Folders that are either whole or not there, and one writer at a time in each."""

import errno
import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from wayloom.errors import ConflictError, InputError
from wayloom.files.atomic import UNFINISHED

LOCK: Final = ".lock"
REMEDY: Final = {
    errno.ENOSPC: "free some space and run the same command again",
    errno.EDQUOT: "free some space and run the same command again",
    errno.EROFS: "choose a folder on a writable disk",
}


@contextmanager
def writing_to(out_dir: Path) -> Iterator[None]:
    """Turn what the system refuses (full disk, no permission, a file in the way) into one InputError that names the file."""
    try:
        yield
    except OSError as problem:
        file = problem.filename if problem.filename is not None else out_dir
        remedy = REMEDY.get(problem.errno or 0, "choose a folder that can be written")
        raise InputError(f"cannot be written ({problem.strerror or problem})", file=os.fsdecode(file), remedy=remedy) from problem


@contextmanager
def new_folders(folder: Path) -> Iterator[None]:
    """Make a folder and its missing parents; on failure remove those that were made here and hold nothing."""
    made = [path for path in (folder, *folder.parents) if not path.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    try:
        yield
    except BaseException:
        for path in made:
            (path / LOCK).unlink(missing_ok=True)
            try:
                path.rmdir()
            except OSError:
                break
        raise


@contextmanager
def sole_writer(folder: Path) -> Iterator[None]:
    """Hold the folder's lock, which the system frees however the process ends. Raises ConflictError where it is held."""
    with (folder / LOCK).open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ConflictError(
                f"{folder}: another wayloom process is writing there; wait for it or choose another folder"
            ) from None
        yield


@contextmanager
def whole_folder(target: Path) -> Iterator[Path]:
    """A temporary folder beside `target` that takes its place when the block ends well, and vanishes when it does not."""
    temporary = Path(tempfile.mkdtemp(prefix=UNFINISHED, dir=target.parent))
    try:
        temporary.chmod(0o755)
        yield temporary
        put_in_place(temporary, target)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def put_in_place(source: Path, target: Path) -> None:
    """Move a file or folder to `target`, on the same disk, replacing what is there."""
    if target.is_dir() and not target.is_symlink():
        old = Path(tempfile.mkdtemp(prefix=UNFINISHED, dir=target.parent))
        target.rename(old / target.name)
        source.rename(target)
        shutil.rmtree(old, ignore_errors=True)
    else:
        os.replace(source, target)


def discard(path: Path) -> None:
    """Remove a file or folder, if it is there."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def sweep(folder: Path) -> None:
    """Remove what killed processes left. Only for the holder of the folder's lock."""
    for leftover in folder.glob(f"{UNFINISHED}*"):
        with suppress(OSError):
            discard(leftover)
