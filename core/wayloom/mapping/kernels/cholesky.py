"""Multifrontal Cholesky factorisation of a block sparse symmetric matrix (Duff and Reid, ACM TOMS 1983), and its solves.

The matrix has N variables with d rows each. A supernode with k pivots and m variables in its border keeps the rows of its pivots
of U, A = U^T U, as a panel (k d, (k + m) d) at offset[s] of `factor`. What its elimination takes from its border (m d, m d) waits
on a stack for the parent: supernodes are in postorder, so its children's lie on top.

Arrays are copied entry by entry: numba compiles half a second of error texts for each assignment of one array to a part of another.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from wayloom.mapping.kernels.dense import factor_rows, subtract_products, subtract_row

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
SMALLEST_PIVOT = 1e-13
"""Of a diagonal entry, what elimination must leave: less is rounding, and the matrix not positive definite."""


@njit(cache=True, error_model="numpy")
def storage(first: IntArray, border_start: IntArray, above: IntArray, d: int) -> tuple[IntArray, int]:
    """Offset of each supernode's panel and the length of them all (S + 1,), and the stack's greatest length."""
    supernodes = len(first) - 1
    offset, waiting = np.zeros(supernodes + 1, np.int64), np.zeros(supernodes, np.int64)
    top, highest = 0, 0
    for s in range(supernodes):
        k, m = first[s + 1] - first[s], border_start[s + 1] - border_start[s]
        offset[s + 1] = offset[s] + k * (k + m) * d * d
        own = m * m * d * d
        highest = max(highest, top + own)
        top += own - waiting[s]
        if above[s] >= 0:
            waiting[above[s]] += own
    return offset, highest


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def factorise(
    diagonal: FloatArray,
    blocks: FloatArray,
    order: IntArray,
    entry_start: IntArray,
    entry_rank: IntArray,
    entry: IntArray,
    first: IntArray,
    border_start: IntArray,
    border: IntArray,
    above: IntArray,
    offset: IntArray,
    factor: FloatArray,
    stack: FloatArray,
) -> int:
    """Fill factor (offset[-1],). Returns -1, or the variable at which the matrix proved not to be positive definite.

    diagonal (N, d, d) by variable; blocks (P, d, d) of the matrix above the diagonal; the row of rank i holds, for q
    = entry_start[i] …
    entry_start[i + 1], in the columns of rank entry_rank[q] > i, block entry[q], or the transpose of ~entry[q] where
    that is negative.
    """
    n, d = diagonal.shape[:2]
    place, top = np.zeros(n, np.int64), 0
    head, sibling = np.full(len(first), -1), np.full(len(first), -1)  # children, the last one first
    for s in range(len(first) - 1):
        begin, end = first[s], first[s + 1]
        columns = border[border_start[s] : border_start[s + 1]]
        k, m = end - begin, len(columns)
        panel = factor[offset[s] : offset[s + 1]].reshape(k * d, (k + m) * d)
        panel[:] = 0.0
        for i in range(begin, end):
            place[i] = (i - begin) * d
        for c in range(m):
            place[columns[c]] = (k + c) * d
        smallest = np.empty(k * d)
        for i in range(begin, end):
            fill_row(
                panel, (i - begin) * d, diagonal[order[i]], blocks, entry_start[i], entry_start[i + 1], entry_rank, entry, place
            )
            for r in range(d):
                smallest[(i - begin) * d + r] = SMALLEST_PIVOT * diagonal[order[i], r, r]
        own = m * m * d * d
        update = stack[top : top + own].reshape(m * d, m * d)
        update[:] = 0.0
        base, child = top, head[s]
        while child >= 0:
            ranks = border[border_start[child] : border_start[child + 1]]
            size = len(ranks) * d
            base -= size * size
            add_update(panel, update, stack[base : base + size * size].reshape(size, size), ranks, place, d)
            child = sibling[child]
        failed = factor_rows(panel, smallest)
        if failed >= 0:
            return order[begin + failed // d]
        subtract_products(panel, 0, k * d, k * d, update, k * d)
        for a in range(own):
            stack[base + a] = stack[top + a]
        top = base + own
        if above[s] >= 0:
            sibling[s], head[above[s]] = head[above[s]], s
    return -1


@njit(cache=True, error_model="numpy")
def fill_row(
    panel: FloatArray,
    row: int,
    diagonal: FloatArray,
    blocks: FloatArray,
    begin: int,
    end: int,
    entry_rank: IntArray,
    entry: IntArray,
    place: IntArray,
) -> None:
    """The d rows of one pivot, as the matrix has them."""
    d = len(diagonal)
    for r in range(d):
        for c in range(d):
            panel[row + r, row + c] = diagonal[r, c]
    for q in range(begin, end):
        column, e = place[entry_rank[q]], entry[q]
        for r in range(d):
            for c in range(d):
                panel[row + r, column + c] = blocks[e, r, c] if e >= 0 else blocks[~e, c, r]


@njit(cache=True, error_model="numpy")
def add_update(panel: FloatArray, update: FloatArray, child: FloatArray, ranks: IntArray, place: IntArray, d: int) -> None:
    """Add what a child takes from its border, upper triangle, to the rows of the pivots and of the border."""
    pivots = len(panel)
    for a in range(len(ranks)):
        row = place[ranks[a]]
        for b in range(a, len(ranks)):
            column = place[ranks[b]]
            for r in range(d):
                if row < pivots:
                    for c in range(d):
                        panel[row + r, column + c] += child[a * d + r, b * d + c]
                else:
                    for c in range(d):
                        update[row - pivots + r, column - pivots + c] += child[a * d + r, b * d + c]


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def solve(
    right: FloatArray,
    order: IntArray,
    first: IntArray,
    border_start: IntArray,
    border: IntArray,
    offset: IntArray,
    factor: FloatArray,
) -> FloatArray:
    """x (N, d, r) with A x = right (N, d, r), both by variable."""
    n, d, sides = right.shape
    x = np.empty((n * d, sides))
    for i in range(n):
        for r in range(d):
            for side in range(sides):
                x[i * d + r, side] = right[order[i], r, side]
    for s in range(len(first) - 1):
        rows = rows_of(s, first, border_start, border, d)
        k = (first[s + 1] - first[s]) * d
        panel = factor[offset[s] : offset[s + 1]].reshape(k, len(rows))
        for j in range(k):
            own = x[rows[j]]
            for side in range(sides):
                own[side] /= panel[j, j]
            for c in range(j + 1, len(rows)):
                subtract_row(x[rows[c]], panel[j, c], own)
    for s in range(len(first) - 2, -1, -1):
        rows = rows_of(s, first, border_start, border, d)
        k = (first[s + 1] - first[s]) * d
        panel = factor[offset[s] : offset[s + 1]].reshape(k, len(rows))
        for j in range(k - 1, -1, -1):
            own = x[rows[j]]
            for c in range(j + 1, len(rows)):
                subtract_row(own, panel[j, c], x[rows[c]])
            for side in range(sides):
                own[side] /= panel[j, j]
    out = np.empty((n, d, sides))
    for i in range(n):
        for r in range(d):
            for side in range(sides):
                out[order[i], r, side] = x[i * d + r, side]
    return out


@njit(cache=True, error_model="numpy")
def rows_of(s: int, first: IntArray, border_start: IntArray, border: IntArray, d: int) -> IntArray:
    """Rows of the matrix, by rank, that the columns of a supernode's panel stand for."""
    k = first[s + 1] - first[s]
    m = border_start[s + 1] - border_start[s]
    rows = np.empty((k + m) * d, np.int64)
    for i in range(k):
        for r in range(d):
            rows[i * d + r] = (first[s] + i) * d + r
    for c in range(m):
        for r in range(d):
            rows[(k + c) * d + r] = border[border_start[s] + c] * d + r
    return rows
