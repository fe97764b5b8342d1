"""Votes of points that lie beside each other, brought together."""

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy")
def votes_around(start, classes, weights, neighbour, closeness, first, stop, class_count):  # type: ignore[no-untyped-def]
    """Votes of points first to stop: the mean of the neighbours' (as shares of 1), weighed by closeness, times the point's own sum.

    start      (P + 1,) int64, classes (M,) uint8, weights (M,) float32 > 0: the sparse votes of all P points
    neighbour  (P, K) int64 rows of points, closeness (P, K) float32, 0: not a neighbour; the point itself is among its neighbours
    returns    (stop - first, class_count) float64; zeros for a point without votes of its own
    """
    votes = np.zeros((stop - first, class_count))
    total = np.zeros(len(start) - 1)
    for p in range(len(total)):
        for m in range(start[p], start[p + 1]):
            total[p] += np.float64(weights[m])
    for p in range(first, stop):
        if not total[p] > 0.0:
            continue
        of_all = 0.0
        for i in range(neighbour.shape[1]):
            q = neighbour[p, i]
            if not (closeness[p, i] > 0.0 and total[q] > 0.0):
                continue
            of_all += np.float64(closeness[p, i])
            share = np.float64(closeness[p, i]) / total[q]
            for m in range(start[q], start[q + 1]):
                votes[p - first, classes[m]] += share * np.float64(weights[m])
        for c in range(class_count):
            votes[p - first, c] *= total[p] / of_all
    return votes
