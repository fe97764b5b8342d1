"""Writer of an upload's parts: bytes are gathered, stored as an object and told to the database, while the next ones come."""

import contextlib
import uuid
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Final

from sqlalchemy.orm import Session

from wayloom.store.blobs import BlobError
from wayloom.store.database import Database
from wayloom.store.objects import Objects
from wayloom.store.receiving import parts
from wayloom.store.receiving.parts import StoredPart
from wayloom.store.tables.drives import Upload

PART_BYTES: Final = 4 << 20
"""Of an object: a kill costs so much, an upload holds twice as much in memory, 10 GB are 2,400 requests."""
Along = Callable[[Session], Callable[[], None]]
"""Writes rows in the transaction that tells of a part; returns what is to be done once it has committed."""


class PartWriter:
    """Appends to one upload. Every method is blocking.

    offset   bytes that are stored, and known to be
    come     and those that are on their way there
    on_hold  stored bytes are told of by `commit` alone; `drop` forgets them

    Whatever fails once fails from then on. Raises BlobError, NotFoundError, and BlockingIOError where somebody else has gone on.
    """

    def __init__(self, objects: Objects, database: Database, upload: Upload, *, on_hold: bool = False) -> None:
        self._objects, self._database, self._upload = objects, database, upload
        with database.read() as session:
            self.offset = parts.end_of(session, upload.id)
        self._next = self.offset
        self._buffer = bytearray()
        self._held: list[StoredPart] | None = [] if on_hold else None
        self._thread = ThreadPoolExecutor(1)
        self._storing: Future[None] | None = None
        self._failed = False

    @property
    def come(self) -> int:
        """Where the next byte goes."""
        return self._next + len(self._buffer)

    @property
    def is_full(self) -> bool:
        """Whether the bytes that have been gathered are enough of an object."""
        return len(self._buffer) >= PART_BYTES

    def write(self, content: memoryview) -> None:
        """Gather bytes."""
        self._buffer += content

    def store(self, along: Along | None = None) -> None:
        """Begin to store what has been gathered, once what was before it is stored."""
        self.wait()
        start, content, self._buffer = self._next, self._buffer, bytearray()
        self._next += len(content)
        self._storing = self._thread.submit(self._store, start, content, along)

    def wait(self) -> None:
        """Until nothing is being stored. Raises what that has raised."""
        if self._storing is None:
            return
        storing, self._storing, self._failed = self._storing, None, True
        storing.result()
        self._failed = False

    def cut(self, end: int) -> None:
        """Forget the bytes from `end` on."""
        self.wait()
        if end >= self._next:
            del self._buffer[end - self._next :]
            return
        self._buffer.clear()
        with self._database.write() as session:
            parts.lock(session, self._upload)
            if parts.end_of(session, self._upload.id) != self.offset:
                raise BlockingIOError("another process has continued this upload")
            names = parts.cut(session, self._upload.id, end)
        self.offset = self._next = end
        self._forget(names)

    def commit(self) -> None:
        """Tell of the bytes on hold, all or none."""
        self.store()
        self.wait()
        with self._database.write() as session:
            for part in self._held or ():
                parts.add(session, self._upload, part)
        self.offset, self._held = self._next, None

    def close(self, along: Along | None = None) -> None:
        """Store what has been gathered, and drop what is still on hold."""
        try:
            if not self._failed and self._held is None and (self._buffer or along is not None):
                self.store(along)
            self.wait()
        finally:
            self._thread.shutdown()
            if self._held:
                self._forget([part.name for part in self._held])

    def _store(self, start: int, content: bytearray, along: Along | None) -> None:
        part = None
        if content:
            folder = parts.folder_of(self._upload.drive_id, self._upload.id)
            part = StoredPart(start, len(content), f"{folder}/{start:016}-{uuid.uuid4().hex}")
            self._objects.put(part.name, content)
            if self._held is not None:
                self._held.append(part)
                return
        try:
            with self._database.write() as session:
                if part is not None:
                    parts.add(session, self._upload, part)
                committed = along(session) if along is not None else None
        except BaseException:
            self._forget([] if part is None else [part.name])
            raise
        self.offset = start + len(content)
        if committed is not None:
            committed()

    def _forget(self, names: list[str]) -> None:
        """What cannot be deleted now is an orphan, which the sweeper finds."""
        with contextlib.suppress(BlobError):
            self._objects.delete(names)
