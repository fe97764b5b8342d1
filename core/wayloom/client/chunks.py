"""Chunks of a file upload: how large the next one is on this link, the sums of its pieces, and its bytes, read as they are sent."""

import base64
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from io import FileIO
from pathlib import Path
from typing import Final

from isal import isal_zlib

from wayloom.errors import LogError

PIECE: Final = 64 << 10
"""Bytes of a piece: so much is sent again of what a broken link or a flipped bit has cut short."""
BLOCK: Final = 16 * PIECE
"""Bytes that are read and handed to the link at once."""
FIRST: Final = 8 << 20
LARGEST: Final = 64 << 20


@dataclass(slots=True)
class ChunkSize:
    """Bytes of one request: twice as many after a quick one, a quarter after one that the link has not survived.

    A link that is good gets few requests; one that breaks loses little, and one that is slow tells its progress every few seconds.
    """

    now: int = FIRST
    least: int = 4 * PIECE
    largest: int = LARGEST
    quick_s: float = 1.0
    slow_s: float = 8.0

    def arrived(self, seconds: float) -> None:
        """A whole chunk took so long."""
        if seconds < self.quick_s:
            self.now = min(self.now * 2, self.largest)
        elif seconds > self.slow_s:
            self.now = max(self.now // 2, self.least)

    def broke(self) -> None:
        """A chunk did not arrive whole."""
        self.now = max(self.now // 4, self.least)


@dataclass(frozen=True, slots=True)
class Span:
    """`count` bytes of a file of `size`, from `offset` on."""

    source: Path
    offset: int
    count: int
    size: int


@dataclass(frozen=True, slots=True)
class Chunk:
    """The bytes of spans, one behind the other. Raises LogError when a file is no longer what was announced."""

    spans: tuple[Span, ...]

    @property
    def count(self) -> int:
        """How many bytes."""
        return sum(span.count for span in self.spans)

    def headers(self) -> dict[str, str]:
        """What is said of the bytes: how many, and the sum of each piece."""
        sums = [isal_zlib.crc32(block[start : start + PIECE]) for block in self.blocks() for start in range(0, len(block), PIECE)]
        packed = base64.b64encode(struct.pack(f">{len(sums)}I", *sums)).decode()
        return {"Content-Length": str(self.count), "Upload-Pieces": f"crc32 {PIECE} {packed}"}

    def blocks(self) -> Iterator[memoryview]:
        """The bytes; every block but the last is of `BLOCK` bytes, and good until the next one is asked for."""
        buffer, filled = memoryview(bytearray(BLOCK)), 0
        for span in self.spans:
            with _opened(span) as stream:
                left = span.count
                while left:
                    come = stream.readinto(buffer[filled : filled + left])
                    if not come:
                        raise LogError(
                            f"has become shorter than the {span.size} bytes announced",
                            file=span.source,
                            remedy="run the command again",
                        )
                    left, filled = left - come, filled + come
                    if filled == BLOCK:
                        yield buffer
                        filled = 0
        if filled:
            yield buffer[:filled]


@contextmanager
def _opened(span: Span) -> Iterator[FileIO]:
    try:
        with span.source.open("rb", buffering=0) as stream:
            stream.seek(span.offset)
            yield stream
    except OSError as error:
        remedy = "check the file and run the command again"
        raise LogError(f"cannot be read ({error.strerror})", file=span.source, remedy=remedy) from None
