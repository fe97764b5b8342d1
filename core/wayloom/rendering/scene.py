"""Scene: the points of a map or a cloud in a level frame, with what they can be coloured by, and the ways of the drives."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.config.progress import Progress, silent
from wayloom.errors import InputError
from wayloom.exports.boxes import inside
from wayloom.exports.city_survey import level_plane
from wayloom.exports.cloud_files import read_cloud
from wayloom.exports.source import MapSource
from wayloom.geodesy import wgs84
from wayloom.geodesy.antimeridian import Box
from wayloom.geometry import se3
from wayloom.ground.ground_map import NO_HEIGHT
from wayloom.ground.sheet import CELL_M, GROUND_CLASSES
from wayloom.stitching.region_grid import RegionKey, region_edges
from wayloom.stitching.voxel_map import VoxelMap

FloatArray = NDArray[np.float64]
VOXEL_SIZE_M: Final = 0.16
"""Of a splat: voxels are sparser than their edge."""
SPARSE_SIZE_M: Final = 0.22
GROUND_SIZE_M: Final = 1.25 * CELL_M
SEVERAL: Final = -1
MANY_POINTS: Final = 20_000_000


@dataclass(frozen=True, slots=True)
class Scene:
    """N points in a level frame: x east, y north, z up of a place in the middle; right, ahead, up of a drive without one.

    points  (N, 3) float32 m; label (N,) train ids, 255 void; size_m (N,) float32 edge of a splat
    photo   (N, 3) uint8 RGB as the cameras saw it, grey where only grey is known
    drive   (N,) int16 row of `drives`; SEVERAL: seen by more than one, or not known
    tracks  of each drive its camera's places (K, 3) m; drives: their names
    north_up  whether the frame is geographic
    """

    points: NDArray[np.float32]
    label: NDArray[np.uint8]
    photo: NDArray[np.uint8]
    size_m: NDArray[np.float32]
    drive: NDArray[np.int16]
    tracks: Sequence[FloatArray]
    drives: Sequence[str]
    north_up: bool

    def __len__(self) -> int:
        return len(self.points)


@dataclass(frozen=True, slots=True)
class _Part:
    """Columns of some points, as those of `Scene`."""

    points: FloatArray
    label: NDArray[np.uint8]
    photo: NDArray[np.uint8]
    size_m: float
    drive: NDArray[np.int16]


def scene_of_map(source: MapSource, box: Box | None = None, progress: Progress = silent) -> Scene:
    """The static voxels of a map, and its ground, where there is one, cell by cell. Raises InputError where there is nothing."""
    T = level_plane(source)[0]
    tracks = [(track.drive_id, se3.transform(T, track.points_enu)) for track in source.tracks() if len(track.points_enu) > 1]
    names = sorted({name for name, _ in tracks})
    parts: list[_Part] = []
    for number, key in enumerate(source.keys):
        for part in (_of_voxels(source.voxels(key), names), _of_ground(source, key)):
            if part is not None:
                parts.append(_placed(_cut(part, source, box), T))
        progress((number + 1) / len(source.keys), f"region {number + 1} of {len(source.keys)}")
    if sum(len(part.points) for part in parts) > MANY_POINTS:
        raise InputError("is too large for one picture", remedy="give a --bbox")
    ways = [np.concatenate([places for name, places in tracks if name == wanted]) for wanted in names]
    return _joined(parts, ways, names, source.frame is not None)


def scene_of_file(path: Path) -> Scene:
    """The points of a .laz, .las or .ply file, moved near the origin. Raises InputError."""
    cloud = read_cloud(path)
    middle = np.median(cloud.points, axis=0) if len(cloud.points) else np.zeros(3)
    unknown = np.full(len(cloud.points), SEVERAL, np.int16)
    part = _Part(cloud.points - middle, cloud.labels, cloud.photo, VOXEL_SIZE_M, unknown)
    return _joined([part], [], [], cloud.is_geographic)


def scene_of_points(
    points: FloatArray, label: NDArray[np.uint8], grey: NDArray[np.uint8], track: FloatArray, north_up: bool
) -> Scene:
    """Points (N, 3) m of one drive in a level frame, labels (N,), grey values (N,), its camera's places (K, 3) m.

    Raises InputError where there is none.
    """
    middle = np.median(points, axis=0) if len(points) else np.zeros(3)
    photo = np.repeat(grey[:, None], 3, axis=1)
    part = _Part(points - middle, label, photo, SPARSE_SIZE_M, np.zeros(len(points), np.int16))
    return _joined([part], [track - middle] if len(track) > 1 else [], ["the drive"] if len(track) > 1 else [], north_up)


def _joined(parts: Sequence[_Part], tracks: Sequence[FloatArray], names: Sequence[str], north_up: bool) -> Scene:
    if not any(len(part.points) for part in parts):
        raise InputError("there is nothing to see", remedy="give a map with points, or another box")
    sizes = [np.full(len(part.points), part.size_m, np.float32) for part in parts]
    return Scene(
        np.concatenate([part.points for part in parts]).astype(np.float32), np.concatenate([part.label for part in parts]),
        np.concatenate([part.photo for part in parts]), np.concatenate(sizes), np.concatenate([part.drive for part in parts]),
        tracks, names, north_up,
    )  # fmt: skip


def _of_voxels(voxels: VoxelMap | None, names: Sequence[str]) -> _Part | None:
    if voxels is None or not len(voxels):
        return None
    row_of = np.array([names.index(name) if name in names else SEVERAL for name in voxels.drive_ids], np.int16)
    drive = np.full(len(voxels), SEVERAL, np.int16)
    alone = np.diff(voxels.drive_start) == 1
    drive[alone] = row_of[voxels.drive[voxels.drive_start[:-1][alone]]]
    photo = np.repeat(voxels.grey[:, None], 3, axis=1)
    return _Part(voxels.points_enu, voxels.label, photo, VOXEL_SIZE_M, drive)


def _of_ground(source: MapSource, key: RegionKey) -> _Part | None:
    """A point a cell of 10 cm of the region's ground: height, class and photograph."""
    rasters: dict[str, Any] = {name: source.raster(key, name) for name in ("height_mm", "votes", "colour", "sharpness", "looks")}
    height_mm, votes = rasters["height_mm"], rasters["votes"]
    if height_mm is None:
        return None
    row, column = np.nonzero((height_mm != NO_HEIGHT) & (rasters["sharpness"][::2, ::2] > 0))
    corner = region_edges(key)[0]
    plane = corner + CELL_M * (np.column_stack([column, row]) + 0.5)
    points = np.column_stack([plane, height_mm[row, column] / 1000.0])
    colour = rasters["colour"][2 * row, 2 * column]
    label = np.asarray(GROUND_CLASSES, np.uint8)[np.argmax(votes[row, column], axis=1)]
    label = np.where(votes[row, column].any(axis=1), label, 255).astype(np.uint8)
    drive = np.full(len(points), SEVERAL, np.int16)
    return _Part(points, label, np.broadcast_to(colour, (len(points), 3)), GROUND_SIZE_M, drive) if len(points) else None


def _cut(part: _Part, source: MapSource, box: Box | None) -> _Part:
    if box is None or source.frame is None:
        return part
    rows = inside(wgs84.lonlatheight_from_enu(part.points, source.frame), box)
    return _Part(part.points[rows], part.label[rows], part.photo[rows], part.size_m, part.drive[rows])


def _placed(part: _Part, T: FloatArray) -> _Part:
    return _Part(se3.transform(T, part.points), part.label, part.photo, part.size_m, part.drive)
