"""Voxel map: one layer of the map on a regular grid in the map's frame."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_COUNT
from wayloom.geodesy.map_frame import MapFrame

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class VoxelMap:
    """V voxels, sorted by the east, then the north, then the up part of their keys.

    frame          the map's frame; None: a drive's own
    voxel_m        edge, m
    keys           (V, 3) int32: floor(enu / voxel_m)
    points_enu     (V, 3) m, mean of the fused points, weighted by inverse variance
    grey           (V,) uint8: grey value in the images, weighed as the points are
    sigma_m        (V,) float32 m: of the surest of its points, along the surface's normal where there is a surface
    votes          (V, 19) float32, 1/m: votes of all drives for the surface around the voxel
    label          (V,) uint8, the class with the most votes of those that the layer may have, the lower on a tie
    count          (V,) uint32 points in it
    drive_start    (V + 1,) int64; drive (D,) int32 rows of drive_ids: the drives that vote for the voxel, increasing
    first_seen_ns, last_seen_ns  (V,) int64: by those drives
    drive_ids      sorted
    left_out       how many points are in no layer, by reason
    """

    frame: MapFrame | None
    voxel_m: float
    keys: NDArray[np.int32]
    points_enu: FloatArray
    grey: NDArray[np.uint8]
    sigma_m: NDArray[np.float32]
    votes: NDArray[np.float32]
    label: NDArray[np.uint8]
    count: NDArray[np.uint32]
    drive_start: IntArray
    drive: NDArray[np.int32]
    first_seen_ns: IntArray
    last_seen_ns: IntArray
    drive_ids: tuple[str, ...]
    left_out: dict[str, int] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.keys)

    @property
    def drives(self) -> NDArray[np.uint16]:
        """(V,) how many drives vote for each voxel; 65535 = that many or more."""
        return np.minimum(np.diff(self.drive_start), np.iinfo(np.uint16).max).astype(np.uint16)

    @property
    def confidence(self) -> NDArray[np.float32]:
        """(V,) share of the votes that the label has, 0 to 1."""
        total = self.votes.sum(axis=1)
        own = self.votes[np.arange(len(self)), self.label]
        return np.asarray(own / np.where(total > 0, total, 1), np.float32)

    def class_counts(self) -> IntArray:
        """(19,) voxels of each class."""
        return np.bincount(self.label, minlength=CLASS_COUNT)

    def take(self, rows: IntArray | NDArray[np.bool_]) -> "VoxelMap":
        """The voxels of these rows; `left_out` and `drive_ids` stay the whole map's."""
        rows = np.arange(len(self))[rows]
        length = self.drive_start[rows + 1] - self.drive_start[rows]
        start = np.concatenate([[0], np.cumsum(length)])
        place = np.repeat(self.drive_start[rows] - start[:-1], length) + np.arange(start[-1])
        return VoxelMap(
            self.frame,
            self.voxel_m,
            self.keys[rows],
            self.points_enu[rows],
            self.grey[rows],
            self.sigma_m[rows],
            self.votes[rows],
            self.label[rows],
            self.count[rows],
            start,
            self.drive[place],
            self.first_seen_ns[rows],
            self.last_seen_ns[rows],
            self.drive_ids,
            self.left_out,
        )


def joined_maps(maps: Sequence[VoxelMap], frame: MapFrame | None, voxel_m: float) -> VoxelMap:
    """One map of maps of one grid that share no voxel, whatever their order; `left_out` is summed."""
    drive_ids = tuple(sorted({name for part in maps for name in part.drive_ids}))
    row_of = {name: row for row, name in enumerate(drive_ids)}
    drive = [np.array([row_of[name] for name in part.drive_ids], np.int32)[part.drive] for part in maps if len(part.drive)]
    left_out: dict[str, int] = {}
    for part in maps:
        for reason, count in part.left_out.items():
            left_out[reason] = left_out.get(reason, 0) + count
    joined = VoxelMap(
        frame,
        voxel_m,
        np.concatenate([np.zeros((0, 3), np.int32), *(part.keys for part in maps)]),
        np.concatenate([np.zeros((0, 3)), *(part.points_enu for part in maps)]),
        np.concatenate([np.zeros(0, np.uint8), *(part.grey for part in maps)]),
        np.concatenate([np.zeros(0, np.float32), *(part.sigma_m for part in maps)]),
        np.concatenate([np.zeros((0, CLASS_COUNT), np.float32), *(part.votes for part in maps)]),
        np.concatenate([np.zeros(0, np.uint8), *(part.label for part in maps)]),
        np.concatenate([np.zeros(0, np.uint32), *(part.count for part in maps)]),
        np.concatenate([[0], np.cumsum(np.concatenate([np.zeros(0, np.int64), *(np.diff(p.drive_start) for p in maps)]))]),
        np.concatenate([np.zeros(0, np.int32), *drive]),
        np.concatenate([np.zeros(0, np.int64), *(part.first_seen_ns for part in maps)]),
        np.concatenate([np.zeros(0, np.int64), *(part.last_seen_ns for part in maps)]),
        drive_ids,
        dict(sorted(left_out.items())),
    )
    return joined.take(np.lexsort(joined.keys.T[::-1]))
