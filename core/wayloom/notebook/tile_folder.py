"""Points of a folder of a map's tiles, as `wayloom sync` keeps it or `wayloom export` writes it."""

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np

from wayloom.errors import InputError
from wayloom.exports.points import PointBatch, cut, joined_batches
from wayloom.geodesy import wgs84
from wayloom.geodesy.antimeridian import Box
from wayloom.geodesy.map_frame import MapFrame, map_frame_for
from wayloom.geometry import se3
from wayloom.tiles.points import PointTile, decode_points

LAYER: Final = "points"
REMEDY: Final = "give the folder that `wayloom sync` keeps, with its layer points"


def is_tile_folder(folder: Path) -> bool:
    """Whether tiles of points lie there."""
    return (folder / LAYER).is_dir()


class TileFolder:
    """The tiles of points of the finest zoom. Raises InputError where there are none.

    frame  the tangent plane of the middle of the degree cell in which the first tile lies
    """

    def __init__(self, folder: Path, box: Box | None = None) -> None:
        zooms = [int(one.name) for one in (folder / LAYER).iterdir() if one.name.isdecimal()]
        self._files = sorted((folder / LAYER / str(max(zooms))).glob("*/*")) if zooms else []
        if not self._files:
            raise InputError("holds no tiles of points", file=folder, remedy=REMEDY)
        origin = self._read(self._files[0]).origin
        self.frame, self._box = map_frame_for(origin.lon_deg, origin.lat_deg), box

    def points(self) -> PointBatch:
        """All points in the frame. A tile tells of no grey values, sigmas and times: 0, NaN and 0."""
        return joined_batches([*self._batches()])

    def _batches(self) -> Iterator[PointBatch]:
        for file in self._files:
            batch = cut(_batch(self._read(file), self.frame), self.frame, self._box)
            if len(batch):
                yield batch

    def _read(self, file: Path) -> PointTile:
        return decode_points(file.read_bytes(), str(file))


def _batch(tile: PointTile, frame: MapFrame) -> PointBatch:
    count = len(tile)
    points = se3.transform(wgs84.T_enu_enu(frame, tile.origin), tile.position)
    never, unknown = np.zeros(count, np.int64), np.full(count, np.nan, np.float32)
    grey, drives = np.zeros(count, np.uint8), tile.drives.astype(np.uint16)
    return PointBatch(points, tile.label, grey, unknown, tile.confidence, drives, never, never)
