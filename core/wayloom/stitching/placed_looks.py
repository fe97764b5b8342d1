"""Looks of one submap where the submap lies in the map."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayloom.dense.types import Looks
from wayloom.stitching.points import point_covariance
from wayloom.submaps.submap import PlacedSubmap

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PlacedLooks:
    """N looks.

    drive_id   the drive that looked; digest of the submap that holds its keyframes
    looks      what was seen
    T_map_cam  (N, 4, 4)
    variance   (N,) m^2: trace of the covariance that the submap's pose gives the camera's position
    t_ns       (N,) int64 of the keyframe's image
    """

    drive_id: str
    digest: str
    looks: Looks
    T_map_cam: FloatArray
    variance: FloatArray
    t_ns: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.t_ns)


def place_looks(item: PlacedSubmap, looks: Looks) -> PlacedLooks:
    """Those of a drive's looks whose keyframes the submap holds, where it lies."""
    submap = item.submap
    _, of_look, of_submap = np.intersect1d(looks.frame, submap.keyframe_frame, assume_unique=True, return_indices=True)
    T = item.T_enu_submap @ submap.T_submap_cam[of_submap]
    covariance = point_covariance(T[:, :3, 3], item.covariance)
    variance = np.trace(covariance, axis1=1, axis2=2)
    return PlacedLooks(item.drive_id, submap.digest, looks.take(of_look), T, variance, submap.keyframe_t_ns[of_submap])


def canonical_looks(placed: Iterable[PlacedLooks], low: FloatArray, high: FloatArray, see_m: float) -> list[PlacedLooks]:
    """The looks of each submap once, by drive and digest, those whose camera lies within `see_m` of a box (2,) to (2,), m."""
    by_name = {(item.drive_id, item.digest): item for item in placed}
    near = (_within(by_name[name], low - see_m, high + see_m) for name in sorted(by_name))
    return [item for item in near if len(item)]


def _within(item: PlacedLooks, low: FloatArray, high: FloatArray) -> PlacedLooks:
    places = item.T_map_cam[:, :2, 3]
    rows = np.flatnonzero(((places >= low) & (places < high)).all(axis=1))
    looks = item.looks.take(rows)
    return PlacedLooks(item.drive_id, item.digest, looks, item.T_map_cam[rows], item.variance[rows], item.t_ns[rows])
