"""Binary container of named arrays whose bytes depend on their content alone, used by submaps, places and point tiles.

    8 bytes magic · uint32 version · uint32 length of the header · header · body          (all little-endian)

The header is JSON (UTF-8, sorted keys, filled up with spaces to a multiple of 8 bytes); its key "arrays" lists
[name, dtype, shape, offset in the body] of each array, each at a multiple of 8 bytes. Nothing is compressed, so equal content is
equal bytes on every machine, and a browser can lay typed arrays over it.
"""

import json
import mmap
import struct
from collections.abc import Iterator, Mapping
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from wayloom.files.growing_arrays import forget_pages

Piece: TypeAlias = bytes | memoryview
ALIGNMENT = 8
PIECE_BYTES = 1 << 22
PREFIX = 16


def encode_blob(magic: bytes, version: int, header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """The bytes of a header and arrays (in their order, in their own dtypes, little-endian)."""
    return b"".join(blob_pieces(magic, version, header, arrays))


def blob_pieces(magic: bytes, version: int, header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> Iterator[Piece]:
    """As `encode_blob`, in pieces of some megabytes: a file is written without a copy of its arrays, and those that lie in files
    themselves (`growing_arrays`) are never in memory as a whole."""
    table, end = [], 0
    for name, array in arrays.items():
        start = end + -end % ALIGNMENT
        little = array.dtype.newbyteorder("<")
        table.append([name, little.str, list(np.atleast_1d(array).shape), start])
        end = start + array.nbytes
    text = json.dumps({**header, "arrays": table}, sort_keys=True, separators=(",", ":")).encode()
    text += b" " * (-len(text) % ALIGNMENT)
    yield magic + struct.pack("<II", version, len(text)) + text
    end = 0
    for array in arrays.values():
        yield bytes(-end % ALIGNMENT)
        body = np.ascontiguousarray(array, array.dtype.newbyteorder("<")).reshape(-1).view(np.uint8)
        for first in range(0, len(body), PIECE_BYTES):
            yield body[first : first + PIECE_BYTES].data
            forget_pages(array)
        end += -end % ALIGNMENT + array.nbytes


def decode_blob(
    data: bytes | mmap.mmap, magic: bytes, version: int, dtypes: Mapping[str, str]
) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Header and arrays. Raises ValueError when the bytes are something else, of another version, cut off or too long."""
    if data[: len(magic)] != magic or len(data) < PREFIX:
        raise ValueError(f"it begins with {data[:8]!r}, not with {magic!r}")
    found, length = struct.unpack_from("<II", data, len(magic))
    if found != version:
        raise ValueError(f"it has version {found}, this program reads {version}")
    header = json.loads(data[PREFIX : PREFIX + length])
    body = memoryview(data)[PREFIX + length :]
    table = header.pop("arrays")
    if [row[:2] for row in table] != [[name, dtype] for name, dtype in dtypes.items()]:
        raise ValueError(f"it does not hold the arrays of version {version}")
    arrays, end = {}, 0
    for name, dtype, shape, offset in table:
        count = int(np.prod(shape, dtype=np.int64))
        arrays[name] = np.frombuffer(body, dtype, count, offset).reshape(shape)
        end = offset + arrays[name].nbytes
    if end != len(body):
        raise ValueError(f"it has {len(body)} bytes of arrays, not {end}")
    return header, arrays
