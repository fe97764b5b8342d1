"""Vector tiles (Mapbox Vector Tile 2.1): cells with their counts by class, and the tracks of the drives."""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_COUNT, CLASS_NAMES
from wayloom.tiles import protobuf
from wayloom.tiles.grid import TileAddress, unit_from_lonlat
from wayloom.tiles.levels import Level

FloatArray = NDArray[np.float64]
EXTENT = 4096
BUFFER = 64
"""How far a line goes on beyond the tile's edge, so that its caps are not seen, in units of the extent."""
CELLS_LAYER, TRACKS_LAYER = "semantic", "coverage"


@dataclass(frozen=True, slots=True)
class LonLatTrack:
    """One unbroken piece of a drive: its id and lon_lat (K, 2) degrees."""

    drive_id: str
    lon_lat: FloatArray


def count_property(label: int) -> str:
    """The property of a cell that holds how many voxels of this class it has."""
    return "n_" + CLASS_NAMES[label].replace(" ", "_")


def encode_mvt(cells: Level | None, cells_per_edge: int, lines: Sequence[tuple[str, list[tuple[int, int]]]]) -> bytes:
    """The bytes of one tile.

    cells : the counts whose pixels are this tile's cells, cells_per_edge of them along each edge
    lines : (drive id, points in tile units, y down), clipped already
    """
    out = b""
    if cells is not None:
        out += protobuf.layer(CELLS_LAYER, EXTENT, protobuf.POLYGON, _cell_features(cells, cells_per_edge))
    if lines:
        features = [(protobuf.line(line), {"drive": drive}) for drive, line in lines]
        out += protobuf.layer(TRACKS_LAYER, EXTENT, protobuf.LINE, features)
    return out


def _cell_features(cells: Level, cells_per_edge: int) -> Iterator[tuple[bytes, dict[str, protobuf.Value]]]:
    """Outline and properties of each cell, in the order of rows."""
    size = EXTENT // cells_per_edge
    classes = np.flatnonzero(cells.code < CLASS_COUNT)
    row, column = cells.row[classes] % cells_per_edge, cells.column[classes] % cells_per_edge
    codes, counts = cells.code[classes].tolist(), cells.count[classes].tolist()
    edges = np.flatnonzero(np.diff(row * cells_per_edge + column)) + 1
    starts = [0, *edges.tolist(), len(codes)] if codes else []
    rows, columns = row.tolist(), column.tolist()
    for start, stop in itertools.pairwise(starts):
        counted = dict(zip(codes[start:stop], counts[start:stop], strict=True))
        top = max(counted, key=lambda label: (counted[label], -label))
        properties: dict[str, protobuf.Value] = {"class": CLASS_NAMES[top], "label": top, "count": sum(counted.values())}
        properties |= {count_property(label): count for label, count in counted.items()}
        yield protobuf.square(columns[start] * size, rows[start] * size, size), properties


def tiles_of_track(track: LonLatTrack, zoom: int) -> dict[TileAddress, list[list[tuple[int, int]]]]:
    """The track clipped to every tile that it touches: lines in tile units. A step over the antimeridian is not drawn."""
    world = 1 << zoom
    points = unit_from_lonlat(track.lon_lat) * world
    out: dict[TileAddress, list[list[tuple[int, int]]]] = {}
    margin = BUFFER / EXTENT
    for a, b in itertools.pairwise(points):
        if abs(b[0] - a[0]) > world / 2:
            continue
        low, high = np.floor(np.minimum(a, b) - margin).astype(int), np.floor(np.maximum(a, b) + margin).astype(int)
        for y in range(max(low[1], 0), min(high[1], world - 1) + 1):
            for x in range(max(low[0], 0), min(high[0], world - 1) + 1):
                piece = clip((a - (x, y)) * EXTENT, (b - (x, y)) * EXTENT, -BUFFER, EXTENT + BUFFER)
                if piece is not None:
                    _join(out.setdefault(TileAddress(zoom, x, y), []), *piece)
    return {tile: lines for tile, lines in out.items() if lines}


def clip(a: FloatArray, b: FloatArray, low: float, high: float) -> tuple[FloatArray, FloatArray] | None:
    """The part of the line from a to b, (2,) each, in the square from low to high, or None (Liang and Barsky 1984)."""
    step = b - a
    enter, leave = 0.0, 1.0
    for axis in (0, 1):
        for direction, distance in ((-step[axis], a[axis] - low), (step[axis], high - a[axis])):
            if direction == 0.0:
                if distance < 0.0:
                    return None
            elif direction < 0.0:
                enter = max(enter, distance / direction)
            else:
                leave = min(leave, distance / direction)
    return None if enter > leave else (a + enter * step, a + leave * step)


def _join(lines: list[list[tuple[int, int]]], a: FloatArray, b: FloatArray) -> None:
    """Go on with the last line where it ended, or begin a new one."""
    first, second = _rounded(a), _rounded(b)
    if first == second:
        return
    if lines and lines[-1][-1] == first:
        lines[-1].append(second)
    else:
        lines.append([first, second])


def _rounded(point: FloatArray) -> tuple[int, int]:
    return round(float(point[0])), round(float(point[1]))
