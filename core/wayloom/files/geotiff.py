"""Cloud-optimised GeoTIFF: a tiled BigTIFF with overviews, its directories before the data, written tile by tile.

TIFF 6.0, BigTIFF, OGC GeoTIFF 1.1 and the layout of OGC's Cloud Optimized GeoTIFF (directories first, from the full image to the
smallest overview; then the data, the smallest overview first). The tiles are visited in the order of a quadtree, so that no more
than four of a level are in memory, and wait in a temporary file. Equal content is equal bytes on equal processors.
"""

import struct
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Final
from xml.sax.saxutils import escape

import numpy as np
from isal import isal_zlib
from numpy.typing import NDArray

from wayloom.files.atomic import replacing

TILE: Final = 512
DEFLATE, LEVEL = 8, 2
"""LEVEL of ISA-L's deflate: a twentieth of zlib's time at 6, for an eighth to a quarter more bytes (`benchmarks/packing.py`)."""
SHORT, LONG, ASCII, DOUBLE, LONG8 = 3, 4, 2, 12, 16
FORMATS: Final = {SHORT: "H", LONG: "I", DOUBLE: "d", LONG8: "Q"}
USER_DEFINED: Final = 32767
Tile = NDArray[Any]


@dataclass(frozen=True, slots=True)
class GeoGrid:
    """Pixels of a raster on Earth: north is up, pixel (0, 0) has its upper left corner at west, north (m, of the coordinate system
    with this EPSG code, or of a local one where it is None)."""

    west: float
    north: float
    pixel_m: float
    width: int
    height: int
    epsg: int | None

    @property
    def levels(self) -> int:
        """Of the pyramid, until one tile holds all."""
        return max(0, int(np.ceil(np.log2(max(self.width, self.height, 1) / TILE)))) + 1

    def tiles(self, level: int) -> tuple[int, int]:
        """Columns and rows of tiles of a level."""
        width, height = self.size(level)
        return -(-width // TILE), -(-height // TILE)

    def size(self, level: int) -> tuple[int, int]:
        """Width and height of a level, px."""
        return -(-self.width >> level) or 1, -(-self.height >> level) or 1


class _Spool:
    """Compressed tiles of all levels in a temporary file: where each lies, by (level, row, column)."""

    def __init__(self, file: IO[bytes]) -> None:
        self.file, self.place = file, dict[tuple[int, int, int], tuple[int, int]]()

    def add(self, at: tuple[int, int, int], tile: Tile) -> None:
        data = isal_zlib.compress(_predicted(tile), LEVEL)
        self.place[at] = (self.file.tell(), len(data))
        self.file.write(data)

    def read(self, at: tuple[int, int, int]) -> bytes:
        offset, length = self.place[at]
        self.file.seek(offset)
        return self.file.read(length)


def write_cog(
    path: Path,
    grid: GeoGrid,
    tile_at: Callable[[int, int], Tile | None],
    empty: Tile,
    halve: Callable[[Tile], Tile],
    provenance: str = "",
) -> None:
    """Write a raster whose tiles (TILE, TILE[, C]) uint8 or float32 `tile_at(row, column)` gives; None where all is `empty`.

    halve : of an array (2 TILE, 2 TILE[, C]) the one of half its size
    provenance : text that GDAL shows among the metadata
    """
    with tempfile.TemporaryFile() as file:
        spool = _Spool(file)
        _gather(spool, grid, tile_at, empty, halve, grid.levels - 1, 0, 0)
        nothing = isal_zlib.compress(_predicted(empty), LEVEL)
        with replacing(path) as out:
            _write(out, [_tags(grid, level, empty, provenance) for level in range(grid.levels)], grid, spool, nothing)


def _gather(
    spool: _Spool, grid: GeoGrid, tile_at: Callable[[int, int], Tile | None], empty: Tile, halve: Callable[[Tile], Tile],
    level: int, row: int, column: int,
) -> Tile | None:  # fmt: skip
    """The tile of a level, from those below it, and all of them into the spool; None where nothing is."""
    columns, rows = grid.tiles(level)
    if row >= rows or column >= columns:
        return None
    if level == 0:
        tile = tile_at(row, column)
    else:
        below = [
            _gather(spool, grid, tile_at, empty, halve, level - 1, 2 * row + i, 2 * column + j) for i in (0, 1) for j in (0, 1)
        ]
        if all(one is None for one in below):
            return None
        a, b, c, d = (empty if one is None else one for one in below)
        tile = halve(np.concatenate([np.concatenate([a, b], axis=1), np.concatenate([c, d], axis=1)]))
    if tile is not None:
        spool.add((level, row, column), tile)
    return tile


def _predicted(tile: Tile) -> bytes:
    """Bytes of a tile; those of whole numbers as differences along the rows (TIFF's predictor 2)."""
    if tile.dtype == np.uint8:
        return np.concatenate([tile[:, :1], tile[:, 1:] - tile[:, :-1]], axis=1).tobytes()
    return tile.astype("<f4").tobytes()


def _write(out: IO[bytes], tables: Sequence["Tags"], grid: GeoGrid, spool: _Spool, nothing: bytes) -> None:
    start = 16 + sum(_directory_bytes(table) for table in tables)
    for level in reversed(range(grid.levels)):
        columns, rows = grid.tiles(level)
        cells = [(level, row, column) for row in range(rows) for column in range(columns)]
        vacant, start = start, start + len(nothing)  # one for all tiles that show nothing
        offsets, lengths = [], []
        for at in cells:
            found = at in spool.place
            length = spool.place[at][1] if found else len(nothing)
            offsets.append(start if found else vacant)
            lengths.append(length)
            start += length if found else 0
        tables[level][324] = (LONG8, offsets)
        tables[level][325] = (LONG8, lengths)
    out.write(struct.pack("<2sHHHQ", b"II", 43, 8, 0, 16))
    at_byte = 16
    for level, table in enumerate(tables):
        size = _directory_bytes(table)
        out.write(_directory(table, at_byte, at_byte + size if level + 1 < len(tables) else 0))
        at_byte += size
    for level in reversed(range(grid.levels)):
        columns, rows = grid.tiles(level)
        out.write(nothing)
        for row in range(rows):
            for column in range(columns):
                if (level, row, column) in spool.place:
                    out.write(spool.read((level, row, column)))


Tags = dict[int, tuple[int, Sequence[Any]]]


def _tags(grid: GeoGrid, level: int, empty: Tile, provenance: str) -> Tags:
    """Of one level; the tiles' offsets and lengths still zeros."""
    width, height = grid.size(level)
    count = grid.tiles(level)[0] * grid.tiles(level)[1]
    channels, is_colour = (empty.shape[2] if empty.ndim == 3 else 1), empty.dtype == np.uint8
    tags: Tags = {
        254: (LONG, [int(level > 0)]), 256: (LONG, [width]), 257: (LONG, [height]), 258: (SHORT, [8 * empty.itemsize] * channels),
        259: (SHORT, [DEFLATE]), 262: (SHORT, [2 if channels >= 3 else 1]), 277: (SHORT, [channels]), 284: (SHORT, [1]),
        317: (SHORT, [2 if is_colour else 1]), 322: (LONG, [TILE]), 323: (LONG, [TILE]), 324: (LONG8, [0] * count),
        325: (LONG8, [0] * count), 339: (SHORT, [1 if is_colour else 3] * channels),
    }  # fmt: skip
    if channels == 4:
        tags[338] = (SHORT, [2])
    if not is_colour:
        tags[42113] = (ASCII, b"nan\0")
    if level == 0 and provenance:
        item = f'<GDALMetadata><Item name="provenance">{escape(provenance)}</Item></GDALMetadata>'
        tags[42112] = (ASCII, item.encode() + b"\0")
    if level == 0:
        tags[33550] = (DOUBLE, [grid.pixel_m, grid.pixel_m, 0.0])
        tags[33922] = (DOUBLE, [0.0, 0.0, 0.0, grid.west, grid.north, 0.0])
        tags[34735] = (SHORT, _geo_keys(grid.epsg))
    return tags


def _geo_keys(epsg: int | None) -> list[int]:
    """GeoKeyDirectory: projected coordinates of an EPSG code in metres, or user-defined ones; pixels are areas."""
    keys = (
        [(1024, 1), (1025, 1), (3072, epsg), (3076, 9001)] if epsg is not None else [(1024, USER_DEFINED), (1025, 1), (3076, 9001)]
    )
    return [1, 1, 1, len(keys)] + [value for key, code in keys for value in (key, 0, 1, code)]


def _packed(kind: int, values: Sequence[Any]) -> bytes:
    return bytes(values) if kind == ASCII else struct.pack(f"<{len(values)}{FORMATS[kind]}", *values)


def _directory_bytes(tags: Tags) -> int:
    """Bytes of a directory with the values that do not fit into it, each at a multiple of 8."""
    large = [len(_packed(*entry)) for entry in tags.values()]
    return 8 + 20 * len(tags) + 8 + _padding(8 + 20 * len(tags) + 8) + sum(n + _padding(n) for n in large if n > 8)


def _padding(count: int) -> int:
    return -count % 8


def _directory(tags: Tags, start: int, following: int) -> bytes:
    fixed = 8 + 20 * len(tags) + 8
    head, body = struct.pack("<Q", len(tags)), bytearray()
    for tag, (kind, values) in sorted(tags.items()):
        data = _packed(kind, values)
        head += struct.pack("<HHQ", tag, kind, len(values))
        if len(data) <= 8:
            head += data.ljust(8, b"\0")
        else:
            head += struct.pack("<Q", start + fixed + _padding(fixed) + len(body))
            body += data + bytes(_padding(len(data)))
    return head + struct.pack("<Q", following) + bytes(_padding(fixed)) + bytes(body)
