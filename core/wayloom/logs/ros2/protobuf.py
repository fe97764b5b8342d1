"""Protocol Buffers' wire format, as far as MCAP's self-describing messages need it: fields by number, and numbers by name."""

import struct
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.logs.ros2.cdr import CdrError

VARINT, FIXED64, BYTES, FIXED32 = 0, 1, 2, 5
Value = int | memoryview
Fields = dict[int, list[Value]]
MOST_FIELDS: Final = 100_000


def fields(data: bytes | memoryview) -> Fields:
    """The values of a message by field number: whole numbers, or bytes that are not copied. Raises CdrError where it is cut."""
    view, out, at, count = memoryview(data), Fields(), 0, 0
    while at < len(view):
        key, at = _varint(view, at)
        number, kind = key >> 3, key & 7
        if kind == VARINT:
            value: Value
            value, at = _varint(view, at)
        elif kind in (FIXED64, FIXED32, BYTES):
            length, at = _varint(view, at) if kind == BYTES else (8 if kind == FIXED64 else 4, at)
            value, at = view[at : at + length], at + length
        else:
            raise CdrError(f"has a field of wire type {kind}")
        count += 1
        if at > len(view) or count > MOST_FIELDS:
            raise CdrError(f"ends after {len(view)} bytes" if at > len(view) else f"has more than {MOST_FIELDS} fields")
        out.setdefault(number, []).append(value)
    return out


def field_numbers(descriptors: bytes, message: str) -> dict[str, int]:
    """The numbers of a message's fields by name, from a FileDescriptorSet. Raises CdrError where it is not there."""
    package, _, name = message.rpartition(".")
    for file in fields(descriptors).get(1, []):
        content = fields(_bytes(file))
        if _text(content, 2) != package:
            continue
        for described in content.get(4, []):
            parts = fields(_bytes(described))
            if _text(parts, 1) == name:
                members = [fields(_bytes(member)) for member in parts.get(2, [])]
                return {_text(member, 1): int(member[3][-1]) for member in members if isinstance(member.get(3, [None])[-1], int)}
    raise CdrError(f"is described by a schema without {message}")


def doubles(values: list[Value]) -> NDArray[np.float64]:
    """A repeated double, packed or not."""
    packed = b"".join(bytes(_bytes(value)) for value in values)
    if len(packed) % 8:
        raise CdrError(f"has {len(packed)} bytes of doubles")
    return np.frombuffer(packed, "<f8").astype(np.float64)


def whole(value: Value) -> int:
    """A varint or a fixed32."""
    if isinstance(value, int):
        return value
    if len(value) != 4:
        raise CdrError("has no whole number where one belongs")
    return int(struct.unpack("<I", value)[0])


def _text(content: Fields, number: int) -> str:
    return bytes(_bytes(content[number][-1])).decode("utf-8", "replace") if number in content else ""


def _bytes(value: Value) -> memoryview:
    if isinstance(value, int):
        raise CdrError("has a number where bytes belong")
    return value


def _varint(view: memoryview, at: int) -> tuple[int, int]:
    out, shift = 0, 0
    while True:
        if at >= len(view) or shift > 63:
            raise CdrError(f"ends after {len(view)} bytes")
        byte = view[at]
        out, at, shift = out | (byte & 0x7F) << shift, at + 1, shift + 7
        if byte < 0x80:
            return out, at
