"""Files of drives where stages read them: in the data folder, fetched there from the object store into which they were sent.

A drive is fetched as a whole, by whichever worker needs it first, into the folder that it would have come to by itself. A file
beside says so once everything is there and durable; its time is that of the last use. While a stage runs, and while files come or
go, the drive's folder is under a file lock, so that several workers and sweepers of one data folder are not in each other's way.
"""

import fcntl
import hashlib
import json
import os
import shutil
import uuid
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final, TextIO

from wayloom.config.progress import Progress
from wayloom.errors import NotFoundError, StageError
from wayloom.store.database import Database, now_s
from wayloom.store.folders import Folders
from wayloom.store.manifest import FOLDERS
from wayloom.store.objects import Objects
from wayloom.store.packs import make_durable
from wayloom.store.receiving import parts
from wayloom.store.receiving.sent_files import SentFile, contents, sent_files

FETCHED: Final = "fetched.json"
LOCK: Final = "files.lock"
COMING: Final = "fetching"
SAID_EVERY: Final = 64 << 20
"""Bytes between two words of progress."""
ORPHAN_S: Final = 86_400.0
"""Age of an object that no row names before it is deleted: longer than any request takes."""


class DriveFiles:
    """The files of all drives of a service.

    objects : the object store into which they are sent; None where they come to the data folder at once
    most    : bytes that are kept in the data folder of what was fetched
    """

    def __init__(self, folders: Folders, database: Database, objects: Objects | None, most: int) -> None:
        self._folders, self._database, self._objects, self._most = folders, database, objects, most

    @contextmanager
    def held(self, drive_id: str, progress: Progress) -> Iterator[None]:
        """While the block runs, the drive's files lie in its folder.

        Raises StageError where one is gone or damaged, OSError, BlobError, and what `progress` raises.
        """
        files = sent_files(self._database, drive_id)
        if not files:
            yield
            return
        home = self._folders.drive(drive_id)
        home.mkdir(parents=True, exist_ok=True)
        with (home / LOCK).open("a") as lock:
            while not self._is_fetched(home, lock):
                self._fetch(home, files, lock, progress)
            os.utime(home / FETCHED)
            yield

    def evict(self) -> int:
        """Put fetched files into the trash, those first that were used least lately, until the others fit. Returns of how many
        drives; those that a stage is reading stay."""
        found = []
        for marker in self._folders.all_drives.glob(f"*/{FETCHED}"):
            try:
                found.append((marker.stat().st_mtime, int(json.loads(marker.read_text())["bytes"]), marker.parent))
            except (OSError, ValueError, KeyError):
                continue  # another sweeper was faster
        held, count = sum(size for _, size, _ in found), 0
        for _, size, home in sorted(found):
            if held <= self._most:
                break
            if self._move_out(home):
                held, count = held - size, count + 1
        return count

    def forget(self, names: Sequence[str]) -> None:
        """Delete objects that no row names any more. Raises BlobError."""
        if self._objects is not None:
            self._objects.delete(names)

    def drop_given_up(self) -> int:
        """Drop the bytes of uploads that have expired or were forgotten. Returns of how many."""
        if self._objects is None:
            return 0
        with self._database.read() as session:
            over = parts.given_up(session, now_s(session))
        for drive_id, upload_id in over:
            with self._database.write() as session:
                names = parts.release(session, drive_id, upload_id)
            self.forget(names)
        return len(over)

    def drop_orphans(self) -> int:
        """Delete objects that were stored a day ago and that no row names, as after a kill. Returns how many."""
        count = 0
        for names in () if self._objects is None else self._objects.older_than(ORPHAN_S, parts.BELOW):
            with self._database.read() as session:
                lost = parts.orphans(session, names)
            self.forget(lost)
            count += len(lost)
        return count

    @staticmethod
    def _is_fetched(home: Path, lock: TextIO) -> bool:
        """Under a lock that others may share, which stays."""
        fcntl.flock(lock, fcntl.LOCK_SH)
        return (home / FETCHED).exists()

    def _fetch(self, home: Path, files: Sequence[SentFile], lock: TextIO, progress: Progress) -> None:
        """Under a lock of our own."""
        fcntl.flock(lock, fcntl.LOCK_UN)
        fcntl.flock(lock, fcntl.LOCK_EX)
        if (home / FETCHED).exists():
            return
        if self._objects is None:
            raise StageError("the drive's files lie in an object store, and uploads.url names none: set it as it was")
        coming = home / COMING
        shutil.rmtree(coming, ignore_errors=True)
        total, done, said = sum(file.size for file in files), 0, 0
        for file, blocks in contents(self._database, self._objects, files):
            for size in _written(file, blocks, coming / file.path):
                done += size
                if done >= said:
                    progress(0.0, f"fetching the drive's files: {done >> 20} of {total >> 20} MiB")
                    said = done + SAID_EVERY
        places = [home / file.path for file in files]
        for folder in {place.parent for place in places}:
            folder.mkdir(parents=True, exist_ok=True)
        for file, place in zip(files, places, strict=True):
            os.replace(coming / file.path, place)
        make_durable(places)
        shutil.rmtree(coming)
        unfinished = home / f"{FETCHED}.new"
        unfinished.write_text(json.dumps({"bytes": total}))
        os.replace(unfinished, home / FETCHED)

    def _move_out(self, home: Path) -> bool:
        """Where nothing reads the drive's files."""
        try:
            with (home / LOCK).open("a") as lock:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                (home / FETCHED).unlink(missing_ok=True)
                self._folders.trash.mkdir(parents=True, exist_ok=True)
                for name in FOLDERS:
                    if (home / name).is_dir():
                        os.rename(home / name, self._folders.trash / uuid.uuid4().hex)
        except (BlockingIOError, FileNotFoundError):
            return False
        return True


def _written(file: SentFile, blocks: Iterator[memoryview], target: Path) -> Iterator[int]:
    """Write a file and verify it. Yields the bytes of each block. Raises StageError."""
    target.parent.mkdir(parents=True, exist_ok=True)
    found = hashlib.sha256()
    try:
        with target.open("wb") as out:
            for content in blocks:
                out.write(content)
                found.update(content)
                yield len(content)
    except NotFoundError as error:
        raise StageError(f"{file.path}: {error}: remove the drive and send it again") from error
    if found.hexdigest() != file.sha256:
        said = f"has SHA-256 {found.hexdigest()} in the object store, the manifest says {file.sha256}"
        raise StageError(f"{file.path} {said}: remove the drive and send it again")
