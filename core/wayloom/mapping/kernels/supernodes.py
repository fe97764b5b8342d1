"""Symbolic factorisation: elimination tree, supernodes and their borders.

Davis, Direct Methods for Sparse Linear Systems, ch. 4. Variables are counted by rank, their place in the order of elimination. A
supernode is a run of ranks with nested columns: its pivots first[s] … first[s + 1], and its border, the higher ranks that its
columns reach.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

IntArray = NDArray[np.int64]
SMALL_PIVOTS = 4  # supernodes of so few variables join whatever zeros that stores
MAX_ZERO_SHARE = 0.15  # of a larger joined supernode's stored blocks


@njit(cache=True, error_model="numpy")
def compressed(n: int, rows: IntArray, columns: IntArray) -> tuple[IntArray, IntArray]:
    """Neighbours of each of n variables, both directions, in the order given: start (n + 1,), adjacent (2P,)."""
    start = np.zeros(n + 1, np.int64)
    for k in range(len(rows)):
        start[rows[k] + 1] += 1
        start[columns[k] + 1] += 1
    for i in range(n):
        start[i + 1] += start[i]
    place, adjacent = start[:-1].copy(), np.empty(2 * len(rows), np.int64)
    for k in range(len(rows)):
        adjacent[place[rows[k]]] = columns[k]
        place[rows[k]] += 1
        adjacent[place[columns[k]]] = rows[k]
        place[columns[k]] += 1
    return start, adjacent


@njit(cache=True, error_model="numpy")
def elimination_tree(start: IntArray, adjacent: IntArray, order: IntArray) -> IntArray:
    """Parent rank (N,) of each rank, -1 at a root (Liu's algorithm); start, adjacent by variable."""
    n = len(order)
    rank = np.empty(n, np.int64)
    rank[order] = np.arange(n)
    parent, ancestor = np.full(n, -1), np.full(n, -1)
    for i in range(n):
        for a in range(start[order[i]], start[order[i] + 1]):
            j = rank[adjacent[a]]
            while j >= 0 and j < i:
                above = ancestor[j]
                ancestor[j] = i
                if above < 0:
                    parent[j] = i
                j = above
    return parent


@njit(cache=True, error_model="numpy")
def postorder(parent: IntArray) -> IntArray:
    """Old rank at each new rank (N,), such that every subtree is a run that ends with its root."""
    n = len(parent)
    head, sibling = np.full(n, -1), np.full(n, -1)
    for i in range(n - 1, -1, -1):
        if parent[i] >= 0:
            sibling[i] = head[parent[i]]
            head[parent[i]] = i
    out, stack, k = np.empty(n, np.int64), np.empty(n, np.int64), 0
    for root in range(n):
        if parent[root] >= 0:
            continue
        top = 0
        stack[0] = root
        while top >= 0:
            i = stack[top]
            if head[i] >= 0:
                top += 1
                stack[top] = head[i]
                head[i] = sibling[head[i]]
            else:
                out[k] = i
                k += 1
                top -= 1
    return out


@njit(cache=True, error_model="numpy")
def column_counts(start: IntArray, adjacent: IntArray, order: IntArray, parent: IntArray) -> IntArray:
    """Entries below the diagonal in each column (N,) of the factor, by rank: each row's subtree is walked once."""
    n = len(order)
    rank = np.empty(n, np.int64)
    rank[order] = np.arange(n)
    count, mark = np.zeros(n, np.int64), np.full(n, -1)
    for i in range(n):
        mark[i] = i
        for a in range(start[order[i]], start[order[i] + 1]):
            j = rank[adjacent[a]]
            while j < i and mark[j] != i:
                count[j] += 1
                mark[j] = i
                j = parent[j]
    return count


@njit(cache=True, error_model="numpy")
def supernode_starts(parent: IntArray, count: IntArray) -> IntArray:
    """First rank of each supernode and N at the end, (S + 1,): nested columns, and chains joined where few zeros are stored."""
    n = len(parent)
    first, below, zeros = np.empty(n + 1, np.int64), np.empty(n + 1, np.int64), np.zeros(n + 1, np.int64)
    s = 0
    for j in range(n):
        if j > 0 and s > 0 and parent[j - 1] == j and count[j - 1] == count[j] + 1:
            below[s - 1] = count[j]
        else:
            first[s], below[s] = j, count[j]
            s += 1
    first[s] = n
    kept = 0  # supernodes before s that are kept, written over the old ones
    for k in range(s):
        begin, border, empty, end = first[k], below[k], zeros[k], first[k + 1]
        while kept > 0 and parent[begin - 1] >= begin and parent[begin - 1] < end:
            child_pivots = begin - first[kept - 1]
            pivots = end - first[kept - 1]
            more = child_pivots * (end - begin + border - below[kept - 1])
            stored = pivots * (pivots + 1) // 2 + pivots * border
            if pivots > SMALL_PIVOTS and empty + zeros[kept - 1] + more > MAX_ZERO_SHARE * stored:
                break
            begin, empty = first[kept - 1], empty + zeros[kept - 1] + more
            kept -= 1
        first[kept], below[kept], zeros[kept] = begin, border, empty
        kept += 1
    first[kept] = n
    return first[: kept + 1].copy()


@njit(cache=True, error_model="numpy")
def borders(start: IntArray, adjacent: IntArray, order: IntArray, first: IntArray) -> tuple[IntArray, IntArray, IntArray]:
    """Border of each supernode: border_start (S + 1,), ranks ascending; and the supernode's parent (S,), -1 at a root."""
    n, supernodes = len(order), len(first) - 1
    rank, home = np.empty(n, np.int64), np.empty(n, np.int64)
    rank[order] = np.arange(n)
    for s in range(supernodes):
        home[first[s] : first[s + 1]] = s
    above, head, sibling = np.full(supernodes, -1), np.full(supernodes, -1), np.full(supernodes, -1)
    border_start, border, used = np.zeros(supernodes + 1, np.int64), np.empty(4 * n + 16, np.int64), 0
    mark = np.full(n, -1)
    for s in range(supernodes):
        end = first[s + 1]
        if used + n - end > len(border):
            larger = np.empty(2 * len(border) + n, np.int64)
            larger[:used] = border[:used]
            border = larger
        for i in range(first[s], end):
            for a in range(start[order[i]], start[order[i] + 1]):
                j = rank[adjacent[a]]
                if j >= end and mark[j] != s:
                    mark[j] = s
                    border[used] = j
                    used += 1
        child = head[s]
        while child >= 0:
            for a in range(border_start[child], border_start[child + 1]):
                j = border[a]
                if j >= end and mark[j] != s:
                    mark[j] = s
                    border[used] = j
                    used += 1
            child = sibling[child]
        border_start[s + 1] = used
        border[border_start[s] : used].sort()
        if used > border_start[s]:
            above[s] = home[border[border_start[s]]]
            sibling[s] = head[above[s]]
            head[above[s]] = s
    return border_start, border[:used].copy(), above
