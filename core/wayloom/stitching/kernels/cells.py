"""Hash table from packed grid keys to rows: open addressing with linear probing."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

IntArray = NDArray[np.int64]
HALF = (1 << 31) - 1
MULTIPLIERS = 0x9E3779B1, 0x85EBCA77
"""2^32 / golden ratio (Knuth, The Art of Computer Programming 3, 6.4), and another prime: products of 31 bits do not overflow."""
CELLS_PER_AXIS = 1 << 20
"""Cells are packed as ((group * 2^20 + x) * 2^20 + y) * 2^20 + z."""


@njit(cache=True, error_model="numpy")
def fill_table(key: IntArray, table: IntArray) -> None:
    """Enter the rows of distinct keys (K,) into a table (2^b,) of -1, more than K places, in place."""
    mask = len(table) - 1
    for row in range(len(key)):
        place = slot(key[row], mask)
        while table[place] >= 0:
            place = (place + 1) & mask
        table[place] = row


@njit(cache=True, error_model="numpy", inline="always")
def slot(key, mask):  # type: ignore[no-untyped-def]
    """The first place to look for a key at."""
    h = ((key & HALF) * MULTIPLIERS[0]) ^ (((key >> 31) & HALF) * MULTIPLIERS[1])
    return (h ^ (h >> 32)) & mask


@njit(cache=True, error_model="numpy")
def find(key: int, keys: IntArray, table: IntArray) -> int:
    """Row of a key, -1 where it is not in the table."""
    mask = len(table) - 1
    place = slot(key, mask)
    while table[place] >= 0:
        if keys[table[place]] == key:
            return table[place]
        place = (place + 1) & mask
    return -1
