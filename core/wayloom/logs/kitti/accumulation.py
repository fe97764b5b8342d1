"""Accumulated labelled LiDAR clouds in windows along the trajectory, as KITTI-360 publishes them."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.files.ply import places, write_vertices
from wayloom.logs.kitti.kitti_360_layout import Sequence

FloatArray = NDArray[np.float64]
WINDOW_M, OVERLAP_M = 200.0, 10.0
VOXEL_M: Final = 0.08
"""Of the static points in a voxel the first one stays."""
FLOAT_REACH_M: Final = 8192.0
"""Up to here a float32 is good to half a millimetre; beyond, coordinates are doubles."""
MERGE_AT: Final = 1_000_000
LABELS: Final = [
    ("red", "u1"), ("green", "u1"), ("blue", "u1"),
    ("semantic", "<i4"), ("instance", "<i4"), ("visible", "u1"), ("confidence", "<f4"),
]  # fmt: skip


@dataclass(frozen=True, slots=True)
class Scan:
    """points (N, 3) m in the left camera's frame, colours (N, 3) RGB, visible (N,), ids (N,) uint8, instance (N,), moving (N,)."""

    points: FloatArray
    colours: NDArray[np.uint8]
    visible: NDArray[np.bool_]
    ids: NDArray[np.uint8]
    instance: NDArray[np.int32]
    moving: NDArray[np.bool_]


def accumulate(sequence: Sequence, T_world_cam: FloatArray, scan: Callable[[int], Scan | None]) -> None:
    """Write `static` and `dynamic` clouds of the frames at T_world_cam (N, 4, 4). A cloud without points is not written."""
    for first, last in window_frames(T_world_cam):
        still, moving = window_rows(T_world_cam, first, last, scan)
        name = f"{first:010d}_{last:010d}.ply"
        if len(still):
            write_vertices(sequence.clouds / "static" / name, without_frame(still))
        if len(moving):
            write_vertices(sequence.clouds / "dynamic" / name, moving)


def window_rows(
    T_world_cam: FloatArray, first: int, last: int, scan: Callable[[int], Scan | None]
) -> tuple[NDArray[np.void], NDArray[np.void]]:
    """Static points, voxel-filtered, and moving points of the scans from frame `first` to `last`: rows of `world_rows`.

    T_world_cam : (N, 4, 4) of the whole drive
    """
    reach = float(np.abs(T_world_cam[:, :3, 3]).max())
    none = np.empty(0, row_type(reach))
    still, moving, known = [none], [none], VoxelFilter()
    for frame in range(first, last + 1):
        seen = scan(frame)
        if seen is None:
            continue
        rows = world_rows(seen, T_world_cam[frame], frame, reach)
        moving.append(rows[seen.moving])
        standing = rows[~seen.moving]
        still.append(standing[known.new(places(standing))])
    return np.concatenate(still), np.concatenate(moving)


def window_frames(T_world_cam: FloatArray) -> list[tuple[int, int]]:
    """First and last frame of each window: about WINDOW_M of way, each begins OVERLAP_M before the last one ends."""
    steps = np.linalg.norm(np.diff(T_world_cam[:, :3, 3], axis=0), axis=1)
    way = np.concatenate([[0.0], np.cumsum(steps)])
    out: list[tuple[int, int]] = []
    first = 0
    while True:
        last = int(np.searchsorted(way, way[first] + WINDOW_M, side="right")) - 1
        if way[-1] - way[last] <= OVERLAP_M:
            return [*out, (first, len(way) - 1)]
        out.append((first, last))
        first = max(first + 1, int(np.searchsorted(way, way[last] - OVERLAP_M)))


def world_rows(scan: Scan, T_world_cam: FloatArray, frame: int, reach_m: float) -> NDArray[np.void]:
    """(N,) the points of a scan in the world, with everything that a dynamic cloud says of them."""
    rows = np.empty(len(scan.points), row_type(reach_m))
    p_world = scan.points @ T_world_cam[:3, :3].T + T_world_cam[:3, 3]
    rows["x"], rows["y"], rows["z"] = p_world.T
    rows["red"], rows["green"], rows["blue"] = scan.colours.T
    rows["semantic"], rows["instance"], rows["visible"] = scan.ids, scan.instance, scan.visible
    rows["confidence"], rows["timestamp"] = 1.0, frame
    return rows


def row_type(reach_m: float) -> np.dtype[np.void]:
    """The dtype of the rows of a cloud whose coordinates reach up to reach_m from the origin."""
    real = "<f4" if reach_m < FLOAT_REACH_M else "<f8"
    return np.dtype([("x", real), ("y", real), ("z", real), *LABELS, ("timestamp", "<i4")])


def without_frame(rows: NDArray[np.void]) -> NDArray[np.void]:
    """The same points without the frame in which they were seen, which static clouds do not hold."""
    names = [name for name in rows.dtype.names or () if name != "timestamp"]
    out = np.empty(len(rows), [(name, rows.dtype[name]) for name in names])
    for name in names:
        out[name] = rows[name]
    return out


class VoxelFilter:
    """Voxel filter over a stream of points: the first point in each voxel is kept."""

    def __init__(self, voxel_m: float = VOXEL_M) -> None:
        self._voxel_m = voxel_m
        self._known = np.empty(0, np.int64)
        self._recent: list[NDArray[np.int64]] = []

    def new(self, points: FloatArray) -> NDArray[np.int64]:
        """Rows of points (N, 3) m that are the first of all so far in their voxel, in order."""
        cell = np.floor(points / self._voxel_m).astype(np.int64) & 0x1FFFFF
        keys, rows = np.unique((cell[:, 0] << 42) | (cell[:, 1] << 21) | cell[:, 2], return_index=True)
        for known in (self._known, *self._recent):
            fresh = ~is_in(keys, known)
            keys, rows = keys[fresh], rows[fresh]
        self._recent.append(keys)
        if len(self._recent) > 16 or sum(map(len, self._recent)) > MERGE_AT:
            self._known = np.sort(np.concatenate([self._known, *self._recent]))
            self._recent = []
        return np.sort(rows)


def is_in(keys: NDArray[np.int64], known: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(N,) whether keys are among `known`, which is sorted."""
    if not len(known):
        return np.zeros(len(keys), bool)
    at = np.minimum(np.searchsorted(known, keys), len(known) - 1)
    return np.asarray(known[at] == keys)
