"""Points of an export: what every cloud format tells of each, in batches of one region or one submap."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.config.progress import Progress, silent
from wayloom.exports.boxes import inside
from wayloom.geodesy import wgs84
from wayloom.geodesy.antimeridian import Box
from wayloom.geodesy.map_frame import MapFrame
from wayloom.submaps.submap import PlacedSubmap

if TYPE_CHECKING:  # one drive's points are written without what makes maps
    from wayloom.exports.source import MapSource
    from wayloom.stitching.voxel_map import VoxelMap

FloatArray = NDArray[np.float64]
ALL_VOTES: Final = 255
MOST_DRIVES: Final = 65_535


@dataclass(frozen=True, slots=True)
class PointBatch:
    """N points.

    points      (N, 3) m in the source's frame
    label       (N,) uint8 train id, 255 void; grey (N,) uint8 in the images
    sigma_m     (N,) float32 of the position
    confidence  (N,) uint8 share of the votes that the label has, 255: all, or nobody voted
    drives      (N,) uint16 drives that vote for it
    first_ns, seen_ns  (N,) int64 when they were first and last seen, ns since 1970
    """

    points: FloatArray
    label: NDArray[np.uint8]
    grey: NDArray[np.uint8]
    sigma_m: NDArray[np.float32]
    confidence: NDArray[np.uint8]
    drives: NDArray[np.uint16]
    first_ns: NDArray[np.int64]
    seen_ns: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.points)

    def take(self, rows: NDArray[np.bool_] | NDArray[np.int64]) -> "PointBatch":
        """The points of these rows."""
        return PointBatch(*(getattr(self, one.name)[rows] for one in fields(self)))


def batch_of_voxels(voxels: "VoxelMap") -> PointBatch:
    """One point a voxel."""
    confidence = np.rint(ALL_VOTES * voxels.confidence).astype(np.uint8)
    return PointBatch(
        voxels.points_enu, voxels.label, voxels.grey, voxels.sigma_m, confidence, voxels.drives, voxels.first_seen_ns,
        voxels.last_seen_ns,
    )  # fmt: skip


def batch_of_submap(item: PlacedSubmap) -> PointBatch:
    """The points of one submap as its drive saw them."""
    submap = item.submap
    start = submap.vote_start.astype(np.int64)
    of_point = np.repeat(np.arange(len(submap)), np.diff(start))
    total = np.bincount(of_point, submap.vote_weight, len(submap))
    own = np.bincount(of_point, np.where(submap.vote_class == submap.label[of_point], submap.vote_weight, 0.0), len(submap))
    confidence = np.where(total > 0.0, np.rint(ALL_VOTES * own / np.where(total > 0.0, total, 1.0)), ALL_VOTES).astype(np.uint8)
    sigma = np.sqrt(submap.variance)
    drives = np.ones(len(submap), np.uint16)
    return PointBatch(
        item.points_enu(), submap.label, submap.grey, sigma, confidence, drives, submap.seen_ns, submap.seen_ns
    )  # fmt: skip


_DTYPES: Final = {
    "points": np.float64, "label": np.uint8, "grey": np.uint8, "sigma_m": np.float32, "confidence": np.uint8, "drives": np.uint16,
    "first_ns": np.int64, "seen_ns": np.int64,
}  # fmt: skip


def joined_batches(batches: Sequence[PointBatch]) -> PointBatch:
    """All points of some batches, in their order."""
    columns: list[Any] = [
        np.concatenate(
            [np.zeros((0, 3) if one.name == "points" else 0, _DTYPES[one.name]), *(getattr(b, one.name) for b in batches)]
        )
        for one in fields(PointBatch)
    ]
    return PointBatch(*columns)


def map_batches(source: "MapSource", box: Box | None, progress: Progress = silent) -> Iterator[PointBatch]:
    """The static voxels of a map, region by region, cut to the box."""
    for number, key in enumerate(source.keys):
        voxels = source.voxels(key)
        if voxels is not None and len(voxels):
            batch = cut(batch_of_voxels(voxels), source.frame, box)
            if len(batch):
                yield batch
        progress((number + 1) / len(source.keys), f"region {number + 1} of {len(source.keys)}")


def cut(batch: PointBatch, frame: MapFrame | None, box: Box | None) -> PointBatch:
    """The points within the box."""
    if box is None or frame is None:
        return batch
    return batch.take(inside(wgs84.lonlatheight_from_enu(batch.points, frame), box))


def together(batches: Iterable[PointBatch], count: int) -> Iterator[PointBatch]:
    """The same points in batches of at least so many, but for the last."""
    held: list[PointBatch] = []
    for batch in batches:
        held.append(batch)
        if sum(map(len, held)) >= count:
            yield joined_batches(held)
            held = []
    if held:
        yield joined_batches(held)
