"""Point clouds as binary little-endian PLY: x y z (double, metres), red green blue label (uchar)."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import LogError
from wayloom.logs.atomic import write_atomically
from wayloom.logs.text_files import quoted, read_bytes

POINT = np.dtype([("x", "<f8"), ("y", "<f8"), ("z", "<f8"), ("red", "u1"), ("green", "u1"), ("blue", "u1"), ("label", "u1")])
TYPE_NAMES = {
    "double": "f8", "float64": "f8", "float": "f4", "float32": "f4", "uchar": "u1", "uint8": "u1", "char": "i1", "int8": "i1",
    "ushort": "u2", "uint16": "u2", "short": "i2", "int16": "i2", "uint": "u4", "uint32": "u4", "int": "i4", "int32": "i4",
}  # fmt: skip
LONGEST_HEADER = 65_536


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
    types = {"<f8": "double", "|u1": "uchar"}
    properties = [f"property {types[POINT[name].str]} {name}" for name in POINT.names or ()]
    said = [f"comment {' '.join(comment.split())}" for comment in comments]
    header = ["ply", "format binary_little_endian 1.0", *said, f"element vertex {len(rows)}", *properties, "end_header", ""]
    write_atomically(file, ("\n".join(header).encode("utf-8"), rows.tobytes()))


def read_ply(file: Path) -> Cloud:
    """The vertices of a binary little-endian PLY; colours 0 and labels 255 where it has none. Raises LogError."""
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
    rows = np.frombuffer(data, dtype, count, start)
    names = set(dtype.names or ())
    colours = np.zeros((count, 3), np.uint8)
    if {"red", "green", "blue"} <= names:
        colours = np.column_stack([rows[name] for name in ("red", "green", "blue")]).astype(np.uint8)
    labels = rows["label"].astype(np.uint8) if "label" in names else np.full(count, 255, np.uint8)
    return Cloud(np.column_stack([rows[name] for name in "xyz"]).astype(np.float64), colours, labels)


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
