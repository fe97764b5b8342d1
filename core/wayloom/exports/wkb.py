"""Well-known binary of GeoJSON geometries: ISO, little-endian, with heights."""

import struct
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

POINT, LINE, POLYGON, MULTI_LINE, MULTI_POLYGON = 1001, 1002, 1003, 1005, 1006
TYPES: Final = {
    "Point": POINT, "LineString": LINE, "Polygon": POLYGON, "MultiLineString": MULTI_LINE, "MultiPolygon": MULTI_POLYGON,
}  # fmt: skip
POINT_DTYPE: Final = np.dtype([("order", "u1"), ("type", "<u4"), ("at", "<f8", 3)])


def wkb(geometry: Mapping[str, Any]) -> bytes:
    """The bytes of a geometry; a place without height has 0."""
    kind, parts = TYPES[geometry["type"]], geometry["coordinates"]
    head = struct.pack("<BI", 1, kind)
    if kind == POINT:
        return head + _places([parts])
    if kind == LINE:
        return head + struct.pack("<I", len(parts)) + _places(parts)
    if kind == POLYGON:
        return head + struct.pack("<I", len(parts)) + b"".join(struct.pack("<I", len(ring)) + _places(ring) for ring in parts)
    single = "LineString" if kind == MULTI_LINE else "Polygon"
    return head + struct.pack("<I", len(parts)) + b"".join(wkb({"type": single, "coordinates": part}) for part in parts)


def wkb_points(lon_lat_height: NDArray[np.float64]) -> NDArray[np.void]:
    """(N,) the bytes of points (N, 3), `POINT_DTYPE` each."""
    rows = np.empty(len(lon_lat_height), POINT_DTYPE)
    rows["order"], rows["type"], rows["at"] = 1, POINT, lon_lat_height
    return rows


def _places(places: Sequence[Sequence[float]]) -> bytes:
    return b"".join(struct.pack("<3d", place[0], place[1], place[2] if len(place) > 2 else 0.0) for place in places)
