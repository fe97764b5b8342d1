"""Bytes of one request that continues an upload: written, verified on the way, and kept as far as they are right.

Three kinds, by what the request says of its bytes:

Arrival         nothing: kept as far as they came
PieceArrival    the CRC-32 of each piece of them: kept up to the last whole piece that is right
StagedArrival   one digest of all of them (tus' own checksum): kept whole or not at all
"""

import fcntl
import os
import threading
from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from hashlib import sha256
from typing import Final, Protocol

from isal import isal_zlib

from wayloom.errors import ChecksumMismatchError
from wayloom.store.uploads import Part, open_past_cache, write_at, write_past_cache

RUNNING_DIGESTS: Final = 1024
LEAST_PAST_CACHE: Final = 1 << 20
"""Bytes written at once that go past the page cache: copying them there costs more than hashing, and pushes out what is read."""


class Digest(Protocol):
    """A running hash."""

    def update(self, content: bytes | memoryview, /) -> None: ...
    def digest(self) -> bytes: ...
    def hexdigest(self) -> str: ...
    def copy(self) -> "Digest": ...


@dataclass(frozen=True, slots=True)
class Pieces:
    """size: bytes of every piece but the last, which may be shorter; sums: the CRC-32 of each."""

    size: int
    sums: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Whole:
    """digest: a running hash, of nothing yet; expected: what it has to be of all bytes of the request."""

    digest: Digest
    expected: bytes


Checks = Pieces | Whole | None
"""What a request says of its bytes, to verify them by."""
Stamp = tuple[int, int]


class RunningDigests:
    """SHA-256 of what has come of each upload, so that a whole file need not be read again. Safe to share between threads.

    One is good only while the bytes are as they were left, which their stamp tells: another process may have written to them.
    """

    def __init__(self) -> None:
        self._known: OrderedDict[str, tuple[Digest, int, Stamp]] = OrderedDict()
        self._lock = threading.Lock()

    def take(self, upload_id: str, start: int, stamp: Stamp) -> Digest | None:
        """That of the first `start` bytes, None where it is not known."""
        with self._lock:
            known = self._known.pop(upload_id, None)
        if start == 0:
            return sha256()
        return known[0] if known is not None and known[1:] == (start, stamp) else None

    def keep(self, upload_id: str, size: int, stamp: Stamp, digest: Digest | None) -> None:
        """Remember that of the first `size` bytes, which are all that is stored."""
        if digest is None or size == 0:
            return
        with self._lock:
            self._known[upload_id] = (digest, size, stamp)
            while len(self._known) > RUNNING_DIGESTS:
                self._known.popitem(last=False)


def stamp_of(part: Part) -> Stamp:
    """By which to tell that a file was written to."""
    try:
        found = os.stat(part.path)
    except FileNotFoundError:
        return (0, 0)
    return found.st_ino, found.st_mtime_ns


class Arrival:
    """Bytes of which nothing is said, written from `start` on. Every method is blocking: call it from a thread.

    offset  how many bytes of the file are kept
    sha     of all of them, None where it is not known
    closed  called when the file was let go of

    Raises BlockingIOError where another process writes to the same upload.
    """

    waits_for_disk = True

    def __init__(self, part: Part, start: int, sha: Digest | None) -> None:
        self.offset, self.sha = start, sha
        self.closed: Callable[[], None] = lambda: None
        self._path, self._fd = part.path, part.open()
        self._direct: int | None = None
        self._writer: ThreadPoolExecutor | None = None
        try:
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BaseException:
            os.close(self._fd)
            raise

    def take(self, content: memoryview) -> None:
        """The next bytes. Raises ChecksumMismatchError, OSError."""
        self._keep(content)

    def end(self) -> None:
        """All bytes of the request have come. Raises ChecksumMismatchError, OSError."""

    def close(self) -> None:
        """Let go of the file."""
        if self._writer is not None:
            self._writer.shutdown()
        os.close(self._fd)
        if self._direct is not None:
            os.close(self._direct)
        self.closed()

    def _keep(self, content: memoryview) -> None:
        if len(content) >= LEAST_PAST_CACHE and self.sha is not None:
            self._keep_much(content, self.sha)
            return
        write_past_cache(self._direct, self._fd, content, self.offset)
        self.offset += len(content)
        if self.sha is not None:
            self.sha.update(content)

    def _keep_much(self, content: memoryview, sha: Digest) -> None:
        """Write and hash at the same time."""
        if self._writer is None:
            self._writer, self._direct = ThreadPoolExecutor(1), open_past_cache(self._path)
        writing = self._writer.submit(write_past_cache, self._direct, self._fd, content, self.offset)
        self.sha = None  # it is ahead of what is stored, until that is stored
        sha.update(content)
        writing.result()
        self.offset, self.sha = self.offset + len(content), sha


