"""Agreement of pairs of views: neighbours must agree by way of both odometries, and sets that deny each other go."""

from collections import Counter

import numpy as np
from numpy.typing import NDArray

from wayloom.loops.consistency import consistent
from wayloom.loops.priors import Closure, cycle_chi2
from wayloom.stitching.view_pairs import PairSearch

FloatArray = NDArray[np.float64]
RIVAL_SHARE = 0.5
"""A drive whose place is not known lies where most pairs put it, unless others with more than this share of them deny it."""


def agreeing(search: PairSearch, least: int) -> tuple[list[Closure], dict[str, int]]:
    """The pairs that belong to a set of at least `least` neighbours that agree, and why others were refused, with their number.

    Segments of an odometry lie apart, so that pairs of different ones say nothing of each other.
    """
    settings = search.settings.loops.model_copy(update={"least_agreeing": least})
    kept: list[Closure] = []
    for pairs in by_segments(search, search.found).values():
        is_kept = consistent(pairs, search.T_world_cam, search.road, settings)
        kept += [pair for pair, good in zip(pairs, is_kept, strict=True) if good]
    lost = len(search.found) - len(kept)
    words = f"fewer than {least} neighbours agree, or as many deny it" if least > 1 else "as many neighbours deny it"
    return kept, ({words: lost} if lost else {})


def by_segments(search: PairSearch, pairs: list[Closure]) -> dict[tuple[int, int], list[Closure]]:
    """The pairs by the segments of both odometries."""
    a, b = search.a, search.b
    out: dict[tuple[int, int], list[Closure]] = {}
    for pair in pairs:
        key = int(a.places.segment[pair.first]), int(b.places.segment[pair.second - len(a.places)])
        out.setdefault(key, []).append(pair)
    return out


def one_place(search: PairSearch, pairs: list[Closure]) -> tuple[list[Closure], dict[str, int]]:
    """Of pairs that say where b lies in a the largest set of which all agree; none where another set is more than half as large.

    For drives without a place of their own: streets that look alike put them at several.
    """
    kept: list[Closure] = []
    words: Counter[str] = Counter()
    for members in by_segments(search, pairs).values():
        first, *others = sets_of_one_place(search, members)
        if others and len(others[0]) > RIVAL_SHARE * len(first):
            words["two places fit nearly as well"] += len(members)
        else:
            kept += first
            words["most others put the drive elsewhere"] += len(members) - len(first)
    return kept, {text: count for text, count in words.items() if count}


def sets_of_one_place(search: PairSearch, pairs: list[Closure]) -> list[list[Closure]]:
    """Disjoint sets of pairs, each of those that agree with one of them, the largest first."""
    left, sets = list(pairs), []
    while left:
        chosen = max((agreeing_with(search, pair, left) for pair in left), key=len)
        sets.append(chosen)
        left = [pair for pair in left if not any(pair is other for other in chosen)]
    return sets


def agreeing_with(search: PairSearch, pair: Closure, others: list[Closure]) -> list[Closure]:
    """Of the others those whose cycle with the pair closes."""
    limit = search.settings.loops.max_cycle_chi2
    return [
        other
        for other in others
        if other is pair or cycle_chi2(pair, other, search.T_world_cam, search.road, search.settings.loops) <= limit
    ]
