"""Tile pyramid of a map: raster, vector and point tiles, the coarse ones summed from the fine ones."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import StageError
from wayloom.geodesy import wgs84
from wayloom.geodesy.map_frame import MapFrame
from wayloom.stitching.voxel_map import VoxelMap
from wayloom.submaps.submap import PlacedSubmap
from wayloom.tiles.grid import TILE_PX, TileAddress, pixel_from_lonlat
from wayloom.tiles.levels import Level, coarser, dilated, finest_level
from wayloom.tiles.mvt import LonLatTrack, encode_mvt, tiles_of_track
from wayloom.tiles.png import encode_png
from wayloom.tiles.points import PointTile, encode_points, origin_of, voxel_downsampled
from wayloom.tiles.settings import TileSettings

FloatArray = NDArray[np.float64]
FINE_CELLS, COARSE_CELLS = 128, 64
TOUCHING_M = 15.0  # the last keyframe of a submap and the first of the next
COARSEST = 3  # the vector tiles of the lowest zoom need the pixels two zooms below


@dataclass(frozen=True, slots=True)
class TileFormat:
    """A tile format. layer: the name under which such tiles are addressed; media_type for HTTP; suffix for files."""

    layer: str
    media_type: str
    suffix: str


TILE_FORMATS: Final = {
    "png": TileFormat("semantic", "image/png", ".png"),
    "mvt": TileFormat("features", "application/vnd.mapbox-vector-tile", ".mvt"),
    "points": TileFormat("points", "application/vnd.wayloom.points", ".wlp"),
}


@dataclass(frozen=True, slots=True)
class Tile:
    """One tile: layer, address, media type and bytes. Equal maps give equal bytes."""

    layer: str
    z: int
    x: int
    y: int
    media_type: str
    data: bytes


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
    """Every tile that shows something, layer by layer, zoom by zoom from fine to coarse, row by row.

    frame : the map's frame. Raises StageError when it is None (a map in a drive's own frame has no place on Earth) or another than
            the voxels'; InputError beyond the latitudes of web mercator.
    """
    if frame is None or frame != voxel_map.frame:
        raise StageError(
            f"a map in the frame {voxel_map.frame} cannot be cut into tiles of {frame}: geo-reference the drives first"
        )
    lon_lat_height = wgs84.lonlatheight_from_enu(voxel_map.points_enu, frame)
    lines = [LonLatTrack(t.drive_id, wgs84.lonlatheight_from_enu(t.points_enu, frame)[:, :2]) for t in tracks if len(t.points_enu)]
    yield from _point_tiles(voxel_map, lon_lat_height, settings)
    level = finest_level(lon_lat_height[:, :2], voxel_map.label, settings.max_zoom)
    for zoom in range(settings.max_zoom, settings.min_zoom - COARSEST, -1):
        if settings.min_zoom <= zoom:
            yield from _picture_tiles(level, settings)
        tile_zoom = _vector_zoom(zoom, settings)
        if tile_zoom is not None:
            yield from _vector_tiles(level, tile_zoom, lines, settings)
        level = coarser(level)


def _tile(name: str, address: TileAddress, data: bytes) -> Tile:
    form = TILE_FORMATS[name]
    return Tile(form.layer, *address, form.media_type, data)


def _picture_tiles(level: Level, settings: TileSettings) -> Iterator[Tile]:
    drawn = dilated(level) if level.zoom >= settings.dot_from_zoom else level
    for address, part in drawn.tiles():
        yield _tile("png", address, encode_png(part, settings.max_zoom))


def _cells_per_edge(tile_zoom: int, settings: TileSettings) -> int:
    return FINE_CELLS if tile_zoom >= settings.fine_cells_from_zoom else COARSE_CELLS


def _vector_zoom(level_zoom: int, settings: TileSettings) -> int | None:
    """The zoom of the vector tiles whose cells are the pixels of this level, if there is one: 64 = 256 / 2^2, 128 = 256 / 2."""
    for tile_zoom, cells in ((level_zoom + 1, FINE_CELLS), (level_zoom + 2, COARSE_CELLS)):
        if settings.min_zoom <= tile_zoom <= settings.features_max_zoom and _cells_per_edge(tile_zoom, settings) == cells:
            return tile_zoom
    return None


def _vector_tiles(level: Level, tile_zoom: int, tracks: Sequence[LonLatTrack], settings: TileSettings) -> Iterator[Tile]:
    cells = _cells_per_edge(tile_zoom, settings)
    parts = {TileAddress(tile_zoom, x, y): part for x, y, part in level.blocks(cells)}
    lines: dict[TileAddress, list[tuple[str, list[tuple[int, int]]]]] = {}
    for track in tracks:
        for address, pieces in tiles_of_track(track, tile_zoom).items():
            lines.setdefault(address, []).extend((track.drive_id, piece) for piece in pieces)
    for address in sorted({*parts, *lines}, key=_row_by_row):
        yield _tile("mvt", address, encode_mvt(parts.get(address), cells, lines.get(address, [])))


def _row_by_row(address: TileAddress) -> tuple[int, int]:
    return address.y, address.x


def _point_tiles(voxel_map: VoxelMap, lon_lat_height: FloatArray, settings: TileSettings) -> Iterator[Tile]:
    places = pixel_from_lonlat(lon_lat_height[:, :2], settings.points_zoom) // TILE_PX
    order = np.lexsort((places[:, 0], places[:, 1]))
    edges = np.flatnonzero((np.diff(places[order], axis=0) != 0).any(axis=1)) + 1
    for rows in np.split(order, edges) if len(order) else []:
        address = TileAddress(settings.points_zoom, *places[rows[0]].tolist())
        points = point_tile(voxel_map.take(rows), lon_lat_height[rows], address)
        yield _tile("points", address, encode_points(voxel_downsampled(points, settings.points_per_tile, voxel_map.voxel_m)))


def point_tile(voxels: VoxelMap, lon_lat_height: FloatArray, address: TileAddress) -> PointTile:
    """The voxels of one tile in its own tangent plane, whose height is the whole metre in the middle of theirs."""
    heights = lon_lat_height[:, 2]
    origin = origin_of(address, float(np.round(0.5 * (heights.min() + heights.max()))))
    return PointTile(
        address,
        origin,
        wgs84.enu_from_lonlatheight(lon_lat_height, origin),
        np.ones(len(voxels), np.uint32),
        voxels.label,
        np.rint(255.0 * voxels.confidence).astype(np.uint8),
        np.minimum(voxels.drives, 255).astype(np.uint8),
    )
