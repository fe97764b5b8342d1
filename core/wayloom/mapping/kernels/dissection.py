"""Nested dissection of a graph by levels of breadth-first search (George and Liu, SIAM J. Numer. Anal. 1978).

Two parts of a graph that only a few nodes connect, the separator, are eliminated each by itself and the separator
last. It is taken out of a level
of the search from a node at the graph's rim, and thinned to what both sides touch.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from wayloom.mapping.kernels.ordering import minimum_degree

IntArray = NDArray[np.int64]
LEAF = 240  # variables; smaller parts are ordered by their degrees
SEARCHES = 3
LEAST_SHARE = 0.25  # of a part, what lies on the smaller side of its separator


@njit(cache=True, error_model="numpy")
def nested_dissection(start: IntArray, adjacent: IntArray) -> IntArray:
    """Order of elimination (N,) of a graph: start (N + 1,), adjacent as in `minimum_degree`."""
    n = len(start) - 1
    order = np.arange(n)  # permuted in place: a part is a run of it, its separator goes to the run's end
    part, level, local = np.zeros(n, np.int64), np.full(n, -1), np.zeros(n, np.int64)
    queue = np.empty(n, np.int64)
    begins, ends, top, parts = np.zeros(n + 1, np.int64), np.zeros(n + 1, np.int64), 0, 0
    ends[0] = n
    while top >= 0:
        begin, end = begins[top], ends[top]
        top -= 1
        parts += 1
        for k in range(begin, end):
            part[order[k]] = parts
        if end - begin <= LEAF:
            order_leaf(begin, end, order, parts, part, local, start, adjacent)
            continue
        root, count = order[begin], 0
        for _ in range(SEARCHES):  # each from where the one before ended: towards the rim
            reset(begin, end, order, level)
            levels, count = search(root, parts, part, level, queue, start, adjacent)
            root = queue[count - 1]
        if count < end - begin:  # not connected: what was reached is a part of its own
            unreached_first(begin, end, order, level)
            middle = end - count
            begins[top + 1], ends[top + 1], begins[top + 2], ends[top + 2] = begin, middle, middle, end
            top += 2
            continue
        cut = thinnest_level(level, queue, count, levels)
        if cut < 0:
            order_leaf(begin, end, order, parts, part, local, start, adjacent)
            continue
        for k in range(count):  # nodes of the cut that do not touch the next level stay with those before
            i = queue[k]
            if level[i] == cut:
                touches = False
                for a in range(start[i], start[i + 1]):
                    if part[adjacent[a]] == parts and level[adjacent[a]] == cut + 1:
                        touches = True
                        break
                level[i] = cut if touches else cut - 1
        low = begin
        for k in range(count):
            if level[queue[k]] < cut:
                order[low] = queue[k]
                low += 1
        high = low
        for k in range(count):
            if level[queue[k]] > cut:
                order[high] = queue[k]
                high += 1
        last = high
        for k in range(count):
            if level[queue[k]] == cut:
                order[last] = queue[k]
                last += 1
        parts += 1
        for k in range(high, end):
            part[order[k]] = parts
        begins[top + 1], ends[top + 1], begins[top + 2], ends[top + 2] = begin, low, low, high
        top += 2
    return order


@njit(cache=True, error_model="numpy")
def reset(begin: int, end: int, order: IntArray, level: IntArray) -> None:
    """Forget the levels of a part."""
    for k in range(begin, end):
        level[order[k]] = -1


@njit(cache=True, error_model="numpy")
def unreached_first(begin: int, end: int, order: IntArray, level: IntArray) -> None:
    """Put what the search did not reach in front."""
    old, k = order[begin:end].copy(), begin
    for reached in (False, True):
        for i in old:
            if (level[i] >= 0) == reached:
                order[k] = i
                k += 1


@njit(cache=True, error_model="numpy")
def search(
    root: int, own: int, part: IntArray, level: IntArray, queue: IntArray, start: IntArray, adjacent: IntArray
) -> tuple[int, int]:
    """Levels of the nodes of a part from its root; they are in the queue by level. Returns how many levels, how many nodes."""
    queue[0], count, k = root, 1, 0
    level[root] = 0
    while k < count:
        i = queue[k]
        k += 1
        for a in range(start[i], start[i + 1]):
            j = adjacent[a]
            if part[j] == own and level[j] < 0:
                level[j] = level[i] + 1
                queue[count] = j
                count += 1
    return level[queue[count - 1]] + 1, count


@njit(cache=True, error_model="numpy")
def thinnest_level(level: IntArray, queue: IntArray, count: int, levels: int) -> int:
    """The level with the fewest nodes that leaves LEAST_SHARE of them on either side, the more even one of equals;
    -1: none does.
    """
    size = np.zeros(levels, np.int64)
    for k in range(count):
        size[level[queue[k]]] += 1
    best, best_size, best_balance, below = -1, count, 0, 0
    for cut in range(levels):
        balance = min(below, count - below - size[cut])
        if balance >= LEAST_SHARE * count and (size[cut] < best_size or (size[cut] == best_size and balance > best_balance)):
            best, best_size, best_balance = cut, size[cut], balance
        below += size[cut]
    return best


@njit(cache=True, error_model="numpy")
def order_leaf(
    begin: int, end: int, order: IntArray, own: int, part: IntArray, local: IntArray, start: IntArray, adjacent: IntArray
) -> None:
    """Order a part by minimum degree, as if there were nothing else."""
    for k in range(begin, end):
        local[order[k]] = k - begin
    inner_start, length = np.zeros(end - begin + 1, np.int64), 0
    for k in range(begin, end):
        for a in range(start[order[k]], start[order[k] + 1]):
            length += part[adjacent[a]] == own
        inner_start[k - begin + 1] = length
    inner, length = np.empty(length, np.int64), 0
    for k in range(begin, end):
        for a in range(start[order[k]], start[order[k] + 1]):
            if part[adjacent[a]] == own:
                inner[length] = local[adjacent[a]]
                length += 1
    old = order[begin:end].copy()
    order[begin:end] = old[minimum_degree(inner_start, inner)]
