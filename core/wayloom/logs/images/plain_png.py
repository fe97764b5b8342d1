"""Plain PNG images, 8 bits a channel, decoded in a third of the time that OpenCV takes.

A drive's images are most of what reading it costs.
"""

from typing import Final

import numpy as np
from isal import isal_zlib
from numpy.typing import NDArray

from wayloom.logs.kernels.png_rows import unfilter, unfilter_to_grey

Image = NDArray[np.uint8]
CHANNELS: Final = {b"\x08\x00\x00\x00\x00": 1, b"\x08\x02\x00\x00\x00": 3}
"""By the header's bit depth, colour type, compression, filter method and interlacing: grey and RGB."""
FILTERS: Final = 5
"""Kinds of filters that a row may have, from 0."""
MOST_RATIO: Final = 1032
"""Deflate makes of a byte no more than so many (RFC 1951: 258 bytes of two bits)."""


def decode(chunks: list[tuple[bytes, memoryview]], *, colour: bool | None = None) -> Image | None:
    """The image of a PNG's chunks, kind and content, whose check sums are right: (h, w, 3) RGB or (h, w) grey, uint8.

    colour : which of the two it has to be; None for the one that is stored. Grey of colours is as OpenCV's PNG reader has it.
    None where it is not 8 bit grey or RGB in rows from top to bottom, where its stream has a fault, or where grey is asked to be
    coloured. No more is unpacked than the header promises.
    """
    rows = _filtered_rows(chunks)
    if rows is None:
        return None
    filtered, width, channels = rows
    if colour and channels == 1:
        return None
    height = len(filtered)
    if channels == 3 and colour is False:
        image = np.empty((height, width), np.uint8)
        return image if unfilter_to_grey(filtered, np.empty((2, 3 * width), np.uint8), image) else None
    image = np.empty((height, channels * width), np.uint8)
    if not unfilter(filtered, channels, image):
        return None
    return image if channels == 1 else image.reshape(height, width, 3)


def size_of_whole(chunks: list[tuple[bytes, memoryview]]) -> tuple[int, int, int] | None:
    """Width, height and channels of an image that `decode` would decode; None where it would not. Its pixels are not made."""
    rows = _filtered_rows(chunks)
    if rows is None:
        return None
    filtered, width, channels = rows
    return (width, len(filtered), channels) if filtered[:, 0].max() < FILTERS else None


def _filtered_rows(chunks: list[tuple[bytes, memoryview]]) -> tuple[Image, int, int] | None:
    """Rows (h, 1 + w channels), each row's filter before it, width and channels; None for what is not plain or has a fault."""
    kind, header = chunks[0]
    channels = CHANNELS.get(bytes(header[8:])) if kind == b"IHDR" else None
    if channels is None:
        return None
    width, height = int.from_bytes(header[:4], "big"), int.from_bytes(header[4:8], "big")
    stream = b"".join(content for kind, content in chunks if kind == b"IDAT")
    size = (channels * width + 1) * height
    if not width or not height or size > MOST_RATIO * len(stream):  # a header that lies is left to OpenCV, which has its limits
        return None
    rows = unpacked(stream, size)
    return None if rows is None else (np.frombuffer(rows, np.uint8).reshape(height, -1), width, channels)


def unpacked(stream: bytes, size: int) -> bytes | None:
    """What a zlib stream holds, None where that is not exactly so many bytes, or the stream has a fault or no end."""
    unpacker = isal_zlib.decompressobj()
    try:
        rows = unpacker.decompress(stream, size + 1)
    except isal_zlib.error:  # type: ignore[misc]  # a class, which the stub takes for an instance
        return None
    return rows if len(rows) == size and unpacker.eof else None
