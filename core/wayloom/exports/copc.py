"""COPC 1.0: a LAZ 1.4 file whose points lie in the nodes of an octree, each node one chunk, with an index of the nodes.

The octree is cut twice. Points are first spilled to disk by the cells of a coarse level; then, depth first, each cell becomes a
subtree, and each node above takes from its children those points that are first in a cell of its own grid. So no more than the
points of one coarse cell and eight nodes a level are in memory, whatever the map holds. Every point is in one node only.
"""

import struct
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Final

import laspy
import lazrs
import numpy as np
from numpy.typing import NDArray

from wayloom.exports.las import POINT_FORMAT, SCALE_M, Projection, las_header, las_records
from wayloom.exports.points import PointBatch
from wayloom.files.atomic import UNFINISHED, replacing

IntArray = NDArray[np.int64]
Records = NDArray[np.void]
NodeKey = tuple[int, int, int, int]
"""Level, x, y, z."""
GRID: Final = 128
"""Cells along a node's edge, of which each gives at most one point; the spacing is the edge over it."""
NODE_POINTS: Final = 60_000
"""A node of fewer is a leaf."""
SPLIT_TOGETHER: Final = 500_000
"""Records in memory when they are moved to the files of their cells."""
SPILL_UNITS: Final = 64_000
"""Most of the edge of these cells, in stored units: that of a region."""
DEEPEST: Final = 20
INFO: Final = struct.Struct("<5d2Q2d11Q")
ENTRY: Final = struct.Struct("<4iQ2i")
EVLR: Final = struct.Struct("<H16sHQ32s")
HIERARCHY_RECORD: Final = 1000


def write_copc(path: Path, batches: Iterable[PointBatch], projection: Projection, provenance: Mapping[str, Any]) -> int:
    """Write the points as COPC (`las.las_records`); how many there are.

    Raises InputError where the geoid does not reach, OSError.
    """
    header = las_header(projection, provenance)
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=UNFINISHED, dir=path.parent) as folder:
        spill = Spill(Path(folder), header.point_format.dtype())
        for batch in batches:
            spill.add(np.asarray(las_records(batch, projection, header).array))
        with replacing(path) as stream:
            Octree(stream, header, spill).write()
    return spill.count


class Spill:
    """Records in a file of a folder, then in one file for each cell of the cube around them.

    count of records; low, high (3,) of their coordinates; gps_s: the first and last of their times
    """

    def __init__(self, folder: Path, dtype: np.dtype[np.void]) -> None:
        self._folder, self._dtype = folder, dtype
        self.count, self.gps_s = 0, (np.inf, -np.inf)
        self.low, self.high = np.full(3, 2**31, np.int64), np.full(3, -(2**31), np.int64)

    def add(self, records: Records) -> None:
        """Append them."""
        if not len(records):
            return
        with (self._folder / "all").open("ab") as stream:
            stream.write(records.tobytes())
        at, gps_s = coordinates(records), records["gps_time"]
        self.count += len(records)
        self.low, self.high = np.minimum(self.low, at.min(axis=0)), np.maximum(self.high, at.max(axis=0))
        self.gps_s = (min(self.gps_s[0], float(gps_s.min())), max(self.gps_s[1], float(gps_s.max())))

    def split(self, cube: "Cube", level: int) -> set[NodeKey]:
        """Move them to files by the nodes of a level; which nodes have any."""
        found: set[NodeKey] = set()
        if not self.count:
            return found
        with (self._folder / "all").open("rb") as stream:
            while len(records := np.fromfile(stream, self._dtype, SPLIT_TOGETHER)):
                nodes, group = np.unique(cube.cells(records, level), axis=0, return_inverse=True)
                order = np.argsort(group.ravel(), kind="stable")
                ends = np.cumsum(np.bincount(group.ravel(), minlength=len(nodes)))
                for node, rows in zip(nodes.tolist(), np.split(order, ends[:-1]), strict=True):
                    key = (level, *node)
                    found.add(key)
                    with self._file(key).open("ab") as part:
                        part.write(records[rows].tobytes())
        (self._folder / "all").unlink()
        return found

    def read(self, key: NodeKey) -> Records:
        """The records of a node, in the order in which they came."""
        return np.fromfile(self._file(key), self._dtype)

    def _file(self, key: NodeKey) -> Path:
        return self._folder / "_".join(map(str, key))


def coordinates(records: Records) -> IntArray:
    """(N, 3) as they are stored."""
    return np.column_stack([records[name] for name in "XYZ"]).astype(np.int64)


