"""Uploads in an object store: any process of the service, on any machine, continues any of them."""

import hashlib
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from typing import Final

from wayloom.errors import OffsetConflictError
from wayloom.store import packs
from wayloom.store.arrivals import Checks, Pieces, RunningDigests, Whole
from wayloom.store.database import Database
from wayloom.store.objects import Objects
from wayloom.store.packs import Pack, PackedFile
from wayloom.store.receiving import parts
from wayloom.store.receiving.object_arrivals import ObjectArrival, ObjectPackArrival
from wayloom.store.receiving.pack_rows import PackRows
from wayloom.store.receiving.part_writer import PartWriter
from wayloom.store.receiving.places import Arriving
from wayloom.store.receiving.sent_files import contents, sent_files
from wayloom.store.tables.drives import Upload

HELD_PACKS: Final = 16
NO_STAMP: Final = (0, 0)
"""Parts that stand in the database are never written to again."""


class ObjectPlace:
    """As `wayloom.store.receiving.places.UploadPlace`."""

    in_objects = True

    def __init__(self, objects: Objects, database: Database) -> None:
        self._objects, self._database = objects, database
        self._digests, self._packs = RunningDigests(), OrderedDict[str, Pack]()

    def offset(self, upload: Upload) -> int:
        """By the rows of its parts."""
        if upload.complete:
            return upload.length
        with self._database.read() as session:
            return parts.end_of(session, upload.id)

    def arrival(self, upload: Upload, start: int, checks: Checks) -> Arriving:
        """Without a lock: of two writers the one that comes second to the database hears of it."""
        writer = PartWriter(self._objects, self._database, upload, on_hold=isinstance(checks, Whole))
        if writer.offset != start:
            raise OffsetConflictError(f"{writer.offset} bytes are stored, the chunk starts at {start}: ask with HEAD")
        arrival = ObjectArrival(writer, self._digests.take(upload.id, start, NO_STAMP), checks)
        arrival.closed = lambda: self._digests.keep(upload.id, arrival.offset, NO_STAMP, arrival.sha)
        return arrival

    def pack_arrival(self, upload: Upload, pieces: Pieces | None, rows: PackRows) -> Arriving:
        """The beginning of the file at which it goes on is read again."""
        writer = PartWriter(self._objects, self._database, upload)
        begun = b"".join(self._read(upload, rows.pack.starts[rows.done])) if rows.done < len(rows.pack.files) else b""
        return ObjectPackArrival(writer, rows, begun, pieces)

    def settle(self, upload: Upload, expected: str) -> str:
        """It lies where it belongs; where its digest is not known it is read once more."""
        running = self._digests.take(upload.id, upload.length, NO_STAMP)
        if running is not None:
            return running.hexdigest()
        found = hashlib.sha256()
        for content in self._read(upload, 0):
            found.update(content)
        return found.hexdigest()

    def drop(self, upload: Upload) -> None:
        """The rows at once; objects that cannot be reached now are orphans, which the sweeper finds."""
        with self._database.write() as session:
            names = parts.release(session, upload.drive_id, upload.id)
        self._objects.delete([*names, *([] if upload.files_done is None else [_index(upload)])])

    def index(self, upload: Upload, files: Sequence[PackedFile]) -> Pack:
        """In an object beside the parts."""
        content = packs.index_of(files)
        self._objects.put(_index(upload), content)
        return packs.indexed(upload, content)

    def is_indexed(self, upload: Upload) -> bool:
        """Whether there is that object."""
        return self._objects.has(_index(upload))

    def pack(self, upload: Upload) -> Pack:
        """By that object; it is never changed after it is written."""
        found = self._packs.get(upload.id)
        if found is None:
            found = self._packs[upload.id] = packs.indexed(upload, self._objects.get_all(_index(upload)))
            while len(self._packs) > HELD_PACKS:
                self._packs.popitem(last=False)
        return found

    def files(self, drive_id: str) -> Iterator[tuple[str, int, Iterator[bytes | memoryview]]]:
        """Those of its uploads."""
        for file, blocks in contents(self._database, self._objects, sent_files(self._database, drive_id)):
            yield file.path, file.size, blocks

    def check(self) -> None:
        """Ask it for an object that is not there."""
        self._objects.has(f"{parts.BELOW}/nothing")

    def _read(self, upload: Upload, start: int) -> Iterator[bytes]:
        with self._database.read() as session:
            stored = parts.parts_of(session, upload.id, start)
        return parts.read(self._objects, stored, start)


def _index(upload: Upload) -> str:
    return f"{parts.folder_of(upload.drive_id, upload.id)}/pack"
