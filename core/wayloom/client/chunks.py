"""Chunks of a file upload: how large the next one is on this link, the sums of its pieces, and its bytes, read as they are sent."""

import base64
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from wayloom.errors import LogError

PIECE: Final = 64 << 10
"""Bytes of a piece: so much is sent again of what a broken link or a flipped bit has cut short."""
BLOCK: Final = 4 * PIECE
"""Bytes that are read and handed to the link at once."""
FIRST: Final = 4 << 20
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
class Chunk:
    """`count` bytes of a file of `size`, from `offset` on. Raises LogError when the file is no longer what was announced."""

    source: Path
    offset: int
    count: int
    size: int

    def headers(self) -> dict[str, str]:
        """What is said of the bytes: how many, and the sum of each piece."""
        sums = [zlib.crc32(block[start : start + PIECE]) for block in self.blocks() for start in range(0, len(block), PIECE)]
        packed = base64.b64encode(struct.pack(f">{len(sums)}I", *sums)).decode()
        return {"Content-Length": str(self.count), "Upload-Pieces": f"crc32 {PIECE} {packed}"}

    def blocks(self) -> Iterator[bytes]:
        """The bytes."""
        try:
            with self.source.open("rb") as stream:
                stream.seek(self.offset)
                left = self.count
                while left:
                    block = stream.read(min(BLOCK, left))
                    if not block:
                        raise LogError(
                            f"has become shorter than the {self.size} bytes announced",
                            file=self.source,
                            remedy="run the command again",
                        )
                    left -= len(block)
                    yield block
        except OSError as error:
            remedy = "check the file and run the command again"
            raise LogError(f"cannot be read ({error.strerror})", file=self.source, remedy=remedy) from None