@dataclass(frozen=True, slots=True)
class Cube:
    """The root node, in stored coordinates: from `low` (3,), the least of the points', since there are readers that go by the
    header's box."""

    low: IntArray
    edge: int

    def cells(self, records: Records, level: int, parts: int = 1) -> IntArray:
        """(N, 3) cells, `parts` along the edge of each node of a level; a point on the far side is in the last one."""
        count = parts << level
        return np.asarray(np.minimum((coordinates(records) - self.low) * count // self.edge, count - 1), np.int64)


class Octree:
    """Writer of the file: chunks of nodes as they are finished, then their index, then the header with what is known by then."""

    def __init__(self, stream: IO[bytes], header: laspy.LasHeader, spill: Spill) -> None:
        self._stream, self._header, self._spill = stream, header, spill
        low, high = (spill.low, spill.high) if spill.count else (np.zeros(3, np.int64), np.zeros(3, np.int64))
        self._cube = Cube(low, max(int((high - low).max()), 1))
        self._high = high
        self._depth = max((self._cube.edge // SPILL_UNITS).bit_length(), 0)
        cells = spill.split(self._cube, self._depth)
        self._occupied = {(level - up, x >> up, y >> up, z >> up) for level, x, y, z in cells for up in range(level + 1)}
        self._entries: list[tuple[NodeKey, int, int, int]] = []

    def write(self) -> None:
        """All of the file."""
        vlr = lazrs.LazVlr.new_for_compression(POINT_FORMAT, self._header.point_format.num_extra_bytes, True)
        info = laspy.VLR("copc", 1, "COPC info", bytes(INFO.size))
        self._header.vlrs.insert(0, info)
        self._header.vlrs.append(laspy.vlrs.known.LasZipVlr(vlr.record_data()))
        self._header.set_compressed(True)
        self._header.write_to(self._stream)
        self._compressor = lazrs.LasZipCompressor(self._stream, vlr)
        self._compressor.reserve_offset_to_chunk_table()
        root = (0, 0, 0, 0)
        self._put(root, self._node(root) if root in self._occupied else np.zeros(0, self._header.point_format.dtype()))
        self._compressor.done()
        self._stream.seek(0, 2)
        start, entries = self._stream.tell(), b"".join(ENTRY.pack(*key, *place) for key, *place in sorted(self._entries))
        self._stream.write(EVLR.pack(0, b"copc", HIERARCHY_RECORD, len(entries), b"hierarchy") + entries)
        info.record_data = self._info(start + EVLR.size, len(entries))
        self._finish_header(start)
        self._stream.seek(0)
        self._header.write_to(self._stream, ensure_same_size=True)
        self._stream.seek(0, 2)

    def _finish_header(self, evlr_start: int) -> None:
        header, spill = self._header, self._spill
        header.start_of_first_evlr, header.number_of_evlrs = evlr_start, 1
        header.point_count = spill.count
        header.number_of_points_by_return[0] = spill.count
        header.mins = self._cube.low * header.scales + header.offsets
        header.maxs = self._high * header.scales + header.offsets

    def _info(self, hierarchy_start: int, hierarchy_bytes: int) -> bytes:
        half = 0.5 * self._cube.edge * SCALE_M
        centre = self._cube.low * SCALE_M + self._header.offsets + half
        gps_s = self._spill.gps_s if self._spill.count else (0.0, 0.0)
        return INFO.pack(*centre, half, 2.0 * half / GRID, hierarchy_start, hierarchy_bytes, *gps_s, *[0] * 11)

    def _node(self, key: NodeKey) -> Records:
        """The points of a node, whose children are written."""
        if key[0] == self._depth:
            return self._subtree(key, self._spill.read(key))
        own = []
        for child in children(key):
            if child in self._occupied:
                records = self._node(child)
                chosen = self._first_in_grid(key, records)
                own.append(records[chosen])
                self._put(child, records[~chosen])
        return np.concatenate(own)

    def _subtree(self, key: NodeKey, records: Records) -> Records:
        """The same of a node whose points are all in memory."""
        if len(records) <= NODE_POINTS or key[0] >= self._depth + DEEPEST:
            return records
        chosen = self._first_in_grid(key, records)
        rest = records[~chosen]
        at = self._cube.cells(rest, key[0] + 1)
        for child in children(key):
            inside = (at == np.array(child[1:])).all(axis=1)
            if inside.any():
                self._put(child, self._subtree(child, rest[inside]))
        return records[chosen]

    def _first_in_grid(self, key: NodeKey, records: Records) -> NDArray[np.bool_]:
        """(N,) the first records in each cell of a node's grid."""
        cells = self._cube.cells(records, key[0], GRID) % GRID
        _, first = np.unique(cells @ np.array([1, GRID, GRID**2]), return_index=True)
        chosen = np.zeros(len(records), np.bool_)
        chosen[first] = True
        return chosen

    def _put(self, key: NodeKey, records: Records) -> None:
        """Write a node's chunk."""
        if not len(records):
            self._entries.append((key, 0, 0, 0))
            return
        start = self._stream.tell()
        self._compressor.compress_many(np.frombuffer(records.tobytes(), np.uint8))
        self._compressor.finish_current_chunk()
        self._entries.append((key, start, self._stream.tell() - start, len(records)))


def children(key: NodeKey) -> Iterator[NodeKey]:
    """The eight nodes of the next level in it."""
    level, x, y, z = key
    for step in range(8):
        yield level + 1, 2 * x + (step & 1), 2 * y + (step >> 1 & 1), 2 * z + (step >> 2)
