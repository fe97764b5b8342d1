"""Diagonal blocks of the inverse, from the factor, without the rest of it (Takahashi's equations over supernodes).

With the pivots K of a supernode, its border M and U = [U_KK U_KM], the inverse Z obeys Z_KM = -G Z_MM and
Z_KK = U_KK^-1 U_KK^-T - Z_KM G^T, where G = U_KK^-1 U_KM. Z_MM is a part of the parent's Z, so supernodes are taken
from the last to
the first. A supernode's Z lies on a stack until its last child, the one with the lowest number, has read it.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from wayloom.mapping.kernels.dense import subtract_row

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@njit(cache=True, error_model="numpy")
def last_children(above: IntArray) -> IntArray:
    """The child (S,) of each supernode that is taken last, -1 where there is none."""
    last = np.full(len(above), -1)
    for s in range(len(above) - 1, -1, -1):
        if above[s] >= 0:
            last[above[s]] = s
    return last


@njit(cache=True, error_model="numpy")
def stack_length(size: IntArray, above: IntArray, last: IntArray) -> int:
    """The stack's greatest length; size (S,): rows of each supernode's Z."""
    top, highest = 0, 0
    for s in range(len(size) - 1, -1, -1):
        if above[s] >= 0 and last[above[s]] == s:
            top -= size[above[s]] ** 2
        if last[s] >= 0:
            top += size[s] ** 2
        highest = max(highest, top)
    return highest


@njit(cache=True, error_model="numpy")
def diagonal_of_inverse(
    d: int,
    order: IntArray,
    first: IntArray,
    border_start: IntArray,
    border: IntArray,
    above: IntArray,
    offset: IntArray,
    factor: FloatArray,
) -> FloatArray:
    """Blocks (N, d, d) of the inverse, by variable."""
    n, supernodes = len(order), len(first) - 1
    pivots = (first[1:] - first[:-1]) * d
    size = pivots + (border_start[1:] - border_start[:-1]) * d
    last = last_children(above)
    stack, top = np.empty(stack_length(size, above, last)), 0
    out, place = np.empty((n, d, d)), np.zeros(n, np.int64)
    for s in range(supernodes - 1, -1, -1):
        k, w, p = pivots[s], size[s], above[s]
        Z = np.zeros((w, w))
        if p >= 0:
            fill_places(place, p, first, border_start, border, d)
            known = stack[top - size[p] ** 2 : top].reshape(size[p], size[p])
            fill_border(Z, k, known, border[border_start[s] : border_start[s + 1]], place, d)
            if last[p] == s:
                top -= size[p] ** 2
        fill_pivots(Z, factor[offset[s] : offset[s + 1]].reshape(k, w).copy())
        for i in range(first[s], first[s + 1]):
            a = (i - first[s]) * d
            for r in range(d):
                for c in range(d):
                    out[order[i], r, c] = Z[a + r, a + c]
        if last[s] >= 0:
            for r in range(w):
                for c in range(w):
                    stack[top + r * w + c] = Z[r, c]
            top += w * w
    return out


@njit(cache=True, error_model="numpy")
def fill_places(place: IntArray, s: int, first: IntArray, border_start: IntArray, border: IntArray, d: int) -> None:
    """Row of each rank of a supernode in its Z."""
    for i in range(first[s], first[s + 1]):
        place[i] = (i - first[s]) * d
    pivots = (first[s + 1] - first[s]) * d
    for c in range(border_start[s], border_start[s + 1]):
        place[border[c]] = pivots + (c - border_start[s]) * d


@njit(cache=True, error_model="numpy")
def fill_border(Z: FloatArray, k: int, known: FloatArray, ranks: IntArray, place: IntArray, d: int) -> None:
    """Copy Z_MM out of the parent's."""
    for a in range(len(ranks)):
        for r in range(d):
            row = known[place[ranks[a]] + r]
            for b in range(len(ranks)):
                for c in range(d):
                    Z[k + a * d + r, k + b * d + c] = row[place[ranks[b]] + c]


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def fill_pivots(Z: FloatArray, panel: FloatArray) -> None:
    """Z_KM, Z_MK and Z_KK, given Z_MM and the panel U (k, w), which becomes [U_KK^-1 G]."""
    k, w = panel.shape
    for j in range(k - 1, -1, -1):  # back substitution of [I U_KM], rows from the last: each needs those below
        inverse = 1.0 / panel[j, j]
        for c in range(k, w):
            panel[j, c] *= inverse
        panel[j, j] = inverse
        for i in range(k - 1, j, -1):  # row i changes nothing left of column i, where the others' entries of U still stand
            a = panel[j, i] * inverse
            panel[j, i] = 0.0
            subtract_row(panel[j, i:], a, panel[i, i:])
    for i in range(k):
        for l in range(k, w):
            subtract_row(Z[i, k:], panel[i, l], Z[l, k:])
    for i in range(k):
        for c in range(k, w):
            Z[c, i] = Z[i, c]
    for i in range(k):
        for j in range(i, k):
            total = 0.0
            for c in range(j, k):
                total += panel[i, c] * panel[j, c]
            for c in range(k, w):
                total -= Z[i, c] * panel[j, c]
            Z[i, j] = total
            Z[j, i] = total
