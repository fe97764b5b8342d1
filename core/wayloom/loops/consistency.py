"""Pairwise consistent sets of closures (Mangelson et al. 2018), greedily: every accepted closure agrees with all of its set."""

import numpy as np
from numpy.typing import NDArray

from wayloom.loops.priors import Closure, cycle_chi2, is_sure, is_unplaced
from wayloom.loops.settings import LoopSettings

FloatArray = NDArray[np.float64]
RIVAL_SHARE = 0.5
"""A set stands against one that denies it where that has less than this share of its closures."""


def consistent(closures: list[Closure], T_world_cam: FloatArray, road: FloatArray, settings: LoopSettings) -> NDArray[np.bool_]:
    """(L,) which closures belong to a set of at least `least_agreeing` neighbours that all agree with each other, or with one that
    is sure (`wayloom.loops.priors.is_sure`).

    Where two sets deny each other, the smaller one goes, and both where it is not much smaller.
    """
    chi2 = cycles(closures, T_world_cam, road, settings)
    sets = [
        members
        for members in agreeing_sets(closures, road, chi2, settings)
        if is_enough([closures[row] for row in members], T_world_cam, road, settings)
    ]
    second = np.array([road[c.second] for c in closures])
    accepted = np.zeros(len(closures), bool)
    for members in sets:
        rivals = [other for other in sets if other is not members and _deny(members, other, second, chi2, settings)]
        if all(RIVAL_SHARE * len(members) > len(rival) for rival in rivals):
            accepted[members] = True
    return accepted


def is_enough(members: list[Closure], T_world_cam: FloatArray, road: FloatArray, settings: LoopSettings) -> bool:
    """Whether a set of closures that agree is believed: where the odometry knows the place, many are enough, or one that is sure;
    where it does not, there must be many, and features alone must know one."""
    many = len(members) >= settings.least_agreeing
    if is_unplaced(members[0], road, settings):
        return many and any(closure.alone for closure in members)
    return many or any(is_sure(closure, T_world_cam, road, settings) for closure in members)


def agreeing_sets(closures: list[Closure], road: FloatArray, chi2: FloatArray, settings: LoopSettings) -> list[list[int]]:
    """Disjoint sets of neighbours that all agree, grown from the closures that agree with most; of equal ones the first."""
    agree = neighbours(closures, road, settings) & (chi2 <= settings.max_cycle_chi2)
    left, sets = np.ones(len(closures), bool), []
    while left.any():
        degree = np.where(left, (agree & left[None, :]).sum(axis=1), -1)
        members = [int(np.argmax(degree))]
        open_to = agree[members[0]] & left
        open_to[members[0]] = False
        while open_to.any():
            inside = np.where(open_to, (agree & open_to[None, :]).sum(axis=1), -1)
            members.append(int(np.argmax(inside)))
            open_to &= agree[members[-1]]
            open_to[members[-1]] = False
        left[members] = False
        sets.append(members)
    return sets


def _deny(one: list[int], other: list[int], second: FloatArray, chi2: FloatArray, settings: LoopSettings) -> bool:
    """Whether closures of the two sets put the same part of the road at different places."""
    beside = np.abs(second[one][:, None] - second[other][None, :]) <= settings.agreeing_road_m
    return bool((beside & (chi2[np.ix_(one, other)] > settings.max_cycle_chi2)).any())


def neighbours(closures: list[Closure], road: FloatArray, settings: LoopSettings) -> NDArray[np.bool_]:
    """(L, L) whether two closures are near each other along the road at both ends."""
    ends = np.array([[road[c.first], road[c.second]] for c in closures]).reshape(-1, 2)
    return np.asarray((np.abs(ends[:, None] - ends[None, :]) <= settings.agreeing_road_m).all(axis=2))


def cycles(closures: list[Closure], T_world_cam: FloatArray, road: FloatArray, settings: LoopSettings) -> FloatArray:
    """(L, L) chi-square of the cycle of each two closures whose second ends are near each other; 0 for all others."""
    out = np.zeros((len(closures), len(closures)))
    for p, one in enumerate(closures):
        for q in range(p + 1, len(closures)):
            other = closures[q]
            if abs(road[one.second] - road[other.second]) <= settings.agreeing_road_m:
                out[p, q] = out[q, p] = cycle_chi2(one, other, T_world_cam, road, settings)
    return out
