"""Stereo matching of rectangles: sum of squared differences without their mean, with its sigma by what is left."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

UInt8 = NDArray[np.uint8]
Int32 = NDArray[np.int32]

UNMATCHED = np.nan
NOISE2 = 9.0
"""Least variance of a difference of grey values."""


@njit(cache=True)
def match_rectangles(left, right, rectangles, start, most, uniqueness, found):  # type: ignore[no-untyped-def]
    """Disparity and sigma px of groups of rectangles (n, 4) u0, v0, u1, v1 (ends left out) of left (h, w) uint8 in right.

    start       (g + 1,) first rectangle of each group: those of one group have one disparity
    most        disparities up to this are searched
    uniqueness  share of the second best's cost that the best must stay under, but for its neighbours
    found       (g, 2) is filled: disparity and sigma; NaN without a sure match
    """
    height, width = left.shape
    cost, square = np.empty(most + 1), np.empty(most + 1, np.int64)
    total, of_row = np.empty(most + 1, np.int32), np.empty(most + 1, np.int32)
    for g in range(len(start) - 1):
        found[g, 0] = found[g, 1] = UNMATCHED
        last, count, slope2 = most, 0, 0.0
        for k in range(start[g], start[g + 1]):
            last = min(last, max(rectangles[k, 0], 1))
        if last < 2:
            continue
        cost[: last + 1] = 0.0
        for k in range(start[g], start[g + 1]):
            u0, v0 = max(rectangles[k, 0], 1), max(rectangles[k, 1], 0)
            u1, v1 = min(rectangles[k, 2], width - 1), min(rectangles[k, 3], height)
            if u1 - u0 < 2 or v1 - v0 < 2:
                continue
            count += (u1 - u0) * (v1 - v0)
            slope2 += _slope2(left, u0, v0, u1, v1)
            end = last + 1
            _add_cost(left, right, u0, v0, u1, v1, cost[:end], total[:end], square[:end], of_row[:end])
        if count > 0 and slope2 > 0.0:
            _best(cost[: last + 1], count, slope2, uniqueness, found[g])


@njit(cache=True)
def _slope2(left, u0, v0, u1, v1):  # type: ignore[no-untyped-def]
    """Sum of the squared slopes along the rows."""
    total = 0
    for v in range(v0, v1):
        for u in range(u0, u1):
            step = int(left[v, u + 1]) - int(left[v, u - 1])
            total += step * step
    return 0.25 * total


@njit(cache=True)
def _add_cost(
    left: UInt8, right: UInt8, u0: int, v0: int, u1: int, v1: int,
    cost: NDArray[np.float64], total: Int32, square: NDArray[np.int64], of_row: Int32,
) -> None:  # fmt: skip
    """Add the squared differences less their mean at each disparity to cost (D,), of which u0 is D - 1 at least.

    total, of_row (D,) int32 and square (D,) int64 are scratch: sums of whole numbers for all disparities of a pixel, the largest
    first, as its pixels lie in the right image. A row's squares fit into 32 bits up to 33,000 pixels.
    """
    count, last = (u1 - u0) * (v1 - v0), len(cost) - 1
    total[:], square[:] = 0, 0
    for v in range(v0, v1):
        of_row[:] = 0
        for u in range(u0, u1):
            here, line = np.int32(left[v, u]), right[v, u - last : u + 1]
            for e in range(last + 1):
                off = here - np.int32(line[e])
                total[e] += off
                of_row[e] += off * off
        for e in range(last + 1):
            square[e] += of_row[e]
    for d in range(last + 1):
        whole = float(total[last - d])
        cost[d] += float(square[last - d]) - whole * whole / count


@njit(cache=True)
def _best(cost, count, slope2, uniqueness, found):  # type: ignore[no-untyped-def]
    """The minimum of a cost curve between its ends, by a parabola, where it is unique."""
    best = int(np.argmin(cost))
    if best < 1 or best >= len(cost) - 1:
        return
    second = np.inf
    for d in range(len(cost)):
        if abs(d - best) > 2 and cost[d] < second:
            second = cost[d]
    noise = NOISE2 * count
    bend = cost[best - 1] + cost[best + 1] - 2.0 * cost[best]
    if cost[best] + noise > uniqueness * (second + noise) or bend <= 0.0:
        return
    found[0] = best + 0.5 * (cost[best - 1] - cost[best + 1]) / bend
    found[1] = np.sqrt(max(cost[best] / count, NOISE2) / slope2)
