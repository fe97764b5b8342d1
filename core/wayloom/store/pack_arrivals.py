"""Bytes of one request that continues a pack: verified on the way, split into files, and these stored in batches."""

import fcntl
import os
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from hashlib import sha256
from typing import Final

from wayloom.errors import ChecksumMismatchError
from wayloom.store.arrivals import PieceCheck, Pieces
from wayloom.store.folders import Folders
from wayloom.store.packs import Pack, install, stored
from wayloom.store.uploads import FOR_WRITING, write_at

BATCH_BYTES: Final = 16 << 20
BATCH_FILES: Final = 2000
"""Files that are made durable by one flush and told to the database in one transaction: few bytes, so that at the end of a request
there is little to wait for."""


class FileMismatchError(ChecksumMismatchError):
    """A file of a pack is whole and not the one that was announced: it has to be sent again, those before it have arrived."""

    code = "file-mismatch"


class PackArrival:
    """As `wayloom.store.arrivals.Arrival`, of many files. Whole files are put into their places by a thread of its own, while the
    next ones come; `close` waits for it, whatever ended the request.

    commit : called with how many of the pack's files lie in their places, after each batch
    """

    waits_for_disk = False

    def __init__(self, folders: Folders, pack: Pack, pieces: Pieces | None, commit: Callable[[int], None]) -> None:
        self._folders, self._pack, self._commit = folders, pack, commit
        self._check = None if pieces is None else PieceCheck(pieces, self._keep)
        self._number, self._within, self._fd = 0, 0, -1
        self._whole: list[int] = []
        self._lock = (folders.uploads / f"{pack.upload_id}.pack").open("r+b")
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BaseException:
            self._lock.close()
            raise
        self._prefix = f"{folders.uploads}/{pack.upload_id}."
        self._installer = ThreadPoolExecutor(1)
        self._installed: Future[None] | None = None

    @property
    def offset(self) -> int:
        """How many bytes of the pack are kept."""
        return self._pack.starts[self._number] + self._within

    def begin(self, files_done: int) -> None:
        """Take up files that are whole but were not told to the database, and the beginning of the next one, as they are now that
        nobody else writes. Raises OSError and lets go of everything then."""
        try:
            at = stored(self._folders, self._pack, files_done)
            self._number, self._within = at.files, at.bytes
            self._whole = list(range(files_done, self._number))
            self._open_next()
        except BaseException:
            self._close_file()
            self._let_go()
            raise

    def take(self, content: memoryview) -> None:
        """The next bytes. Raises ChecksumMismatchError, OSError."""
        if self._check is None:
            self._keep(content)
        else:
            self._check.take(content)

    def end(self) -> None:
        """All bytes of the request have come. Raises ChecksumMismatchError."""
        if self._check is not None:
            self._check.end(self.offset)

    def close(self) -> None:
        """Store what is whole and let go of the files. Raises OSError, and what `commit` raises."""
        try:
            self._close_file()
            self._install()
            self._wait()
        finally:
            self._let_go()

    def _let_go(self) -> None:
        self._installer.shutdown()
        self._lock.close()

    def _keep(self, content: memoryview) -> None:
        while content:
            size = self._pack.files[self._number].size
            some = content[: size - self._within]
            write_at(self._fd, some, self._within)
            self._sha.update(some)
            self._within += len(some)
            content = content[len(some) :]
            if self._within == size:
                self._finish()
                self._open_next()

    def _finish(self) -> None:
        """The file is whole: verify it, and hand it over where a batch is full."""
        file, found = self._pack.files[self._number], self._sha.hexdigest()
        self._close_file()
        if found != file.sha256:
            self._pack.part(self._folders, self._number).drop()
            self._within = 0
            raise FileMismatchError(f"{file.path} has SHA-256 {found}, its manifest says {file.sha256}: send it again")
        self._whole.append(self._number)
        self._number, self._within = self._number + 1, 0
        if len(self._whole) >= BATCH_FILES or self._pack.starts[self._number] - self._pack.starts[self._whole[0]] >= BATCH_BYTES:
            self._install()

    def _open_next(self) -> None:
        """The next file that is not empty; empty ones are whole."""
        while self._number < len(self._pack.files):
            self._fd, self._sha = os.open(f"{self._prefix}{self._number}", FOR_WRITING, 0o640), sha256()
            if self._within < self._pack.files[self._number].size:
                break
            self._finish()
        if self._within:
            self._sha.update(os.pread(self._fd, self._within, 0))

    def _close_file(self) -> None:
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def _install(self) -> None:
        """Hand the whole files over, when those before them are in their places."""
        if not self._whole:
            return
        self._wait()
        numbers, self._whole = self._whole, []
        self._installed = self._installer.submit(self._put, numbers)

    def _put(self, numbers: list[int]) -> None:
        install(self._folders, self._pack, numbers)
        self._commit(numbers[-1] + 1)

    def _wait(self) -> None:
        if self._installed is not None:
            installed, self._installed = self._installed, None
            installed.result()
