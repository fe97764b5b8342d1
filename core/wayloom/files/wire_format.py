"""Protocol buffers' wire format: what vector tiles are written with, and ONNX files are looked into with.

A record is a key (field << 3 | type) and a value; types 0 varint, 1 eight bytes, 2 length and bytes, 5 four bytes.
https://protobuf.dev/programming-guides/encoding
"""

import struct
from collections.abc import Iterator
from functools import lru_cache
from typing import Final

VARINT: Final = 0
EIGHT: Final = 1
BYTES: Final = 2
_FIXED: Final = {1: 8, 5: 4}


@lru_cache(maxsize=65_536)
def varint(value: int) -> bytes:
    """A whole number >= 0, seven bits a byte, the lowest first (LEB128)."""
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def field(number: int, content: bytes) -> bytes:
    """A record that bears its length: a message, a string or packed numbers."""
    return varint(number << 3 | BYTES) + varint(len(content)) + content


def number_field(number: int, value: int) -> bytes:
    """A record that is one whole number >= 0."""
    return varint(number << 3) + varint(value)


def double_field(number: int, value: float) -> bytes:
    """A record that is one number of double precision."""
    return varint(number << 3 | EIGHT) + struct.pack("<d", value)


def records(data: bytes, start: int, end: int) -> Iterator[tuple[int, int, int, int]]:
    """The records between two places of data: (field, type, low, high), the place of the bytes, or (value, value) of a varint.

    Raises ValueError where the data is not of this format.
    """
    at = start
    while at < end:
        key, at = _read_varint(data, at, end)
        number, kind = key >> 3, key & 7
        if kind == VARINT:
            value, at = _read_varint(data, at, end)
            yield number, kind, value, value
            continue
        if kind == BYTES:
            size, at = _read_varint(data, at, end)
        elif kind in _FIXED:
            size = _FIXED[kind]
        else:
            raise ValueError(f"wire type {kind}")
        if number == 0 or at + size > end:
            raise ValueError("record runs over its end")
        yield number, kind, at, at + size
        at += size


def _read_varint(data: bytes, at: int, end: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 70, 7):
        if at >= end:
            raise ValueError("varint runs over its end")
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
    raise ValueError("varint too long")
