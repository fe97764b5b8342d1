"""Contents of an MCAP file without an index, read from its beginning as far as it is whole.

A recorder that lost its power leaves a file without summary, cut somewhere. Its whole chunks, the whole records of a last
uncompressed chunk, and messages that stand outside of any chunk are read.
"""

import os
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

from mcap.records import Channel, Schema

MAGIC: Final = b"\x89MCAP0\r\n"
HEADER, SCHEMA, CHANNEL, MESSAGE, CHUNK, DATA_END = 0x01, 0x03, 0x04, 0x05, 0x06, 0x0F
PRIVATE: Final = 0x80
"""First opcode of records that applications add for themselves: readers pass over them."""
RECORD_HEAD: Final = 9
CHUNK_HEAD: Final = 8 + 8 + 8 + 4
MOST_BYTES: Final = 16 << 20
"""Of a schema or a channel."""
Place = tuple[int, int, str, int]
"""Offset and length of a chunk's records in the file, their compression, and their check sum (0: none)."""


@dataclass(slots=True)
class Scan:
    """What was found: schemas and channels by number, places of record areas, and after how many of the file's bytes it ended."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    places: list[Place] = field(default_factory=list)
    unpacked_sizes: list[int] = field(default_factory=list)
    whole_bytes: int = 0
    is_closed: bool = False


def scan_file(handle: int, unpack: Callable[[Place, int], bytes | None]) -> Scan:
    """Walk the records of an open file. unpack(place, size): a compressed chunk's records, None where it is damaged."""
    size, out = os.fstat(handle).st_size, Scan()
    at, bare_from = len(MAGIC), None
    while at + RECORD_HEAD <= size:
        opcode, length = struct.unpack("<BQ", os.pread(handle, RECORD_HEAD, at))
        start, end = at + RECORD_HEAD, at + RECORD_HEAD + length
        if opcode == 0 or DATA_END < opcode < PRIVATE or (opcode == HEADER and at > len(MAGIC)):
            break
        if opcode == CHUNK:
            if not _take_chunk(handle, out, start, min(end, size), end > size, unpack):
                break
        elif end > size:
            break
        elif opcode in (SCHEMA, CHANNEL) and length <= MOST_BYTES:
            _take_description(out, opcode, os.pread(handle, length, start))
        elif opcode == MESSAGE and bare_from is None:
            bare_from = at
        if opcode == DATA_END:
            out.is_closed, at = True, end
            break
        at = min(end, size)
    if bare_from is not None:
        out.places.append((bare_from, at - bare_from, "", 0))
        out.unpacked_sizes.append(at - bare_from)
    out.whole_bytes = at
    return out


def _take_chunk(handle: int, out: Scan, start: int, end: int, is_cut: bool, unpack: Callable[[Place, int], bytes | None]) -> bool:
    """Add a chunk, in part where it is cut and not compressed. Whether the walk can go on after it."""
    head = os.pread(handle, min(CHUNK_HEAD + 4 + 64, end - start), start)
    if len(head) < CHUNK_HEAD + 4:
        return False
    _, _, unpacked, crc, name_length = struct.unpack_from("<QQQII", head)
    if name_length > 16 or len(head) < CHUNK_HEAD + 4 + name_length + 8:
        return False
    compression = head[CHUNK_HEAD + 4 : CHUNK_HEAD + 4 + name_length].decode("ascii", "replace")
    (length,) = struct.unpack_from("<Q", head, CHUNK_HEAD + 4 + name_length)
    begin = start + CHUNK_HEAD + 4 + name_length + 8
    if compression not in ("", "lz4", "zstd") or (compression and begin + length > end):
        return False
    if compression:
        records = unpack((begin, length, compression, crc), unpacked)
        if records is None:
            return False
        whole = _describe(out, lambda at, count: records[at : at + count], len(records))
        place: Place = (begin, length, compression, crc)
    else:
        size = min(length, end - begin)
        whole = _describe(out, lambda at, count: os.pread(handle, min(count, size - at), begin + at), size)
        place = (begin, whole, "", crc if whole == length else 0)
    out.places.append(place)
    out.unpacked_sizes.append(unpacked if compression else whole)
    return not is_cut


def _describe(out: Scan, read: Callable[[int, int], bytes], size: int) -> int:
    """Take schemas and channels of a chunk's records; how many of its bytes are whole records."""
    at = 0
    while at + RECORD_HEAD <= size:
        opcode, length = struct.unpack("<BQ", read(at, RECORD_HEAD))
        if at + RECORD_HEAD + length > size:
            break
        if opcode in (SCHEMA, CHANNEL) and length <= MOST_BYTES:
            _take_description(out, opcode, read(at + RECORD_HEAD, length))
        at += RECORD_HEAD + length
    return at


def _take_description(out: Scan, opcode: int, data: bytes) -> None:
    """A schema or a channel; what is none is passed over, and its messages with it."""
    try:
        if opcode == SCHEMA:
            (number,) = struct.unpack_from("<H", data)
            name, at = _text(data, 2)
            encoding, at = _text(data, at)
            (length,) = struct.unpack_from("<I", data, at)
            out.schemas[number] = Schema(id=number, data=data[at + 4 : at + 4 + length], encoding=encoding, name=name)
        else:
            number, schema = struct.unpack_from("<HH", data)
            topic, at = _text(data, 4)
            encoding, _ = _text(data, at)
            out.channels[number] = Channel(id=number, topic=topic, message_encoding=encoding, metadata={}, schema_id=schema)
    except (struct.error, UnicodeDecodeError):
        return


def _text(data: bytes, at: int) -> tuple[str, int]:
    (length,) = struct.unpack_from("<I", data, at)
    return data[at + 4 : at + 4 + length].decode(), at + 4 + length
