"""Levels of detail: voxel counts by class for each pixel of a zoom; coarser pixels are sums of four, so no count is lost."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_COUNT
from wayloom.errors import InputError
from wayloom.files.blob import decode_blob, encode_blob
from wayloom.tiles.grid import TILE_PX, TileAddress, pixel_from_lonlat

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
CODE_BITS, COLUMN_BITS = 5, 29
MAGIC: Final = b"WLCOUNTS"
VERSION: Final = 1
DTYPES: Final = {"cell": "<i8", "count": "<i8"}
OCCUPIED = 31
"""The code beside the 19 classes: how many pixels of the finest level below a pixel hold anything."""


@dataclass(frozen=True, slots=True)
class Level:
    """Sparse image of voxel counts at one zoom, sorted by row, column, code.

    zoom    the zoom whose pixels these are (256 a tile edge)
    cell    (R,) row, column and class (or OCCUPIED) in one whole number
    count   (R,) how many
    """

    zoom: int
    cell: IntArray
    count: IntArray

    @staticmethod
    def empty(zoom: int) -> "Level":
        """One that counts nothing."""
        return Level(zoom, np.zeros(0, np.int64), np.zeros(0, np.int64))

    @property
    def row(self) -> IntArray:
        """(R,) from the north."""
        return self.cell >> (COLUMN_BITS + CODE_BITS)

    @property
    def column(self) -> IntArray:
        """(R,) from the west."""
        return (self.cell >> CODE_BITS) & ((1 << COLUMN_BITS) - 1)

    @property
    def code(self) -> IntArray:
        """(R,) class or OCCUPIED."""
        return self.cell & ((1 << CODE_BITS) - 1)

    def class_counts(self) -> IntArray:
        """(19,) sum over all pixels: the same at every zoom."""
        classes = self.code < CLASS_COUNT
        return np.bincount(self.code[classes], self.count[classes], CLASS_COUNT).astype(np.int64)

    def blocks(self, size: int) -> Iterator[tuple[int, int, "Level"]]:
        """(block column, block row, its part) for every block of size x size pixels that holds anything, in order."""
        block = (self.row // size << COLUMN_BITS) | (self.column // size)
        order = np.argsort(block, kind="stable")
        edges = np.flatnonzero(np.diff(block[order])) + 1
        for rows in np.split(order, edges) if len(order) else []:
            y, x = divmod(int(block[rows[0]]), 1 << COLUMN_BITS)
            yield x, y, Level(self.zoom, self.cell[rows], self.count[rows])

    def tiles(self) -> Iterator[tuple[TileAddress, "Level"]]:
        """The parts of this level by tile of its own zoom."""
        for x, y, part in self.blocks(TILE_PX):
            yield TileAddress(self.zoom, x, y), part


def _summed(zoom: int, cell: IntArray, count: IntArray) -> Level:
    keys, inverse = np.unique(cell, return_inverse=True)
    total = np.zeros(len(keys), np.int64)
    np.add.at(total, inverse, count)
    return Level(zoom, keys, total)


def add_levels(zoom: int, parts: Iterable[Level]) -> Level:
    """The sum of levels of one zoom."""
    held = [Level.empty(zoom), *parts]
    return _summed(zoom, np.concatenate([part.cell for part in held]), np.concatenate([part.count for part in held]))


def joined(parts: Iterable[Level]) -> Level | None:
    """The sum of levels of one zoom; None without any."""
    held = list(parts)
    return add_levels(held[0].zoom, held) if held else None


def encode_level(level: Level) -> bytes:
    """The level's bytes: equal counts give equal bytes."""
    return encode_blob(MAGIC, VERSION, {"zoom": level.zoom}, {"cell": level.cell, "count": level.count})


def decode_level(data: bytes, name: str = "counts") -> Level:
    """The inverse of `encode_level`. Raises InputError for bytes that are none."""
    try:
        header, arrays = decode_blob(data, MAGIC, VERSION, DTYPES)
        return Level(int(header["zoom"]), **arrays)
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"is no tile of counts or is damaged ({error})", file=name, remedy="have the map stitched anew") from error


def _packed(row: IntArray, column: IntArray, code: IntArray) -> IntArray:
    return (row << (COLUMN_BITS + CODE_BITS)) | (column << CODE_BITS) | code


def finest_level(lon_lat: FloatArray, label: NDArray[np.uint8], zoom: int) -> Level:
    """One count for each voxel at lon_lat (V, 2) degrees with class label (V,), and one occupied for each pixel that has any."""
    column, row = pixel_from_lonlat(lon_lat, zoom).T
    voxels = _packed(row, column, label.astype(np.int64))
    occupied = np.unique(voxels >> CODE_BITS << CODE_BITS | OCCUPIED)
    return _summed(zoom, np.concatenate([voxels, occupied]), np.ones(len(voxels) + len(occupied), np.int64))


def coarser(level: Level) -> Level:
    """The level one zoom below, summed from this one."""
    return _summed(level.zoom - 1, _packed(level.row >> 1, level.column >> 1, level.code), level.count)


def dilated(level: Level) -> Level:
    """For display only: every count again, fainter, in the eight pixels around its own, so that a voxel is three pixels wide."""
    edge = (TILE_PX << level.zoom) - 1
    cells, counts = [level.cell], [level.count * 16]
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            if dx or dy:
                row, column = np.clip(level.row + dy, 0, edge), (level.column + dx) & edge
                cells.append(_packed(row, column, level.code))
                counts.append(level.count)
    return _summed(level.zoom, np.concatenate(cells), np.concatenate(counts))
