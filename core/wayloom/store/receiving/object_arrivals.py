"""Bytes of one request that continues an upload in an object store: verified on the way, and kept as far as they are right."""

from collections.abc import Callable
from hashlib import sha256

from wayloom.errors import ChecksumMismatchError, NotFoundError
from wayloom.store.arrivals import Checks, Digest, PieceCheck, Pieces, Whole
from wayloom.store.pack_arrivals import FileMismatchError
from wayloom.store.receiving.pack_rows import PackRows
from wayloom.store.receiving.part_writer import Along, PartWriter


class ObjectArrival:
    """Bytes of one file. Every method is blocking: call it from a thread.

    closed : called when the upload was let go of
    """

    waits_for_disk = False

    def __init__(self, writer: PartWriter, sha: Digest | None, checks: Checks) -> None:
        self._writer, self._sha = writer, sha
        self.closed: Callable[[], None] = lambda: None
        self._check = PieceCheck(checks, self._keep) if isinstance(checks, Pieces) else None
        self._whole = checks if isinstance(checks, Whole) else None

    @property
    def offset(self) -> int:
        """How many bytes of the file are stored."""
        return self._writer.offset

    @property
    def sha(self) -> Digest | None:
        """Of all bytes that are stored, None where it is not known, as where some were dropped on the way."""
        return self._sha if self._writer.offset == self._writer.come else None

    def take(self, content: memoryview) -> None:
        """The next bytes. Raises ChecksumMismatchError, and what `PartWriter` raises."""
        if self._check is None:
            self._keep(content)
        else:
            self._check.take(content)

    def end(self) -> None:
        """All bytes of the request have come. Raises ChecksumMismatchError."""
        if self._check is not None:
            self._check.end(self._writer.come)
        if self._whole is not None:
            if self._whole.digest.digest() != self._whole.expected:
                raise ChecksumMismatchError("the chunk's bytes do not have the checksum that was sent: send it again")
            self._writer.commit()

    def close(self) -> None:
        """Store what has come."""
        self._writer.close()
        self.closed()

    def _keep(self, content: memoryview) -> None:
        self._writer.write(content)
        for digest in (self._sha, None if self._whole is None else self._whole.digest):
            if digest is not None:
                digest.update(content)
        if self._writer.is_full:
            self._writer.store()


class ObjectPackArrival:
    """Bytes of a pack: one stream, in which each file is verified; with a part those files are done whose last byte it has.

    begun : the bytes of the next file that are stored already
    """

    waits_for_disk = False

    def __init__(self, writer: PartWriter, rows: PackRows, begun: bytes, pieces: Pieces | None) -> None:
        self._writer, self._rows, self._files = writer, rows, rows.pack.files
        self._number, self._within, self._sha = rows.done, len(begun), sha256(begun)
        self._check = None if pieces is None else PieceCheck(pieces, self._keep)
        if rows.pack.starts[rows.done] + len(begun) != writer.offset:
            raise NotFoundError("bytes of the pack are gone: start it again")
        self._finish_whole()

    @property
    def offset(self) -> int:
        """How many bytes of the pack are stored."""
        return self._writer.offset

    def take(self, content: memoryview) -> None:
        """The next bytes. Raises ChecksumMismatchError, and what `PartWriter` raises."""
        if self._check is None:
            self._keep(content)
        else:
            self._check.take(content)

    def end(self) -> None:
        """All bytes of the request have come. Raises ChecksumMismatchError."""
        if self._check is not None:
            self._check.end(self._writer.come)

    def close(self) -> None:
        """Store what has come, and tell of the files that are whole."""
        try:
            self._writer.wait()
        finally:
            self._writer.close(self._along() if self._number > self._rows.done else None)

    def _along(self) -> Along:
        done = self._number
        return lambda session: self._rows.tell_within(session, done, in_objects=True)

    def _keep(self, content: memoryview) -> None:
        while content:
            some = content[: self._files[self._number].size - self._within]
            self._writer.write(some)
            self._sha.update(some)
            self._within += len(some)
            content = content[len(some) :]
            self._finish_whole()
        if self._writer.is_full:
            self._writer.store(self._along())

    def _finish_whole(self) -> None:
        """The next file, and those behind it that are empty, where its last byte has come."""
        while self._number < len(self._files) and self._within == self._files[self._number].size:
            file, found = self._files[self._number], self._sha.hexdigest()
            self._within, self._sha = 0, sha256()
            if found != file.sha256:
                self._writer.cut(self._rows.pack.starts[self._number])
                raise FileMismatchError(f"{file.path} has SHA-256 {found}, its manifest says {file.sha256}: send it again")
            self._number += 1
