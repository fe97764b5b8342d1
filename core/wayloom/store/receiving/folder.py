"""Uploads in the data folder: the stored bytes, whose number is the offset, and the drives' folders to which whole files go."""

import os
from collections.abc import Iterator, Sequence
from typing import Final

from wayloom.store import packs, uploads
from wayloom.store.arrivals import Arrival, Checks, PieceArrival, Pieces, RunningDigests, StagedArrival, stamp_of
from wayloom.store.folders import Folders
from wayloom.store.manifest import FOLDERS
from wayloom.store.pack_arrivals import PackArrival
from wayloom.store.packs import Pack, PackedFile
from wayloom.store.receiving.pack_rows import PackRows
from wayloom.store.receiving.places import Arriving
from wayloom.store.tables.drives import Upload

BLOCK: Final = 1 << 20


class FolderPlace:
    """As `wayloom.store.receiving.places.UploadPlace`."""

    in_objects = False

    def __init__(self, folders: Folders) -> None:
        self._folders, self._digests = folders, RunningDigests()

    def offset(self, upload: Upload) -> int:
        """By the size of the files."""
        if upload.files_done is None or upload.complete:
            return uploads.stored_bytes(self._folders, upload)
        pack = self.pack(upload)
        at = packs.stored(self._folders, pack, upload.files_done)
        return pack.starts[at.files] + at.bytes

    def arrival(self, upload: Upload, start: int, checks: Checks) -> Arriving:
        """Under a lock of the file's."""
        target = uploads.part(self._folders, upload.id)
        sha = self._digests.take(upload.id, start, stamp_of(target))
        if isinstance(checks, Pieces):
            arrival: Arrival = PieceArrival(target, start, sha, checks)
        elif checks is None:
            arrival = Arrival(target, start, sha)
        else:
            arrival = StagedArrival(target, start, sha, uploads.staged_part(self._folders, upload.id), checks)
        arrival.closed = lambda: self._digests.keep(upload.id, arrival.offset, stamp_of(target), arrival.sha)
        return arrival

    def pack_arrival(self, upload: Upload, pieces: Pieces | None, rows: PackRows) -> Arriving:
        """Under a lock of the index's."""
        arrival = PackArrival(self._folders, rows.pack, pieces, rows.tell)
        arrival.begin(rows.done)
        return arrival

    def settle(self, upload: Upload, expected: str) -> str:
        """By one rename."""
        running = self._digests.take(upload.id, upload.length, stamp_of(uploads.part(self._folders, upload.id)))
        return uploads.settle(self._folders, upload, expected, None if running is None else running.hexdigest())

    def drop(self, upload: Upload) -> None:
        """At once."""
        packs.drop(self._folders, upload.id)

    def index(self, upload: Upload, files: Sequence[PackedFile]) -> Pack:
        """In a file beside the bytes."""
        return packs.index(self._folders, upload, files)

    def is_indexed(self, upload: Upload) -> bool:
        """Whether there is that file."""
        return packs.is_indexed(self._folders, upload.id)

    def pack(self, upload: Upload) -> Pack:
        """By that file."""
        return packs.of(self._folders, upload)

    def files(self, drive_id: str) -> Iterator[tuple[str, int, Iterator[bytes | memoryview]]]:
        """Those of the drive's folder."""
        home = self._folders.drive(drive_id)
        for path in (path for top in FOLDERS for path in sorted((home / top).rglob("*")) if path.is_file()):
            with path.open("rb") as file:
                yield path.relative_to(home).as_posix(), os.fstat(file.fileno()).st_size, iter(lambda: file.read(BLOCK), b"")

    def check(self) -> None:
        """It is always there."""
