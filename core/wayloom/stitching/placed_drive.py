"""Placed drive: a drive's places with the submaps that its keyframes belong to, and its keyframes' poses in the map."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import StageError
from wayloom.geometry import se3
from wayloom.places.road import road_m, spaced
from wayloom.places.types import Places
from wayloom.places.views import LOOK_AHEAD_M
from wayloom.submaps.submap import PlacedSubmap

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class PlacedDrive:
    """One drive as its own stages left it: K keyframes, S submaps in the order of the road.

    Raises StageError where places and submaps are of different runs.
    """

    drive_id: str
    places: Places
    submaps: tuple[PlacedSubmap, ...]

    def __post_init__(self) -> None:
        held = sum(len(item.submap.keyframe_frame) for item in self.submaps)
        if held != len(self.places):
            raise StageError(
                f"drive {self.drive_id}: its submaps hold {held} keyframes, its places {len(self.places)}; run the stages places "
                "and submaps again"
            )

    @property
    def is_located(self) -> bool:
        """Whether its GNSS puts it into the map's frame."""
        return bool(self.submaps) and self.submaps[0].frame is not None

    @cached_property
    def submap_of(self) -> IntArray:
        """(K,) the submap of each keyframe."""
        return np.concatenate([np.full(n, s, np.int64) for s, n in enumerate(self._lengths)])[self._order]

    @cached_property
    def T_submap_cam(self) -> FloatArray:
        """(K, 4, 4) of each keyframe's camera in its submap."""
        return np.concatenate([item.submap.T_submap_cam for item in self.submaps])[self._order]

    @cached_property
    def bend(self) -> FloatArray:
        """(K, 6) sigmas by which the drive's graph has each keyframe elsewhere in its submap; 0 where that is not told."""
        told = [np.zeros((n, 6)) if item.bend is None else item.bend for item, n in zip(self.submaps, self._lengths, strict=True)]
        return np.concatenate(told)[self._order]

    @cached_property
    def T_enu_cam(self) -> FloatArray:
        """(K, 4, 4) by the drive's own geo-reference."""
        return np.concatenate([item.T_enu_submap @ item.submap.T_submap_cam for item in self.submaps])[self._order]

    @cached_property
    def road(self) -> FloatArray:
        """(K,) m of road by the odometry."""
        return road_m(self.places.T_world_keyframe)

    @cached_property
    def middle(self) -> IntArray:
        """(K,) the keyframe in the middle of each one's view: of its segment that nearest to LOOK_AHEAD_M ahead."""
        out = np.empty(len(self.places), np.int64)
        for segment in np.unique(self.places.segment):
            rows = np.flatnonzero(self.places.segment == segment)
            ahead = np.abs(self.road[rows][None, :] - self.road[rows][:, None] - LOOK_AHEAD_M)
            out[rows] = rows[np.argmin(ahead, axis=1)]
        return out

    def covariance(self, keyframe: int) -> FloatArray:
        """(6, 6) of the left perturbation of T_enu_cam[keyframe]."""
        return self.submaps[int(self.submap_of[keyframe])].covariance

    def anchors(self, spacing_m: float) -> IntArray:
        """Keyframes so far apart along the road."""
        return np.flatnonzero(spaced(self.road, self.places.segment, spacing_m))

    def between(self, i: int, j: int) -> FloatArray:
        """T_i_j (4, 4) of two keyframes of one segment, by the odometry."""
        T = self.places.T_world_keyframe
        out: FloatArray = se3.inverse(T[i]) @ T[j]
        return out

    @cached_property
    def _lengths(self) -> list[int]:
        return [len(item.submap.keyframe_frame) for item in self.submaps]

    @cached_property
    def _order(self) -> IntArray:
        """Rows of the submaps' keyframes, one submap behind the other, in the order of time."""
        return np.argsort(np.concatenate([item.submap.keyframe_frame for item in self.submaps]), kind="stable")
