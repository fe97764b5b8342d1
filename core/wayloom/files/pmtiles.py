"""PMTiles version 3: map tiles in one file, clustered, each content once, with a directory that is read by ranges.

Tiles come in any order, in parts that are joined, and wait in a temporary file; the archive is written in the order of tile ids,
which follow a Hilbert curve zoom by zoom. Equal tiles give equal bytes.
"""

import gzip
import hashlib
import json
import struct
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Final

from wayloom.files.atomic import replacing

HEADER: Final = struct.Struct("<7sB11Q6B4iB2i")
ROOT_BYTES: Final = 16_384 - HEADER.size
LEAF_ENTRIES: Final = 4096
NO_COMPRESSION, GZIP = 1, 2
TILE_TYPES: Final = {"application/vnd.mapbox-vector-tile": 1, "image/png": 2, "image/jpeg": 3, "image/webp": 4}
E7: Final = 10_000_000
Address = tuple[int, int, int]
"""Zoom, column from the west, row from the north."""


@dataclass(frozen=True, slots=True)
class Entry:
    """A run of tiles of one content: first id, where it is, how many tiles; a run of 0 is a leaf directory."""

    tile_id: int
    offset: int
    length: int
    run: int


def tile_id(z: int, x: int, y: int) -> int:
    """Number of a tile: those of coarser zooms, then its place on the Hilbert curve of its own."""
    number = 0
    for level in reversed(range(z)):
        side = 1 << level
        right, low = int(bool(x & side)), int(bool(y & side))
        number += side * side * ((3 * right) ^ low)
        if not low:
            if right:
                x, y = side - 1 - (x & (side - 1)), side - 1 - (y & (side - 1))
            x, y = y & (side - 1), x & (side - 1)
    return number + ((1 << (2 * z)) - 1) // 3


def write_pmtiles(
    path: Path,
    tiles: Iterable[tuple[Address, bytes]],
    media_type: str,
    bounds: tuple[float, float, float, float],
    metadata: Callable[[int, int], Mapping[str, Any]],
) -> int:
    """Write tiles as PMTiles; how many there are. Parts of one address are joined in the order in which they come.

    bounds   : west, south, east, north in degrees
    metadata : of the least and greatest zoom
    """
    with tempfile.TemporaryFile(dir=_folder(path)) as spool:
        parts: dict[Address, list[tuple[int, int]]] = {}
        for address, data in tiles:
            parts.setdefault(address, []).append((spool.tell(), len(data)))
            spool.write(data)
        zooms = [address[0] for address in parts] or [0]
        about = json.dumps(metadata(min(zooms), max(zooms))).encode()
        vector = TILE_TYPES[media_type] == 1
        with tempfile.TemporaryFile(dir=_folder(path)) as contents, replacing(path) as out:
            entries, count = _gather(parts, spool, contents, vector)
            root, leaves = _directories(entries)
            about = gzip.compress(about, mtime=0)
            root_at, about_at = HEADER.size, HEADER.size + len(root)
            leaves_at = about_at + len(about)
            data_at, data_bytes = leaves_at + len(leaves), contents.tell()
            west, south, east, north = (round(value * E7) for value in bounds)
            out.write(HEADER.pack(
                b"PMTiles", 3, root_at, len(root), about_at, len(about), leaves_at, len(leaves), data_at, data_bytes,
                len(parts), len(entries), count, 1, GZIP, GZIP if vector else NO_COMPRESSION, TILE_TYPES[media_type],
                min(zooms), max(zooms), west, south, east, north, min(zooms), (west + east) // 2, (south + north) // 2,
            ))  # fmt: skip
            out.write(root + about + leaves)
            contents.seek(0)
            while block := contents.read(1 << 20):
                out.write(block)
    return len(parts)


def _folder(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    return path.parent


def _gather(
    parts: Mapping[Address, Sequence[tuple[int, int]]], spool: IO[bytes], contents: IO[bytes], compress: bool
) -> tuple[list[Entry], int]:
    """The entries of all tiles, whose contents are written, each once, in the order of ids; how many contents."""
    held: dict[bytes, tuple[int, int]] = {}
    entries: list[Entry] = []
    for number, address in sorted((tile_id(*address), address) for address in parts):
        data = b"".join(_read(spool, *place) for place in parts[address])
        digest = hashlib.sha256(data).digest()
        if digest not in held:
            data = gzip.compress(data, mtime=0) if compress else data
            held[digest] = contents.tell(), len(data)
            contents.write(data)
        offset, length = held[digest]
        last = entries[-1] if entries else None
        if last is not None and last.offset == offset and last.tile_id + last.run == number:
            entries[-1] = Entry(last.tile_id, offset, length, last.run + 1)
        else:
            entries.append(Entry(number, offset, length, 1))
    return entries, len(held)


def _read(spool: IO[bytes], offset: int, length: int) -> bytes:
    spool.seek(offset)
    return spool.read(length)


def _directories(entries: Sequence[Entry]) -> tuple[bytes, bytes]:
    """The root directory, and the leaves: none where all entries fit into the root."""
    root = _directory(entries)
    if len(root) <= ROOT_BYTES:
        return root, b""
    size = LEAF_ENTRIES
    while True:
        leaves, pointers = b"", []
        for start in range(0, len(entries), size):
            leaf = _directory(entries[start : start + size])
            pointers.append(Entry(entries[start].tile_id, len(leaves), len(leaf), 0))
            leaves += leaf
        root = _directory(pointers)
        if len(root) <= ROOT_BYTES:
            return root, leaves
        size *= 2


def _directory(entries: Sequence[Entry]) -> bytes:
    """Packed column by column: steps of ids, runs, lengths, and offsets, 0 for one that follows the content before."""
    numbers = [len(entries)]
    numbers += [entry.tile_id - before for before, entry in zip([0, *(e.tile_id for e in entries)], entries, strict=False)]
    numbers += [entry.run for entry in entries]
    numbers += [entry.length for entry in entries]
    following = 0
    for row, entry in enumerate(entries):
        numbers.append(0 if row and entry.offset == following else entry.offset + 1)
        following = entry.offset + entry.length
    return gzip.compress(b"".join(map(_varint, numbers)), mtime=0)


def _varint(value: int) -> bytes:
    out = bytearray()
    while value > 127:
        out.append(value & 127 | 128)
        value >>= 7
    out.append(value)
    return bytes(out)
