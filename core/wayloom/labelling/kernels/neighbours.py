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
def gaussian_weights(members, low, near, distance2, sigma, own_weight, first, rows, gaussian):  # type: ignore[no-untyped-def]
    """Fill rows and gaussian (B, K), those of the points from `first` on, of Q of the points members (N,), from place `low` among
    them on: exp(-r^2 / 2 s^2), for a point itself times `own_weight`; the point and 0 where there are no more.

    near (Q, K) places among members of each one's nearest, -1: no more, distance2 (Q, K) m^2, sigma (Q,) m. A point that is not
    among its nearest, as many stand at its place, takes the last one's place.
    """
    last = near.shape[1] - 1
    for n in range(len(near)):
        own, scale, is_there = low + n, -0.5 / (sigma[n] * sigma[n]), False
        p = members[own]
        for i in range(last + 1):
            q = near[n, i]
            is_there = is_there or q == own
            rows[p - first, i] = members[q] if q >= 0 else p
            gaussian[p - first, i] = np.exp(scale * distance2[n, i]) * (own_weight if q == own else 1.0) if q >= 0 else 0.0
        if not is_there:
            rows[p - first, last], gaussian[p - first, last] = p, own_weight


@njit(cache=True, error_model="numpy", inline="always")
def _sum_of(weights, start, stop):  # type: ignore[no-untyped-def]
    total = 0.0
    for m in range(_Index(start), _Index(stop)):
        total += np.float64(weights[m])
    return total


@njit(cache=True, error_model="numpy")
def smoothed_votes(start, classes, weights, neighbour, gaussian, first, class_count):  # type: ignore[no-untyped-def]
    """Votes of B points from `first` on: the Gaussian-weighted mean of the neighbours' (as shares of 1), times the point's own sum.

    start      (P + 1,) int64, classes (M,) uint8, weights (M,) float32 > 0: the sparse votes of all P points
    neighbour  (B, K) rows of points, itself among them; gaussian (B, K) float32 their weights, 0: not a neighbour
    returns    (B, class_count) float64; zeros for a point without votes of its own
    """
    votes = np.zeros((len(neighbour), class_count))
    mean = np.empty(class_count)
    for n in range(len(neighbour)):
        p = first + n
        own = _sum_of(weights, start[p], start[p + 1])
        if not own > 0.0:
            continue
        of_all = 0.0
        mean[:] = 0.0
        for i in range(neighbour.shape[1]):
            q = neighbour[n, i]
            total = _sum_of(weights, start[q], start[q + 1]) if gaussian[n, i] > 0.0 else 0.0
            if not total > 0.0:
                continue
            of_all += np.float64(gaussian[n, i])
            share = np.float64(gaussian[n, i]) / total
            for m in range(_Index(start[q]), _Index(start[q + 1])):
                mean[classes[m]] += share * np.float64(weights[m])
        scale = own / of_all
        for c in range(class_count):
            votes[n, c] = scale * mean[c]
    return votes
