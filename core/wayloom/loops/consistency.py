"""Pairwise consistent sets of closures (Mangelson et al. 2018), greedily: every accepted closure agrees with all of its set."""

import numpy as np
from numpy.typing import NDArray

from wayloom.loops.priors import Closure, cycle_chi2
from wayloom.loops.settings import LoopSettings

FloatArray = NDArray[np.float64]


def consistent(
    closures: list[Closure], T_world_cam: FloatArray, road: FloatArray, settings: LoopSettings
) -> NDArray[np.bool_]:
    """(L,) which closures belong to a set of at least `least_agreeing` neighbours that all agree with each other.

    Sets grow from the closures with the most agreeing neighbours; of equal ones the first.
    """
    agree = agreement(closures, T_world_cam, road, settings)
    accepted, left = np.zeros(len(closures), bool), np.ones(len(closures), bool)
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
        if len(members) >= settings.least_agreeing:
            accepted[members] = True
    return accepted


def agreement(
    closures: list[Closure], T_world_cam: FloatArray, road: FloatArray, settings: LoopSettings
) -> NDArray[np.bool_]:
    """(L, L) whether two closures are neighbours, at both ends, and the cycle that they make closes."""
    out = np.eye(len(closures), dtype=bool)
    for p, one in enumerate(closures):
        for q in range(p + 1, len(closures)):
            other = closures[q]
            apart = max(abs(road[one.first] - road[other.first]), abs(road[one.second] - road[other.second]))
            if apart <= settings.agreeing_road_m:
                out[p, q] = out[q, p] = cycle_chi2(one, other, T_world_cam, road, settings) <= settings.max_cycle_chi2
    return out
