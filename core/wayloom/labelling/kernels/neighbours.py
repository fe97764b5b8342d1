"""Class priors of sparse votes, their correction, and the Gaussian smoothing of votes over neighbours in space."""

import numpy as np
from numba import njit

_Index = np.uint64
"""Unsigned: a signed index is tested for being negative each time."""


@njit(cache=True, error_model="numpy")
def class_priors(start, classes, weights, class_count):  # type: ignore[no-untyped-def]
    """(class_count,) the prior of each class: its mean share of a point's votes, over the points that have any.

    start (P + 1,) int64, classes (M,) uint8, weights (M,) float32 > 0: the sparse votes of all P points
    """
    shares, points = np.zeros(class_count), 0
    for p in range(len(start) - 1):
        total = 0.0
        for m in range(start[p], start[p + 1]):
            total += np.float64(weights[m])
        points += total > 0.0
        for m in range(start[p], start[p + 1]):
            shares[classes[m]] += np.float64(weights[m]) / total
    return shares / max(points, 1)


@njit(cache=True, error_model="numpy")
def scaled_by_class(start, classes, weights, factors):  # type: ignore[no-untyped-def]
    """Weights (M,) float32 of sparse votes times their classes' factors (C,), the sum of each point's as it was."""
    out = np.empty_like(weights)
    for p in range(len(start) - 1):
        before, after = 0.0, 0.0
        for m in range(start[p], start[p + 1]):
            before += np.float64(weights[m])
            after += np.float64(weights[m]) * factors[classes[m]]
        for m in range(start[p], start[p + 1]):
            out[m] = np.float64(weights[m]) * factors[classes[m]] * (before / after)
    return out


@njit(cache=True, error_model="numpy")
def gaussian_weights(members, near, distance2, sigma, own_weight, rows, gaussian):  # type: ignore[no-untyped-def]
    """Fill rows (P, K) and gaussian (P, K) of points members (N,): exp(-r^2 / 2 s^2), for a point itself times `own_weight`; the
    point and 0 where there are no more.

    near (N, K) places among members of each one's nearest, -1: no more, distance2 (N, K) m^2, sigma (N,) m. A point that is not
    among its nearest, as many stand at its place, takes the last one's place.
    """
    for n in range(len(members)):
        p, scale, is_there = members[n], -0.5 / (sigma[n] * sigma[n]), False
        for i in range(near.shape[1]):
            q = near[n, i]
            is_there = is_there or q == n
            rows[p, i] = members[q] if q >= 0 else p
            gaussian[p, i] = np.exp(scale * distance2[n, i]) * (own_weight if q == n else 1.0) if q >= 0 else 0.0
        if not is_there:
            rows[p, near.shape[1] - 1], gaussian[p, near.shape[1] - 1] = p, own_weight


@njit(cache=True, error_model="numpy")
def smoothed_votes(start, classes, weights, neighbour, gaussian, first, stop, class_count):  # type: ignore[no-untyped-def]
    """Votes of points first to stop: the Gaussian-weighted mean of the neighbours' (as shares of 1), times the point's own sum.

    start      (P + 1,) int64, classes (M,) uint8, weights (M,) float32 > 0: the sparse votes of all P points
    neighbour  (P, K) rows of points, itself among them; gaussian (P, K) float32 their weights, 0: not a neighbour
    returns    (stop - first, class_count) float64; zeros for a point without votes of its own
    """
    votes = np.zeros((stop - first, class_count))
    total = np.zeros(len(start) - 1)
    mean = np.empty(class_count)
    for p in range(len(total)):
        for m in range(start[p], start[p + 1]):
            total[p] += np.float64(weights[m])
    for n in range(stop - first):
        p = first + n
        if not total[p] > 0.0:
            continue
        of_all = 0.0
        mean[:] = 0.0
        for i in range(neighbour.shape[1]):
            q = neighbour[p, i]
            if not (gaussian[p, i] > 0.0 and total[q] > 0.0):
                continue
            of_all += np.float64(gaussian[p, i])
            share = np.float64(gaussian[p, i]) / total[q]
            for m in range(_Index(start[q]), _Index(start[q + 1])):
                mean[classes[m]] += share * np.float64(weights[m])
        scale = total[p] / of_all
        for c in range(class_count):
            votes[n, c] = scale * mean[c]
    return votes
