"""Marked pixels of an image: the joined pieces of them that are large, and what is near to them."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Bool = NDArray[np.bool_]
UInt8 = NDArray[np.uint8]


@njit(cache=True, error_model="numpy", inline="always")
def _root(parent: NDArray[np.int32], n: int) -> int:
    """The run that stands for the piece of run n; ways to it get shorter."""
    while parent[n] != n:
        parent[n] = parent[parent[n]]
        n = parent[n]
    return n


@njit(cache=True, error_model="numpy", nogil=True)
def large_pieces(marked: Bool, least: float, out: Bool) -> None:
    """Set out (h, w) bool, which is all False, where marked (h, w) bool is of a piece, joined by sides, of at least so many pixels.

    By the union of runs: those of a row that touch one of the row above belong to its piece.
    """
    rows, columns = marked.shape
    most = rows * ((columns + 1) // 2)
    first, end = np.empty(most, np.int32), np.empty(most, np.int32)
    parent, area = np.empty(most, np.int32), np.empty(most, np.int32)
    of_row = np.zeros(rows + 1, np.int64)
    count, above = 0, 0
    for i in range(rows):
        begin, j = count, 0
        while j < columns:
            if not marked[i, j]:
                j += 1
                continue
            first[count] = j
            while j < columns and marked[i, j]:
                j += 1
            end[count], parent[count], area[count] = j, count, j - first[count]
            while above < begin and end[above] <= first[count]:
                above += 1
            touching = above
            while touching < begin and first[touching] < j:
                a, b = _root(parent, touching), _root(parent, count)
                if a != b:
                    parent[b] = a
                    area[a] += area[b]
                touching += 1
            count += 1
        above, of_row[i + 1] = begin, count
    for i in range(rows):
        for n in range(of_row[i], of_row[i + 1]):
            if area[_root(parent, n)] >= least:
                out[i, first[n] : end[n]] = True


@njit(cache=True, error_model="numpy", nogil=True)
def near(marked: UInt8, half_widths: NDArray[np.uint16], out: UInt8) -> None:
    """Set out (h, w) uint8, which is all 0, to 1 within a disc around each pixel of marked (h, w) that is not 0.

    half_widths (2 radius + 1,) uint16: pixels to either side of its middle that the disc covers in each of its rows
    """
    rows, columns = marked.shape
    radius = half_widths.shape[0] // 2
    beside, most = np.empty(columns, np.uint16), 65535
    for i in range(rows):
        last = -most - 1
        for j in range(columns):
            if marked[i, j]:
                last = j
            beside[j] = min(j - last, most)
        if last < 0:
            continue
        last = columns + most
        for j in range(columns - 1, -1, -1):
            if marked[i, j]:
                last = j
            beside[j] = min(last - j, int(beside[j]))
        for k in range(max(i - radius, 0), min(i + radius + 1, rows)):
            width, row = half_widths[k - i + radius], out[k]
            for j in range(columns):
                row[j] |= beside[j] <= width
