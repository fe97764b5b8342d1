"""Fast decoder for 8 bit grey PNG images."""

import threading

import numpy as np
from numpy.typing import NDArray

from wayloom.logs.kernels.inflate import DISTANCE_BITS, LENGTH_BITS, LITERAL_BITS, PADDING, empty_code, inflate
from wayloom.logs.kernels.png_rows import unfilter

Image = NDArray[np.uint8]
GREY_8_BIT = b"\x08\x00\x00\x00\x00"
"""The header's bit depth, colour type, compression, filter method and interlacing."""


class _Workplace(threading.local):
    """A thread's working space."""

    def __init__(self) -> None:
        self.state, self.lengths = np.zeros(3, np.uint64), np.zeros(320, np.uint8)
        self.codes = empty_code(LENGTH_BITS, 19), empty_code(LITERAL_BITS, 288), empty_code(DISTANCE_BITS, 32)
        self.pairs = np.zeros(1 << LITERAL_BITS, np.uint32)
        self.packed, self.rows = np.zeros(0, np.uint8), np.zeros(0, np.uint8)

    def reserve(self, packed: int, rows: int) -> None:
        """Make room for so many bytes of the stream and of what comes out of it."""
        if len(self.packed) < packed + PADDING:
            self.packed = np.zeros(packed + packed // 4 + PADDING, np.uint8)
        if len(self.rows) < rows + PADDING:
            self.rows = np.zeros(rows + PADDING, np.uint8)


_WORKPLACE = _Workplace()
MOST_RATIO = 1032
"""Deflate makes of a byte no more than so many (RFC 1951: 258 bytes of two bits)."""


def decode(chunks: list[tuple[bytes, memoryview]]) -> Image | None:
    """The image (h, w) uint8 of a PNG's chunks, kind and content, whose check sums are right; None where it is not 8 bit grey in
    rows from top to bottom, or where its stream has a fault."""
    kind, header = chunks[0]
    if kind != b"IHDR" or header[8:] != GREY_8_BIT:
        return None
    width, height = int.from_bytes(header[:4], "big"), int.from_bytes(header[4:8], "big")
    stream = b"".join(content for kind, content in chunks if kind == b"IDAT")
    place, size, at = _WORKPLACE, (width + 1) * height, len(stream)
    if not width or not height or size > MOST_RATIO * at:  # a header that lies is left to OpenCV, which has its limits
        return None
    place.reserve(at, size)
    place.packed[:at] = np.frombuffer(stream, np.uint8)
    place.packed[at : at + PADDING] = 0
    code_lengths, literals, distances = place.codes
    packed, rows = place.packed[: at + PADDING], place.rows[: size + PADDING]
    if inflate(packed, rows, place.state, place.lengths, code_lengths, literals, distances, place.pairs) != size:
        return None
    image = np.empty((height, width), np.uint8)
    return image if unfilter(rows[:size].reshape(height, width + 1), image) else None
