"""PLY near a local origin, up as up, written batch by batch."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import PALETTE_WITH_VOID
from wayloom.exports.points import PointBatch
from wayloom.files.ply import ply_header, replacing_vertices
from wayloom.geodesy import wgs84
from wayloom.geodesy.map_frame import MapFrame
from wayloom.geometry import se3

VERTEX: Final = np.dtype([
    ("x", "<f8"), ("y", "<f8"), ("z", "<f8"), ("red", "u1"), ("green", "u1"), ("blue", "u1"), ("label", "u1"), ("intensity", "u1"),
    ("confidence", "u1"), ("drives", "<u2"), ("sigma", "<f4"), ("time", "<f8"),
])  # fmt: skip
PLACE_DIGITS, HEIGHT_DIGITS = 6, 1
"""Of the origin: a tenth of a metre, so that its text in the header is exact."""


def local_origin(place: NDArray[np.float64], frame: MapFrame) -> MapFrame:
    """The tangent plane at a place (3,) m in the frame, in round degrees."""
    lon, lat, height = wgs84.lonlatheight_from_enu(place[None], frame)[0].tolist()
    return MapFrame(round(lon, PLACE_DIGITS), round(lat, PLACE_DIGITS), round(height, HEIGHT_DIGITS))


def write_ply(path: Path, batches: Iterable[PointBatch], place: NDArray[np.float64], frame: MapFrame | None) -> int:
    """Write points as PLY; how many there are. Their axes are east, north, up at `place` (3,) m in the frame, which lies near
    (0, 0, 0); the comment tells its longitude, latitude and height. Without a frame: the drive's own. Raises OSError."""
    T_local_frame, comments = _axes(place, frame)
    count = 0
    with replacing_vertices(path, VERTEX, comments) as write:
        for batch in batches:
            write(_vertices(batch, T_local_frame))
            count += len(batch)
    return count


def ply_blocks(batches: Iterable[PointBatch], count: int, place: NDArray[np.float64], frame: MapFrame | None) -> Iterator[bytes]:
    """Bytes of a file as of `write_ply`, batch by batch, for streams, which never go back to the header: `count` comes first."""
    T_local_frame, comments = _axes(place, frame)
    yield ply_header(VERTEX, count, comments)
    for batch in batches:
        yield _vertices(batch, T_local_frame).tobytes()


def _axes(place: NDArray[np.float64], frame: MapFrame | None) -> tuple[NDArray[np.float64], tuple[str, str]]:
    """(4, 4) from the frame to the file's axes, and the header's comments."""
    units = "sigma: m; time: seconds since 1970, UTC"
    if frame is None:
        return np.eye(4), ("frame: the drive's own world", units)
    origin = local_origin(place, frame)
    words = f"frame: ENU at {origin.lon_deg} {origin.lat_deg} {origin.height_m} (WGS84)"
    return wgs84.T_enu_enu(origin, frame), (words, units)


def _vertices(batch: PointBatch, T_local_frame: NDArray[np.float64]) -> NDArray[np.void]:
    rows = np.empty(len(batch), VERTEX)
    rows["x"], rows["y"], rows["z"] = se3.transform(T_local_frame, batch.points).T
    rows["red"], rows["green"], rows["blue"] = PALETTE_WITH_VOID[batch.label].T
    rows["label"], rows["intensity"], rows["confidence"] = batch.label, batch.grey, batch.confidence
    rows["drives"], rows["sigma"], rows["time"] = batch.drives, batch.sigma_m, batch.seen_ns / 1e9
    return rows
