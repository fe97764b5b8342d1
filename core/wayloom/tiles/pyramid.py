"""Tile pyramid of a whole map in memory."""

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import StageError
from wayloom.geodesy import wgs84
from wayloom.geodesy.map_frame import MapFrame
from wayloom.stitching.voxel_map import VoxelMap
from wayloom.submaps.submap import PlacedSubmap
from wayloom.tiles.formats import SERVED_LAYERS, Tile
from wayloom.tiles.grid import TILE_PX, TileAddress, pixel_from_lonlat
from wayloom.tiles.mvt import LonLatTrack, tiles_of_track
from wayloom.tiles.settings import TileSettings
from wayloom.tiles.updates import block_zoom, margin_px, updated_tiles

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
TOUCHING_M = 15.0  # the last keyframe of a submap and the first of the next


@dataclass(frozen=True, slots=True)
class Track:
    """One unbroken piece of a drive: its id and the camera's places (K, 3) m in the map's frame."""

    drive_id: str
    points_enu: FloatArray


def tracks_of(placed: Iterable[PlacedSubmap]) -> list[Track]:
    """The tracks of submaps, sorted independently of their order. Pieces of one drive that nearly touch are one track."""
    pieces = {(item.drive_id, int(item.submap.keyframe_t_ns[0]), item.submap.digest): item for item in placed}
    tracks: list[Track] = []
    for key in sorted(pieces):
        drive_id, points = key[0], pieces[key].track_enu()
        last = tracks[-1] if tracks and tracks[-1].drive_id == drive_id else None
        if last is not None and np.linalg.norm(points[0] - last.points_enu[-1]) < TOUCHING_M:
            tracks[-1] = Track(drive_id, np.vstack([last.points_enu, points]))
        else:
            tracks.append(Track(drive_id, points))
    return tracks


def build_tiles(
    voxel_map: VoxelMap, frame: MapFrame | None, settings: TileSettings = TileSettings(), tracks: Sequence[Track] = ()
) -> Iterator[Tile]:
    """Every served tile that shows something.

    frame : the map's frame. Raises StageError when it is None (a map in a drive's own frame has no place on Earth) or another than
            the voxels'; InputError beyond the latitudes of web mercator.
    """
    if frame is None or frame != voxel_map.frame:
        raise StageError(
            f"a map in the frame {voxel_map.frame} cannot be cut into tiles of {frame}: geo-reference the drives first"
        )
    whole = WholeMap(voxel_map, frame, settings, tracks)
    yield from (tile for tile in updated_tiles(whole.blocks, whole, settings) if tile.layer in SERVED_LAYERS)


class WholeMap:
    """A map in memory as the source of its tiles (`updates.PyramidSource`).

    blocks : those that show anything of it
    """

    def __init__(self, voxel_map: VoxelMap, frame: MapFrame, settings: TileSettings, tracks: Sequence[Track]) -> None:
        self._voxels, self._settings = voxel_map, settings
        lon_lat = wgs84.lonlatheight_from_enu(voxel_map.points_enu, frame)[:, :2]
        self._pixels = pixel_from_lonlat(lon_lat, settings.max_zoom)
        lines = [(t.drive_id, t.points_enu) for t in tracks if len(t.points_enu)]
        self._tracks = [LonLatTrack(name, wgs84.lonlatheight_from_enu(points, frame)[:, :2]) for name, points in lines]
        self._rows = self._rows_by_block()
        zoom = block_zoom(settings)
        of_voxels = {TileAddress(zoom, x, y) for x, y in self._rows}
        self.blocks = of_voxels.union(*(tiles_of_track(track, zoom) for track in self._tracks))

    @property
    def _edge_px(self) -> int:
        return TILE_PX << (self._settings.max_zoom - block_zoom(self._settings))

    def _rows_by_block(self) -> dict[tuple[int, int], IntArray]:
        """The voxels of each block and of its margin."""
        found: dict[tuple[int, int], list[IntArray]] = {}
        margin = margin_px(self._settings)
        for dy in (-margin, 0, margin):
            for dx in (-margin, 0, margin):
                places = (self._pixels + np.array([dx, dy])) // self._edge_px
                order = np.lexsort((places[:, 0], places[:, 1]))
                edges = np.flatnonzero((np.diff(places[order], axis=0) != 0).any(axis=1)) + 1
                for rows in np.split(order, edges) if len(order) else []:
                    x, y = places[rows[0]].tolist()
                    found.setdefault((x, y), []).append(rows)
        return {key: np.unique(np.concatenate(rows)) for key, rows in found.items()}

    def voxels(self, block: TileAddress) -> VoxelMap:
        """Those of the block and of its margin, in the map's order."""
        return self._voxels.take(self._rows.get((block.x, block.y), np.zeros(0, np.int64)))

    def stored(self, _name: str, _address: TileAddress) -> bytes | None:
        """Nothing was there before."""
        return None

    def tracks(self, _addresses: Collection[TileAddress]) -> Sequence[LonLatTrack]:
        """All of them."""
        return self._tracks
