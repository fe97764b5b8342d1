"""Top-k class scores of each cell from logits."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Float64 = NDArray[np.float64]

_VOID = 255
_LEAST = 1e-30
_LOWEST = -700.0
"""Of an exponent: e to it is just above the least normal number."""
_LN2_HIGH = 0.693147180369123816490
_LN2_LOW = 1.90821492927058770002e-10
"""ln 2 in two parts, the first with 21 zeros behind it: a multiple of it is exact."""


@njit(cache=True, error_model="numpy", nogil=True)
def best_scores(logits, train_ids, class_count, k, steps_per_nat):  # type: ignore[no-untyped-def]
    """The k likeliest of our classes in each cell, best first, and how unlikely they are.

    A class's probability is the sum of those of the network's classes that are mapped to it (softmax); what is mapped to void is
    left out of the k, but not of the sum. Of equals the lower class comes first.

    logits         (gh, gw, C) float32
    train_ids      (C,) uint8, 255 = void
    class_count    how many classes are ours; k <= class_count
    steps_per_nat  -ln p is rounded to this many steps a nat, and ends at 255 steps
    returns        (gh, gw, k) uint8 classes, (gh, gw, k) uint8 steps
    """
    grid_height, grid_width, channels = logits.shape
    classes = np.empty((grid_height, grid_width, k), np.uint8)
    steps = np.empty((grid_height, grid_width, k), np.uint8)
    row = np.empty((channels, grid_width), np.float64)  # cells lie side by side, so that several are worked on at a time
    share = np.empty((class_count, grid_width), np.float64)
    total = np.empty(grid_width, np.float64)
    best = np.empty(grid_width, np.int64)
    sure, unlikely = np.exp(-0.4 / steps_per_nat), np.exp(-255.4 / steps_per_nat)  # their steps are known without a logarithm
    for v in range(grid_height):
        for c in range(channels):
            for u in range(grid_width):
                row[c, u] = logits[v, u, c]
        _find_largest(row, total, best)
        for c in range(channels):
            for u in range(grid_width):
                row[c, u] -= total[u]
        exponentiate(row.ravel())
        total[:] = 0.0
        share[:] = 0.0
        for c in range(channels):
            total += row[c]
            if train_ids[c] != _VOID:
                share[train_ids[c]] += row[c]
        for i in range(k):
            _find_largest(share, row[0], best)
            for u in range(grid_width):
                p = max(row[0, u] / total[u], _LEAST)
                classes[v, u, i] = best[u]
                steps[v, u, i] = 0 if p > sure else 255 if p < unlikely else min(255, int(-np.log(p) * steps_per_nat + 0.5))
                share[best[u], u] = -1.0
    return classes, steps


@njit(cache=True, error_model="numpy", nogil=True)
def _find_largest(values: Float64, largest: Float64, where: NDArray[np.int64]) -> None:
    """Fill in (n,) float64 the largest of each column of values (C, n) and (n,) int64 the first row that holds it."""
    for u in range(len(largest)):
        largest[u] = values[0, u]
        where[u] = 0
    for c in range(1, len(values)):
        for u in range(len(largest)):
            is_larger = values[c, u] > largest[u]
            where[u] = c if is_larger else where[u]
            largest[u] = values[c, u] if is_larger else largest[u]


@njit(cache=True, error_model="numpy", nogil=True)
def exponentiate(values: Float64) -> None:
    """Replace each of (n,) float64 values <= 0 by e to it, several at a time: that is what np.exp cannot do here.

    e^x = 2^m e^r with x = m ln 2 + r and |r| <= ln 2 / 2: the series of e^r up to r^13 / 13! is right to 4e-18.
    """
    for i in range(len(values)):
        x = max(values[i], _LOWEST)
        m = np.rint(x * (1.0 / np.log(2.0)))
        r = (x - m * _LN2_HIGH) - m * _LN2_LOW
        series = 1.0
        for n in (13.0, 12.0, 11.0, 10.0, 9.0, 8.0, 7.0, 6.0, 5.0, 4.0, 3.0, 2.0, 1.0):
            series = 1.0 + series * r * (1.0 / n)
        values[i] = series * np.int64((np.int64(m) + 1023) << 52).view(np.float64)
