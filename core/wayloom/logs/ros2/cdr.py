"""CDR, the serialisation of ROS 2 messages (OMG DDS-XTypes, XCDR1): values in order, each aligned to its own size.

Only what the messages of `ros_messages` need. Offsets count from after the encapsulation's four bytes.
"""

import struct
from typing import Final

import numpy as np
from numpy.typing import NDArray

LITTLE, BIG = b"\x00\x01\x00\x00", b"\x00\x00\x00\x00"
SIZES: Final = {"b": 1, "B": 1, "H": 2, "i": 4, "I": 4, "f": 4, "d": 8}
LONGEST_STRING: Final = 65_536


class CdrError(ValueError):
    """The bytes are no message of the kind that was asked for; the caller says which file and record."""


class CdrReader:
    """Takes values off a message, first to last. Raises CdrError where it ends too early."""

    def __init__(self, data: bytes | memoryview) -> None:
        head = bytes(data[:4])
        if head[:2] not in (LITTLE[:2], BIG[:2]):
            raise CdrError(f"begins with {head.hex()}, which is not CDR")
        self._order = "<" if head[1] else ">"
        self._data, self._at = memoryview(data)[4:], 0

    def number(self, kind: str) -> int | float:
        """One value; `kind` is struct's letter."""
        (value,) = struct.unpack_from(self._order + kind, self._data, self._step(SIZES[kind], SIZES[kind]))
        return value  # type: ignore[no-any-return]

    def integer(self, kind: str = "I") -> int:
        """One whole number."""
        return int(self.number(kind))

    def numbers(self, kind: str, count: int) -> NDArray[np.float64]:
        """(count,) values of an array of fixed length."""
        size = SIZES[kind]
        start = self._step(size, size * count)
        return np.frombuffer(self._data, f"{self._order}{'f' if kind in 'fd' else 'i'}{size}", count, start).astype(np.float64)

    def sequence(self, kind: str) -> NDArray[np.float64]:
        """Values behind their number."""
        count = self._count(SIZES[kind])
        return self.numbers(kind, count) if count else np.empty(0)

    def blob(self) -> memoryview:
        """A sequence of bytes, not copied."""
        count = self._count(1)
        start = self._step(1, count)
        return self._data[start : start + count]

    def text(self) -> str:
        """A string, whose length counts its zero."""
        length = self.integer()
        if length > LONGEST_STRING:
            raise CdrError(f"a string of {length} characters")
        start = self._step(1, length)
        return bytes(self._data[start : start + max(length - 1, 0)]).decode("utf-8", "replace")

    def count(self) -> int:
        """The number of elements of a sequence of messages."""
        return self._count(1)

    def _count(self, size: int) -> int:
        count = self.integer()
        if count * size > len(self._data) - self._at:
            raise CdrError(f"says {count} values where {len(self._data) - self._at} bytes are left")
        return count

    def _step(self, alignment: int, size: int) -> int:
        start = self._at + (-self._at) % alignment
        if start + size > len(self._data):
            raise CdrError(f"ends after {len(self._data)} bytes")
        self._at = start + size
        return start


class CdrWriter:
    """Puts values together, little endian."""

    def __init__(self) -> None:
        self._out = bytearray()

    def number(self, kind: str, value: float) -> "CdrWriter":
        """One value; `kind` is struct's letter."""
        self._align(SIZES[kind])
        self._out += struct.pack("<" + kind, value)
        return self

    def numbers(self, values: NDArray[np.float64]) -> "CdrWriter":
        """float64 values of an array of fixed length."""
        self._align(8)
        self._out += np.ascontiguousarray(values, "<f8").tobytes()
        return self

    def sequence(self, values: NDArray[np.float64]) -> "CdrWriter":
        """float64 values behind their number."""
        self.number("I", len(values))
        return self.numbers(values) if len(values) else self

    def blob(self, data: bytes) -> "CdrWriter":
        """Bytes behind their number."""
        self.number("I", len(data))
        self._out += data
        return self

    def text(self, text: str) -> "CdrWriter":
        """A string."""
        return self.blob(text.encode() + b"\x00")

    def message(self) -> bytes:
        """The message's bytes, its encapsulation header first."""
        return LITTLE + bytes(self._out)

    def _align(self, size: int) -> None:
        self._out += bytes(-len(self._out) % size)
