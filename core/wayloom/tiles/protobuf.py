"""Protocol buffer encoder for what the map needs of Mapbox Vector Tile 2.1: points, lines and polygons with properties.

A general encoder builds and checks a geometry object for each cell, which would dominate the time of all tiles.
Fields: the specification's vector_tile.proto.
"""

from collections.abc import Iterable, Mapping, Sequence

from wayloom.files.wire_format import double_field, field, number_field, varint

MVT_VERSION = 2
POINT, LINE, POLYGON = 1, 2, 3
MOVE_TO, LINE_TO, CLOSE_PATH = 1, 2, 7
Value = str | int | float
Point = tuple[int, int]


def zigzag(value: int) -> bytes:
    """A whole number with sign, so that small ones stay short: 0, -1, 1, -2 are 0, 1, 2, 3."""
    return varint(value << 1 if value >= 0 else (-value << 1) - 1)


def command(identifier: int, count: int) -> bytes:
    """A drawing command: what, and how often."""
    return varint(identifier | count << 3)


def square(x: int, y: int, size: int) -> bytes:
    """The outline of a square from its upper left corner, clockwise on the screen (an outer ring, by the specification)."""
    sides = zigzag(size) + zigzag(0) + zigzag(0) + zigzag(size) + zigzag(-size) + zigzag(0)
    return command(MOVE_TO, 1) + zigzag(x) + zigzag(y) + command(LINE_TO, 3) + sides + command(CLOSE_PATH, 1)


def line(points: list[Point]) -> bytes:
    """A line of at least two points, each unlike the one before."""
    x, y = points[0]
    out = [command(MOVE_TO, 1), zigzag(x), zigzag(y), command(LINE_TO, len(points) - 1)]
    for next_x, next_y in points[1:]:
        out += [zigzag(next_x - x), zigzag(next_y - y)]
        x, y = next_x, next_y
    return b"".join(out)


def point(x: int, y: int) -> bytes:
    """One point."""
    return command(MOVE_TO, 1) + zigzag(x) + zigzag(y)


def polygon(rings: Sequence[Sequence[Point]]) -> bytes:
    """Rings of at least three points, none of them given twice: the outer one clockwise on the screen, then holes."""
    x, y = 0, 0
    out = []
    for ring in rings:
        for k, (next_x, next_y) in enumerate(ring):
            out.append(command(MOVE_TO, 1) if k == 0 else command(LINE_TO, len(ring) - 1) if k == 1 else b"")
            out.append(zigzag(next_x - x) + zigzag(next_y - y))
            x, y = next_x, next_y
        out.append(command(CLOSE_PATH, 1))
    return b"".join(out)


def layer(name: str, extent: int, kind: int, features: Iterable[tuple[bytes, Mapping[str, Value]]]) -> bytes:
    """The bytes of one layer, all of whose features are of one kind: (geometry, properties) of each."""
    keys: dict[str, int] = {}
    values: dict[tuple[type, Value], int] = {}
    body = []
    for geometry, properties in features:
        tags = b"".join(
            varint(keys.setdefault(key, len(keys))) + varint(values.setdefault((type(value), value), len(values)))
            for key, value in properties.items()
        )
        body.append(field(2, field(2, tags) + number_field(3, kind) + field(4, geometry)))
    body += [field(3, key.encode()) for key in keys]
    body += [field(4, _value(value)) for _, value in values]
    return field(3, number_field(15, MVT_VERSION) + field(1, name.encode()) + b"".join(body) + number_field(5, extent))


def _value(value: Value) -> bytes:
    if isinstance(value, float):
        return double_field(3, value)
    return field(1, value.encode()) if isinstance(value, str) else number_field(5, value)
