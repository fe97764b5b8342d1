"""Dense parts of the factorisation: upper triangles in rows, so that every inner loop runs along memory.

Inner loops run from zero over slices: an index that could be negative would keep them from being vectorised. Sums
are added in a fixed
order by one thread: the same bits always. Below the diagonal stands nothing of meaning.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
PANEL, TILE = 48, 256  # rows factored together; columns updated together, so that a panel of them stays in the cache


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def factor_rows(panel: FloatArray, smallest: FloatArray) -> int:
    """Cholesky factor U, A = U^T U, of the first k rows of a symmetric matrix of n: panel (k, n), in place.

    Returns -1, or the first row whose pivot is not above its smallest (k,).
    """
    pivots = len(panel)
    for begin in range(0, pivots, PANEL):
        end = min(begin + PANEL, pivots)
        for j in range(begin, end):
            if not panel[j, j] > smallest[j]:
                return j
            inverse, row = 1.0 / np.sqrt(panel[j, j]), panel[j, j:]
            for c in range(len(row)):
                row[c] *= inverse
            for i in range(j + 1, end):
                subtract_row(panel[i, i:], row[i - j], row[i - j :])
        subtract_products(panel, begin, end, end, panel[end:], 0)
    return -1


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def subtract_row(target: FloatArray, share: float, row: FloatArray) -> None:
    """target -= share * row."""
    for c in range(len(target)):
        target[c] -= share * row[c]


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def subtract_products(panel: FloatArray, begin: int, end: int, column: int, target: FloatArray, offset: int) -> None:
    """target[i, c - offset] -= sum of panel[j, column + i] panel[j, c] over j = begin … end - 1, for all c >= column + i."""
    n, rows = panel.shape[1], len(target)
    for left in range(column, n, TILE):
        right = min(left + TILE, n)
        for i in range(0, rows - 1, 2):
            if column + i >= right:
                break
            low = max(left, column + i)
            t0, t1 = target[i, low - offset : right - offset], target[i + 1, low - offset : right - offset]
            update_two(panel, begin, end, column + i, t0, t1, low, right)
        if rows % 2 == 1 and column + rows - 1 < right:
            low = max(left, column + rows - 1)
            for j in range(begin, end):
                subtract_row(target[rows - 1, low - offset : right - offset], panel[j, column + rows - 1], panel[j, low:right])


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def update_two(panel: FloatArray, begin: int, end: int, column: int, t0: FloatArray, t1: FloatArray, left: int, right: int) -> None:
    """The update of two rows of the target, four rows of the panel at a time, columns left … right - 1."""
    fours = begin + (end - begin) // 4 * 4
    for j in range(begin, fours, 4):
        p0, p1, p2, p3 = panel[j, left:right], panel[j + 1, left:right], panel[j + 2, left:right], panel[j + 3, left:right]
        a0, a1, a2, a3 = panel[j, column], panel[j + 1, column], panel[j + 2, column], panel[j + 3, column]
        b0, b1, b2, b3 = panel[j, column + 1], panel[j + 1, column + 1], panel[j + 2, column + 1], panel[j + 3, column + 1]
        for c in range(len(t0)):
            q0, q1, q2, q3 = p0[c], p1[c], p2[c], p3[c]
            t0[c] -= a0 * q0 + a1 * q1 + a2 * q2 + a3 * q3
            t1[c] -= b0 * q0 + b1 * q1 + b2 * q2 + b3 * q3
    for j in range(fours, end):
        subtract_row(t0, panel[j, column], panel[j, left:right])
        subtract_row(t1, panel[j, column + 1], panel[j, left:right])
