"""Tracks: measurements of several keyframes that show one thing, gathered from the surest on."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from wayloom.objects.measurements import Measurements
from wayloom.objects.triangulation import Cameras, first_points, information, triangulate
from wayloom.objects.types import KINDS, STANDING

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
REACH_M: Final = 1.5
"""Measurements further from a thing are not its."""
NEAR_M: Final = 0.25
SIGMAS: Final = 3.0
DOUBLE_M: Final = 0.4
"""Tracks of one kind that come to lie nearer are one."""
LARGEST_OFF: Final = 3.5
"""Sigmas: a measurement further off the place of all is not kept."""


@dataclass(frozen=True, slots=True)
class Track:
    """Rows of measurements of one thing, its place (3,) m and covariance (3, 3) m^2, level frame."""

    kind: int
    rows: IntArray
    place: FloatArray
    covariance: FloatArray


def tracks_of(seen: Measurements, cameras: Cameras, least_looks: int) -> list[Track]:
    """The tracks of all kinds with at least so many views."""
    points = first_points(cameras, seen)
    covariance: FloatArray = np.linalg.inv(information(cameras, seen, points) + 1e-6 * np.eye(3)).astype(np.float64)
    out: list[Track] = []
    for kind in range(len(KINDS)):
        rows = np.flatnonzero(seen.kind == kind)
        if len(rows):
            axes = 2 if kind in STANDING else 3
            out += _of_kind(kind, rows, points[:, :axes], covariance[:, :axes, :axes], seen, cameras, least_looks)
    return out


def _of_kind(
    kind: int, rows: IntArray, points: FloatArray, covariance: FloatArray, seen: Measurements, cameras: Cameras, least: int
) -> list[Track]:
    order = rows[np.argsort(np.trace(covariance[rows], axis1=1, axis2=2), kind="stable")]
    tree, free = cKDTree(points[order]), np.ones(len(order), bool)
    heights = first_points(cameras, seen.take(order))[:, 2]
    out: list[Track] = []
    for seed in range(len(order)):
        if not free[seed]:
            continue
        own, middle = covariance[order[seed]], points[order[seed]]
        place, members = np.append(middle, heights[seed])[:3], np.array([seed])
        for _ in range(3):
            near = np.array(sorted(tree.query_ball_point(middle, REACH_M)), np.int64)
            near = near[free[near]]
            away = points[order[near]] - middle
            d2 = np.einsum("ni,ni->n", away, np.linalg.solve(covariance[order[near]] + own, away[..., None])[..., 0])
            fits = (d2 <= SIGMAS**2) | (np.linalg.norm(away, axis=1) < NEAR_M)
            members = _one_of_each_view(near[fits], d2[fits], seen.view[order])
            if not len(members):
                break
            place, full, off = triangulate(cameras, seen.take(order[members]), place)
            members = members[off < LARGEST_OFF]
            own, middle = full[: len(middle), : len(middle)], place[: len(middle)]
        free[members] = False
        free[seed] = False
        if len(members) >= least:
            place, full, _ = triangulate(cameras, seen.take(order[members]), place)
            out.append(Track(kind, np.sort(order[members]), place, full))
    return _without_doubles(out)


def _one_of_each_view(rows: IntArray, d2: FloatArray, view: IntArray) -> IntArray:
    """Of the rows of each view the one with the least d2."""
    ranked = rows[np.lexsort((rows, d2))]
    _, first = np.unique(view[ranked], return_index=True)
    return np.sort(ranked[first])


def _without_doubles(tracks: list[Track]) -> list[Track]:
    """Of tracks that lie within DOUBLE_M the one with the most views."""
    kept: list[Track] = []
    for one in sorted(tracks, key=lambda track: (-len(track.rows), *track.place)):
        axes = 2 if one.kind in STANDING else 3
        if all(np.linalg.norm((one.place - other.place)[:axes]) >= DOUBLE_M for other in kept):
            kept.append(one)
    return kept
