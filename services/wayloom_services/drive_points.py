"""Poses and points of a drive as they are handed out: where the newest version has them, one submap in memory at a time."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import PERSONS
from wayloom.errors import NotFoundError
from wayloom.exports.ply import VERTEX, ply_blocks
from wayloom.exports.points import PointBatch, batch_of_submap
from wayloom.files.trajectory_files import tum_text
from wayloom.geodesy.map_frame import MapFrame
from wayloom.store.blobs import BlobStore
from wayloom.store.tables.drives import SubmapRow
from wayloom.submaps.submap import PlacedSubmap, decode_submap


@dataclass(frozen=True)
class DrivePoints:
    """rows : the drive's submaps, in the order of the road; at least one"""

    blobs: BlobStore
    rows: Sequence[SubmapRow]

    @property
    def frame(self) -> MapFrame | None:
        """The map's frame; None where the drive has no place on Earth."""
        return _frame(self.rows[0])

    def trajectory(self) -> bytes:
        """The keyframes' poses as TUM. Raises NotFoundError where a blob is gone."""
        t_ns, T, _ = self._passed_through
        return tum_text(t_ns, T)

    def cloud(self) -> tuple[int, Iterator[bytes]]:
        """How many bytes of PLY the points without persons are, and these bytes, submap by submap. Raises NotFoundError where a
        blob is gone: before the first byte, since the header needs the number of points."""
        _, _, count = self._passed_through
        place = np.array(self.rows[0].T_enu_submap, np.float64)[:3, 3]
        blocks = ply_blocks(map(without_persons, self._placed()), count, place, self.frame)
        header = next(blocks)
        return len(header) + count * VERTEX.itemsize, chain([header], blocks)

    @cached_property
    def _passed_through(self) -> tuple[NDArray[np.int64], NDArray[np.float64], int]:
        """Times (K,) ns and poses (K, 4, 4) of the keyframes, and how many points there are without persons, by one pass."""
        t_ns, T, count = [], [], 0
        for one in self._placed():
            t_ns.append(one.submap.keyframe_t_ns.copy())  # a view would hold the submap
            T.append(one.T_enu_submap @ one.submap.T_submap_cam)
            count += len(without_persons(one))
        times, first = np.unique(np.concatenate(t_ns), return_index=True)  # neighbours share the keyframe at which they meet
        return times, np.concatenate(T)[first], count

    def _placed(self) -> Iterator[PlacedSubmap]:
        return (placed_submap(self.blobs, row) for row in self.rows)


def check_blobs(blobs: BlobStore, digests: Iterable[str]) -> None:
    """Raises NotFoundError where one is gone: what has begun to be sent can say so only by breaking off."""
    for digest in digests:
        if not blobs.has(digest):
            raise NotFoundError(f"blob {digest} of this drive is not in the store")


def placed_submap(blobs: BlobStore, row: SubmapRow) -> PlacedSubmap:
    """A row with its points, where the newest version has it."""
    T = np.array(row.T_enu_submap, np.float64)
    return PlacedSubmap(decode_submap(blobs.get(row.digest), row.digest), T, np.full((6, 6), np.nan), row.drive_id, _frame(row))


def without_persons(placed: PlacedSubmap) -> PointBatch:
    """The points of a submap that no person is among."""
    batch = batch_of_submap(placed)
    return batch.take(~np.isin(batch.label, PERSONS))


def _frame(row: SubmapRow) -> MapFrame | None:
    return None if row.frame is None else MapFrame(*row.frame)
