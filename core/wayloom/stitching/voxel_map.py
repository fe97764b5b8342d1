"""Voxel map: the static layer of the map on a regular grid in the map's frame."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_COUNT
from wayloom.geodesy.map_frame import MapFrame

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class VoxelMap:
    """V voxels, sorted by the east, then the north, then the up part of their keys.

    frame         the map's frame; None: a drive's own
    voxel_m       edge, m
    keys          (V, 3) int32: floor(enu / voxel_m)
    points_enu    (V, 3) m, mean of the points, weighted by inverse variance
    votes         (V, 19) float32, 1/m: sum of the votes of all drives
    label         (V,) uint8, the static class with the most votes, the lower on a tie
    count         (V,) uint32 points; drives (V,) uint16 distinct drives, 65535 = that many or more; last_seen_ns (V,) int64
    left_out      how many points are not in the static layer, by reason
    """

    frame: MapFrame | None
    voxel_m: float
    keys: NDArray[np.int32]
    points_enu: FloatArray
    votes: NDArray[np.float32]
    label: NDArray[np.uint8]
    count: NDArray[np.uint32]
    drives: NDArray[np.uint16]
    last_seen_ns: NDArray[np.int64]
    left_out: dict[str, int] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.keys)

    @property
    def confidence(self) -> NDArray[np.float32]:
        """(V,) share of the votes that the label has, 0 to 1."""
        total = self.votes.sum(axis=1)
        own = self.votes[np.arange(len(self)), self.label]
        return np.asarray(own / np.where(total > 0, total, 1), np.float32)

    def class_counts(self) -> NDArray[np.int64]:
        """(19,) voxels of each class."""
        return np.bincount(self.label, minlength=CLASS_COUNT)

    def take(self, rows: NDArray[np.int64] | NDArray[np.bool_]) -> "VoxelMap":
        """The voxels of these rows; `left_out` stays the whole map's."""
        return VoxelMap(
            self.frame,
            self.voxel_m,
            self.keys[rows],
            self.points_enu[rows],
            self.votes[rows],
            self.label[rows],
            self.count[rows],
            self.drives[rows],
            self.last_seen_ns[rows],
            self.left_out,
        )


def joined_maps(parts: Sequence[VoxelMap], frame: MapFrame | None, voxel_m: float) -> VoxelMap:
    """Maps of one frame that share no voxel, one behind the other."""
    dtypes = {
        "keys": np.int32, "points_enu": np.float64, "votes": np.float32, "label": np.uint8, "count": np.uint32, "drives": np.uint16,
        "last_seen_ns": np.int64,
    }  # fmt: skip
    widths = {"keys": (3,), "points_enu": (3,), "votes": (CLASS_COUNT,)}
    empty = {name: np.zeros((0, *widths.get(name, ())), dtype) for name, dtype in dtypes.items()}
    arrays = {name: np.concatenate([none, *(getattr(part, name) for part in parts)]) for name, none in empty.items()}
    return map_of_arrays(frame, voxel_m, arrays)


def map_of_arrays(frame: MapFrame | None, voxel_m: float, arrays: Mapping[str, NDArray[Any]]) -> VoxelMap:
    """The map of arrays by their names."""
    held: dict[str, Any] = dict(arrays)
    return VoxelMap(frame, voxel_m, **held)
