"""Well-known binary (ISO/IEC 13249-3) of GeoJSON geometries, little-endian, in the type that a column wants."""

import struct
from collections.abc import Mapping, Sequence
from typing import Any, Final

CODES: Final = {"Point": 1, "LineString": 2, "Polygon": 3, "MultiPoint": 4, "MultiLineString": 5, "MultiPolygon": 6}
WITH_Z: Final = 1000
"""Added to the code of a geometry whose places have heights."""
MULTI: Final = "Multi"


def wkb(geometry: Mapping[str, Any], kind: str) -> bytes:
    """The geometry's bytes as `kind`: a name of CODES, with a Z behind it where heights are kept (`MultiLineStringZ`).

    A single geometry fills a column of many. Raises ValueError for a geometry of another kind, or without the heights.
    """
    name, axes = (kind.removesuffix("Z"), 3) if kind.endswith("Z") else (kind, 2)
    if geometry["type"] not in (name, name.removeprefix(MULTI)):
        raise ValueError(f"a {geometry['type']} is no {name}")
    single = name.removeprefix(MULTI)
    if name == single:
        return _head(name, axes) + _body(single, geometry["coordinates"], axes)
    parts = geometry["coordinates"] if geometry["type"] == name else [geometry["coordinates"]]
    members = b"".join(_head(single, axes) + _body(single, part, axes) for part in parts)
    return _head(name, axes) + struct.pack("<I", len(parts)) + members


def _head(name: str, axes: int) -> bytes:
    return struct.pack("<BI", 1, CODES[name] + (WITH_Z if axes == 3 else 0))


def _body(name: str, coordinates: Sequence[Any], axes: int) -> bytes:
    if name == "Point":
        return _places([coordinates], axes)
    if name == "LineString":
        return struct.pack("<I", len(coordinates)) + _places(coordinates, axes)
    rings = (struct.pack("<I", len(ring)) + _places(ring, axes) for ring in coordinates)
    return struct.pack("<I", len(coordinates)) + b"".join(rings)


def _places(places: Sequence[Sequence[float]], axes: int) -> bytes:
    if any(len(place) < axes for place in places):
        raise ValueError("a place has no height")
    return struct.pack(f"<{axes * len(places)}d", *(value for place in places for value in place[:axes]))
