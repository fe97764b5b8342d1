"""Grouping of sightings that are of one object: greedy, from the surest on, at most one of each submap."""

from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from wayloom.objects.placed import AllSightings
from wayloom.objects.settings import ObjectFusionSettings
from wayloom.objects.types import KINDS, LIGHT, POLE, SIGN, STANDING, TRUNK

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
NEAR_M: Final = 0.35
"""Things of two kinds that lie nearer may be taken for each other."""
NEAR_OF_KIND_M: Final = {POLE: 0.35, SIGN: 0.35, LIGHT: 0.6, TRUNK: 0.35}
"""Sightings of one kind that lie nearer are of one object, whatever their sigmas say: of a light's head, 1 m tall, different sides
are seen."""
SLACK_M: Final = 0.05
"""Sigma of what two drives call the middle of one thing."""


def groups(seen: AllSightings, settings: ObjectFusionSettings) -> Iterator[IntArray]:
    """Rows of the sightings of each object, by kind, then from the surest seed on; each row is in one group."""
    total = seen.total
    trace = np.trace(total, axis1=1, axis2=2)
    for kind in range(len(KINDS)):
        rows = np.flatnonzero(seen.kind == kind)
        axes = slice(0, 2) if kind in STANDING else slice(0, 3)
        yield from _of_one_kind(rows[np.argsort(trace[rows], kind="stable")], axes, NEAR_OF_KIND_M[kind], seen, total, settings)


def _of_one_kind(
    order: IntArray, axes: slice, near_m: float, seen: AllSightings, total: FloatArray, settings: ObjectFusionSettings
) -> Iterator[IntArray]:
    if not len(order):
        return
    places, covariance = seen.position[order][:, axes], total[order][:, axes, axes] + SLACK_M**2 * np.eye(len(range(3)[axes]))
    tree, taken = cKDTree(places), np.zeros(len(order), bool)
    reach = max(settings.radius_m, near_m)
    for seed in range(len(order)):
        if taken[seed]:
            continue
        middle, own = places[seed], covariance[seed]
        members = np.array([seed])
        for _ in range(2):
            near = np.array(sorted(tree.query_ball_point(middle, reach)), np.int64)
            near = np.union1d(near[~taken[near]], [seed])
            away = places[near] - middle
            d2 = np.einsum("ni,ni->n", away, np.linalg.solve(covariance[near] + own, away[..., None])[..., 0])
            distance = np.linalg.norm(away, axis=1)
            fits = (distance <= near_m) | (d2 <= settings.sigmas**2) | (near == seed)
            members = _one_of_each_submap(near[fits], np.where(near == seed, -1.0, d2)[fits], seen.source[order])
            information = np.linalg.inv(covariance[members])
            own = np.linalg.inv(information.sum(axis=0))
            middle = own @ np.einsum("nij,nj->i", information, places[members])
        taken[members] = True
        yield np.sort(order[members])


def _one_of_each_submap(rows: IntArray, d2: FloatArray, source: IntArray) -> IntArray:
    """Of the rows of each submap the one with the least d2."""
    ranked = rows[np.lexsort((rows, d2))]
    _, first = np.unique(source[ranked], return_index=True)
    return np.sort(ranked[first])
