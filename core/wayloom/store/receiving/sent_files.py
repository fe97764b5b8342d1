"""Files of a drive as they lie in the parts of its uploads."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby

from sqlalchemy import select

from wayloom.errors import NotFoundError
from wayloom.store.database import Database
from wayloom.store.objects import Objects
from wayloom.store.receiving import parts
from wayloom.store.tables.drives import DriveFile


@dataclass(frozen=True, slots=True)
class SentFile:
    """A file of a drive: which upload has it, and at which of its bytes it begins."""

    path: str
    size: int
    sha256: str
    upload_id: str
    start: int


def sent_files(database: Database, drive_id: str) -> list[SentFile]:
    """Those files of a drive that lie in an object store, in the order of the bytes of their uploads."""
    columns = DriveFile.path, DriveFile.size, DriveFile.sha256, DriveFile.upload_id, DriveFile.upload_start
    theirs = select(*columns).where(DriveFile.drive_id == drive_id, DriveFile.upload_id.is_not(None))
    with database.read() as session:
        found = session.execute(theirs.order_by(DriveFile.upload_id, DriveFile.upload_start)).all()
    return [SentFile(path, size, digest, str(upload), start or 0) for path, size, digest, upload, start in found]


def contents(database: Database, objects: Objects, files: Sequence[SentFile]) -> Iterator[tuple[SentFile, Iterator[memoryview]]]:
    """The bytes of each file, in the order of `sent_files`; to be read to their end before the next file's. Reading them raises
    NotFoundError where an object is gone, BlobError where the store does not answer."""
    for upload_id, of_upload in groupby(files, lambda file: file.upload_id):
        theirs = [*of_upload]
        with database.read() as session:
            stored = parts.parts_of(session, upload_id, theirs[0].start)
        stream = _Stream(parts.read(objects, stored, theirs[0].start), theirs[0].start)
        for file in theirs:
            yield file, stream.take(file.start, file.size)


class _Stream:
    """Bytes that come piece by piece, from `at` on, handed out file by file."""

    def __init__(self, pieces: Iterator[bytes], at: int) -> None:
        self._pieces, self._at, self._rest = pieces, at, memoryview(b"")

    def take(self, start: int, size: int) -> Iterator[memoryview]:
        """The bytes from `start` on, which are behind those taken before. Raises NotFoundError where they end too early."""
        skip, left = start - self._at, size
        while left or skip:
            if not self._rest:
                piece = next(self._pieces, None)
                if piece is None:
                    raise NotFoundError(f"the bytes end at {self._at}")
                self._rest = memoryview(piece)
            some = self._rest[: skip or left]
            self._rest, self._at = self._rest[len(some) :], self._at + len(some)
            if skip:
                skip -= len(some)
                continue
            left -= len(some)
            yield some
