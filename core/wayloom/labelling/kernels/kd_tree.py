"""Balanced k-d tree with a search of the nearest points, within a radius of each place's own."""

import numpy as np
from numba import njit

LEAF = 8
"""Points in a leaf, at most twice that."""
_STACK = 64


@njit(cache=True, error_model="numpy")
def _quickselect(places, order, low, high, middle, axis):  # type: ignore[no-untyped-def]
    """Move rows low to high of places (N, 3) and order (N,) so that the one at `middle` stands where sorting along the axis would
    put it, smaller ones before it, larger ones behind it (Hoare's selection)."""
    high -= 1
    while high > low:
        pivot = places[(low + high) // 2, axis]
        i, j = low, high
        while i <= j:
            while places[i, axis] < pivot:
                i += 1
            while places[j, axis] > pivot:
                j -= 1
            if i <= j:
                for d in range(3):
                    places[i, d], places[j, d] = places[j, d], places[i, d]
                order[i], order[j] = order[j], order[i]
                i += 1
                j -= 1
        if middle <= j:
            high = j
        elif middle >= i:
            low = i
        else:
            break


@njit(cache=True, error_model="numpy")
def build_kd_tree(places, order, axes, splits, levels):  # type: ignore[no-untyped-def]
    """Sort places (N, 3) and order (N,) into a k-d tree: node n of a level holds a range of rows, its children 2n + 1 and 2n + 2
    the halves of that range, split along its widest side.

    Fills axes (2^levels - 1,) int8 and splits (2^levels - 1,), the axis of each node and the coordinate at which it is split.
    """
    count = len(places)
    for level in range(levels):
        for n in range(1 << level):
            node = (1 << level) - 1 + n
            low, high = (n * count) >> level, ((n + 1) * count) >> level
            widest = -1.0
            for d in range(3):
                smallest, largest = places[low, d], places[low, d]
                for i in range(low + 1, high):
                    smallest, largest = min(smallest, places[i, d]), max(largest, places[i, d])
                if largest - smallest > widest:
                    widest, axes[node] = largest - smallest, d
            middle = ((2 * n + 1) * count) >> (level + 1)
            _quickselect(places, order, low, high, middle, axes[node])
            splits[node] = places[middle, axes[node]]


@njit(cache=True, error_model="numpy")
def nearest_within_radius(places, order, axes, splits, levels, asked, radius, rows, distance2):  # type: ignore[no-untyped-def]
    """The K points nearest to each place asked for, of equal ones those with the lowest numbers.

    places, order, axes, splits, levels : as `build_kd_tree` left them
    asked      (Q, 3); radius (Q,) within which neighbours are
    Fills rows (Q, K) int32 with points' numbers, -1 where there are no more, and distance2 (Q, K) with squared distances, inf
    there, nearest first.
    """
    count, wanted = len(places), rows.shape[1]
    leaves = (1 << levels) - 1
    nodes, stack = np.empty(_STACK, np.int64), np.empty((_STACK, 3))
    for q in range(len(asked)):
        near, far = rows[q], distance2[q]
        near[:] = -1
        far[:] = np.inf
        reach = radius[q] * radius[q]
        x, y, z = asked[q, 0], asked[q, 1], asked[q, 2]
        nodes[0], top = 0, 1
        stack[0, 0] = stack[0, 1] = stack[0, 2] = 0.0
        while top > 0:
            top -= 1
            node = nodes[top]
            a, b, c = stack[top, 0], stack[top, 1], stack[top, 2]  # by how much the node's box lies beside the point
            if a * a + b * b + c * c > min(reach, far[wanted - 1]):
                continue
            while node < leaves:
                axis = axes[node]
                beyond = (x if axis == 0 else y if axis == 1 else z) - splits[node]
                other = 2 * node + 1 if beyond > 0.0 else 2 * node + 2
                nodes[top], stack[top, 0], stack[top, 1], stack[top, 2] = other, a, b, c
                stack[top, axis] = beyond
                top += 1
                node = 4 * node + 3 - other
            n = node - leaves
            for i in range((n * count) >> levels, ((n + 1) * count) >> levels):
                dx, dy, dz = places[i, 0] - x, places[i, 1] - y, places[i, 2] - z
                r2 = dx * dx + dy * dy + dz * dz
                if r2 <= reach and r2 <= far[wanted - 1]:
                    _insert(near, far, order[i], r2, wanted)


@njit(cache=True, error_model="numpy", inline="always")
def _insert(near, far, number, r2, wanted):  # type: ignore[no-untyped-def]
    """Put a point into the sorted list near (K,), far (K,), the last one out."""
    if r2 == far[wanted - 1] and number > near[wanted - 1]:
        return
    at = wanted - 1
    while at > 0 and (far[at - 1] > r2 or (far[at - 1] == r2 and near[at - 1] > number)):
        near[at], far[at] = near[at - 1], far[at - 1]
        at -= 1
    near[at], far[at] = number, r2
