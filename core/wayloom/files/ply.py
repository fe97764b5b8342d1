"""Point clouds as binary little-endian PLY: x y z (double, metres), red green blue label (uchar), or any other vertices."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import LogError
from wayloom.files.atomic import replacing, write_atomically
from wayloom.files.text_files import quoted, read_bytes

POINT = np.dtype([("x", "<f8"), ("y", "<f8"), ("z", "<f8"), ("red", "u1"), ("green", "u1"), ("blue", "u1"), ("label", "u1")])
TYPE_NAMES = {
    "double": "f8", "float64": "f8", "float": "f4", "float32": "f4", "uchar": "u1", "uint8": "u1", "char": "i1", "int8": "i1",
    "ushort": "u2", "uint16": "u2", "short": "i2", "int16": "i2", "uint": "u4", "uint32": "u4", "int": "i4", "int32": "i4",
}  # fmt: skip
NAMES_OF_TYPES = {
    "f8": "double", "f4": "float", "u1": "uchar", "i1": "char", "u2": "ushort", "i2": "short", "u4": "uint", "i4": "int",
}  # fmt: skip
LONGEST_HEADER = 65_536
MOST_VERTICES = 10**18


@dataclass(frozen=True, slots=True)
class Cloud:
    """points (N, 3) float64 m, colours (N, 3) uint8 RGB, labels (N,) uint8 train ids with 255 void."""

    points: NDArray[np.float64]
    colours: NDArray[np.uint8]
    labels: NDArray[np.uint8]


def write_ply(
    file: Path, points: NDArray[np.float64], colours: NDArray[np.uint8], labels: NDArray[np.uint8], comments: tuple[str, ...] = ()
) -> None:
    """points (N, 3) m, colours (N, 3) RGB, labels (N,). Doubles: floats lose millimetres far from the origin."""
    rows = np.empty(len(points), POINT)
    rows["x"], rows["y"], rows["z"] = points.T
    rows["red"], rows["green"], rows["blue"] = colours.T
    rows["label"] = labels
    write_vertices(file, rows, comments)


def write_vertices(file: Path, rows: NDArray[np.void], comments: tuple[str, ...] = ()) -> None:
    """Write a structured array (N,) of little-endian numbers as the vertices of a PLY."""
    write_atomically(file, (ply_header(rows.dtype, len(rows), comments), rows.tobytes()))


@contextmanager
def replacing_vertices(
    file: Path, dtype: np.dtype[np.void], comments: tuple[str, ...] = ()
) -> Iterator[Callable[[NDArray[np.void]], None]]:
    """A function that takes structured arrays (N,) of this type, one after another: the vertices of a PLY, in place when the block
    ends well. The header has room for any number of them, filled up by blanks of a comment."""
    room, count = len(ply_header(dtype, MOST_VERTICES, (*comments, ""))), 0
    with replacing(file) as stream:

        def write(rows: NDArray[np.void]) -> None:
            nonlocal count
            count += len(rows)
            stream.write(rows.tobytes())

        stream.write(bytes(room))
        yield write
        stream.seek(0)
        blank = room - len(ply_header(dtype, count, (*comments, "")))
        stream.write(ply_header(dtype, count, (*comments, " " * blank)))


def ply_header(dtype: np.dtype[np.void], count: int, comments: tuple[str, ...]) -> bytes:
    """The lines before the vertices: their number and their layout."""
    assert dtype.names is not None
    properties = [f"property {NAMES_OF_TYPES[dtype[name].str[1:]]} {name}" for name in dtype.names]
    comment_lines = [f"comment {' '.join(comment.split()) or comment}" for comment in comments]
    header = [
        "ply",
        "format binary_little_endian 1.0",
        *comment_lines,
        f"element vertex {count}",
        *properties,
        "end_header",
        "",
    ]
    return "\n".join(header).encode("utf-8")


def read_ply(file: Path) -> Cloud:
    """The vertices of a binary little-endian PLY; colours 0 and labels 255 where it has none. Raises LogError."""
    rows = read_vertices(file)
    names = set(rows.dtype.names or ())
    labels = rows["label"].astype(np.uint8) if "label" in names else np.full(len(rows), 255, np.uint8)
    return Cloud(places(rows), vertex_colours(rows), labels)


def places(rows: NDArray[np.void]) -> NDArray[np.float64]:
    """(N, 3) x, y, z of vertices, float64."""
    return np.column_stack([rows[name] for name in "xyz"]).astype(np.float64)


def vertex_colours(rows: NDArray[np.void]) -> NDArray[np.uint8]:
    """(N, 3) RGB of vertices, 0 where they have none."""
    if not {"red", "green", "blue"} <= set(rows.dtype.names or ()):
        return np.zeros((len(rows), 3), np.uint8)
    return np.column_stack([rows[name] for name in ("red", "green", "blue")]).astype(np.uint8)


def read_vertices(file: Path) -> NDArray[np.void]:
    """The vertices of a binary little-endian PLY as a structured array (N,): x, y, z and what else there is. Raises LogError."""
    data = read_bytes(file, remedy="give a PLY file")
    end = data.find(b"end_header\n", 0, LONGEST_HEADER)
    lines = data[: max(end, 0)].decode("ascii", "replace").split("\n")
    if lines[0].strip() != "ply" or lines[1:2] != ["format binary_little_endian 1.0"]:
        raise LogError("is no binary little-endian PLY", file=file, remedy="convert it first")
    count, dtype = _vertices(lines, file)
    start = end + len(b"end_header\n")
    if len(data) - start < count * dtype.itemsize:
        what = f"ends after {(len(data) - start) // dtype.itemsize} of {count} points"
        raise LogError(what, file=file, remedy="the file is truncated: write it again")
    return np.frombuffer(data, dtype, count, start)


def _vertices(lines: list[str], file: Path) -> tuple[int, np.dtype[np.void]]:
    """The number of vertices and their layout; the vertex element must come first."""
    fields: list[tuple[str, str]] = []
    count = -1
    for line in (line.split() for line in lines[2:]):
        if line[:1] == ["element"] and count >= 0:
            break
        if line[:2] == ["element", "vertex"] and len(line) == 3 and line[2].isdecimal():
            count = int(line[2])
        elif line[:1] == ["property"]:
            if len(line) != 3 or line[1] not in TYPE_NAMES or line[2] in dict(fields):
                raise LogError(f"{quoted(' '.join(line))} is not understood", file=file, remedy="use scalar properties, each once")
            fields.append((line[2], "<" + TYPE_NAMES[line[1]]))
    if count < 0 or not {"x", "y", "z"} <= {name for name, _ in fields}:
        raise LogError("has no vertices with x, y and z", file=file, remedy="write the cloud again")
    return count, np.dtype(fields)