class PieceCheck:
    """Passes on the bytes of whole pieces that have the sum announced, and stops at the first that has not.

    keep : takes the verified bytes
    """

    def __init__(self, pieces: Pieces, keep: Callable[[memoryview], None]) -> None:
        self._pieces, self._keep, self._next, self._rest = pieces, keep, 0, b""

    def take(self, content: memoryview) -> None:
        """The next bytes. Raises ChecksumMismatchError."""
        content = memoryview(self._rest + content) if self._rest else content
        whole = len(content) - len(content) % self._pieces.size
        self._verify(content[:whole])
        self._rest = bytes(content[whole:])

    def end(self, offset: int) -> None:
        """The last bytes have come. Raises ChecksumMismatchError."""
        self._verify(memoryview(self._rest))
        if self._next < len(self._pieces.sums):
            raise ChecksumMismatchError(
                f"{len(self._pieces.sums)} pieces were announced, {self._next} came: send the rest, from byte {offset} on"
            )

    def _verify(self, content: memoryview) -> None:
        """Keep the pieces up to the first that is not as announced."""
        size, sums = self._pieces.size, self._pieces.sums
        for start in range(0, len(content), size):
            if self._next >= len(sums) or isal_zlib.crc32(content[start : start + size]) != sums[self._next]:
                self._keep(content[:start])
                raise ChecksumMismatchError(
                    f"piece {self._next} of the chunk does not have the sum that was sent: ask with HEAD and send it again"
                )
            self._next += 1
        self._keep(content)


class PieceArrival(Arrival):
    """Bytes in pieces with a sum each: of a link that breaks, or a bit that flips, nothing before the damaged piece is lost."""

    def __init__(self, part: Part, start: int, sha: Digest | None, pieces: Pieces) -> None:
        super().__init__(part, start, sha)
        self._check = PieceCheck(pieces, self._keep)

    def take(self, content: memoryview) -> None:
        self._check.take(content)

    def end(self) -> None:
        self._check.end(self.offset)


class StagedArrival(Arrival):
    """Bytes with one digest of all of them: they wait beside the upload until they are whole and right."""

    def __init__(self, part: Part, start: int, sha: Digest | None, staged: Part, whole: Whole) -> None:
        super().__init__(part, start, sha)
        self._part, self._staged, self._digest, self._expected = part, staged, whole.digest, whole.expected
        self._sha_ahead = None if sha is None else sha.copy()
        staged.drop()
        self._staged_fd, self._come = staged.open(), 0

    def take(self, content: memoryview) -> None:
        write_at(self._staged_fd, content, self._come)
        self._come += len(content)
        self._digest.update(content)
        if self._sha_ahead is not None:
            self._sha_ahead.update(content)

    def end(self) -> None:
        if self._digest.digest() != self._expected:
            raise ChecksumMismatchError("the chunk's bytes do not have the checksum that was sent: send it again")
        self._part.append(self._staged)
        self.offset, self.sha = self.offset + self._come, self._sha_ahead

    def close(self) -> None:
        os.close(self._staged_fd)
        self._staged.drop()
        super().close()
