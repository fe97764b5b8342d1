"""Places in which uploads are kept, behind one interface."""

from collections.abc import Iterator, Sequence
from typing import Protocol

from wayloom.store.arrivals import Checks, Pieces
from wayloom.store.packs import Pack, PackedFile
from wayloom.store.receiving.pack_rows import PackRows
from wayloom.store.tables.drives import Upload


class Arriving(Protocol):
    """Bytes of one request that continues an upload. Every method is blocking: call it from a thread.

    waits_for_disk : whether `take` does; otherwise it puts the bytes into memory, from where they go on meanwhile
    """

    waits_for_disk: bool

    @property
    def offset(self) -> int:
        """How many bytes of the upload are kept."""

    def take(self, content: memoryview) -> None:
        """The next bytes. Raises ChecksumMismatchError, OSError, BlobError."""

    def end(self) -> None:
        """All bytes of the request have come. Raises ChecksumMismatchError, OSError, BlobError."""

    def close(self) -> None:
        """Keep what has come and is right, whatever ended the request, and let go of the upload. Raises OSError, BlobError."""


class UploadPlace(Protocol):
    """Where the bytes of uploads are kept, and those of drives' files. Every method is blocking.

    in_objects : they stay where they have come to, in the parts of an object store; otherwise they go into the drives' folders

    Raises OSError, BlobError where it cannot be reached; BlockingIOError where another process writes to the same upload.
    """

    @property
    def in_objects(self) -> bool:
        """As said above."""

    def offset(self, upload: Upload) -> int:
        """How many bytes of an upload, of a file or a pack, are kept."""

    def arrival(self, upload: Upload, start: int, checks: Checks) -> Arriving:
        """Take bytes of the upload of a file, from `start` on. Raises OffsetConflictError where others have stored more since."""

    def pack_arrival(self, upload: Upload, pieces: Pieces | None, rows: PackRows) -> Arriving:
        """Take bytes of a pack, behind those that are kept."""

    def settle(self, upload: Upload, expected: str) -> str:
        """Bring a whole file to its place and return its SHA-256; one that is not as expected stays nowhere."""

    def drop(self, upload: Upload) -> None:
        """Forget the bytes of an upload whose row is gone, but for the files of a pack that have arrived."""

    def index(self, upload: Upload, files: Sequence[PackedFile]) -> Pack:
        """Write down which files a pack has."""

    def is_indexed(self, upload: Upload) -> bool:
        """Whether that was done."""

    def pack(self, upload: Upload) -> Pack:
        """The pack of an upload. Raises NotFoundError where its index is gone."""

    def files(self, drive_id: str) -> Iterator[tuple[str, int, Iterator[bytes | memoryview]]]:
        """Path, size and bytes of each file of a drive that has arrived; to be read to their end before the next file's."""

    def check(self) -> None:
        """Raise BlobError where it does not answer."""
