"""Sections of a drive's road with the points seen from them, in a nearly level frame of their own."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.georeference.first_guess import level_world
from wayloom.georeference.nodes import travelled
from wayloom.odometry.types import POINTS_AT_ONCE, OdometryResult, Points

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
MAX_SIGMA_SHARE, MAX_DISTANCE_M = 0.05, 30.0
"""Points whose depth is worse, or that are further from their host, say nothing of walls."""


@dataclass(frozen=True, slots=True)
class Section:
    """A piece of road.

    keyframe       row of the one in its middle
    T_level_cam    (4, 4) of that keyframe: first axis right of the road, second ahead, third up, as level as the cameras are
    points_level   (n, 3) m, label (n,)
    """

    keyframe: int
    T_level_cam: FloatArray
    points_level: FloatArray
    label: NDArray[np.uint8]


def sections(odometry: OdometryResult, label: NDArray[np.uint8], length_m: float) -> Iterator[Section]:
    """Each segment of the track in pieces of about length_m; label (P,) of the odometry's points."""
    keyframes, points = odometry.keyframes, odometry.points
    road = travelled(odometry.trajectory)[keyframes.frame]
    good = np.concatenate([np.zeros(0, np.int64), *_good_rows(points)])
    by_host = good[np.argsort(points.host[good], kind="stable")]
    host = points.host[by_host]
    for segment in np.unique(keyframes.segment):
        members = np.flatnonzero(keyframes.segment == segment)
        piece = ((road[members] - road[members[0]]) // length_m).astype(np.int64)
        for number in np.unique(piece):
            rows = members[piece == number]
            middle = int(rows[np.argmin(np.abs(road[rows] - 0.5 * (road[rows[0]] + road[rows[-1]])))])
            inside = np.sort(by_host[slice(*np.searchsorted(host, (rows[0], rows[-1] + 1)).tolist())])
            T_level_world = level_world(keyframes.T_world_cam[rows])
            T_level_cam = T_level_world @ keyframes.T_world_cam[middle]
            yield Section(middle, T_level_cam, se3.transform(T_level_world, odometry.points_world(inside)), label[inside])


def _good_rows(points: Points) -> Iterator[IntArray]:
    """Rows of the points that say something of walls, some at a time."""
    for first in range(0, len(points), POINTS_AT_ONCE):
        some = slice(first, first + POINTS_AT_ONCE)
        d = points.inverse_depth[some].astype(np.float64)
        sigma_share = np.sqrt(points.variance[some].astype(np.float64)) / np.maximum(d, 1e-9)
        yield first + np.flatnonzero((d > 1.0 / MAX_DISTANCE_M) & (sigma_share < MAX_SIGMA_SHARE))
