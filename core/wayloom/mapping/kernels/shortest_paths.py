"""Shortest paths through a graph of measured steps (Dijkstra 1959), and what the steps along them add up to."""

import heapq

import numpy as np
from numba import njit
from numpy.typing import NDArray

from wayloom.mapping.kernels.spatial_edges import fill_adjoint, product

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


@njit(cache=True, error_model="numpy")
def fill_paths(
    source: IntArray,
    target: IntArray,
    start: IntArray,
    neighbour: IntArray,
    step: IntArray,
    length: FloatArray,
    T_step: FloatArray,
    covariance: FloatArray,
    longest: float,
    reached: BoolArray,
    T: FloatArray,
    total: FloatArray,
) -> None:
    """For each of k pairs of nodes, source and target (k,), the shortest path between them.

    T (k, 4, 4) from target to source along it, and total (k, 6, 6), the covariance of its left perturbation; reached (k,) stays
    false, and both are unchanged, where it is longer than `longest`.

    start (N + 1,), neighbour (A,), step (A,): which steps lead where from each node; length (S,), T_step (S, 4, 4), from the node
    that a step leads to, to the one that it leaves, with covariance (S, 6, 6)
    """
    nodes = len(start) - 1
    distance, came, by = np.full(nodes, np.inf), np.full(nodes, -1), np.full(nodes, -1)
    for k in range(len(source)):
        touched = [source[k]]
        distance[source[k]] = 0.0
        queue = [(0.0, source[k])]
        while len(queue) > 0:
            here, i = heapq.heappop(queue)
            if i == target[k] or here > distance[i]:
                if i == target[k]:
                    break
                continue
            for a in range(start[i], start[i + 1]):
                there, j = here + length[step[a]], neighbour[a]
                if there <= longest and there < distance[j]:
                    if distance[j] == np.inf:
                        touched.append(j)
                    distance[j], came[j], by[j] = there, i, step[a]
                    heapq.heappush(queue, (there, j))
        if distance[target[k]] < np.inf:
            reached[k] = True
            add_up(source[k], target[k], came, by, T_step, covariance, T[k], total[k])
        for i in touched:
            distance[i] = np.inf


@njit(cache=True, error_model="numpy")
def add_up(
    source: int,
    target: int,
    came: IntArray,
    by: IntArray,
    T_step: FloatArray,
    covariance: FloatArray,
    T: FloatArray,
    total: FloatArray,
) -> None:
    """T (4, 4) and total (6, 6) of the steps that came to target from source, from the last one on."""
    for r in range(4):
        for c in range(4):
            T[r, c] = 1.0 if r == c else 0.0
    total[:] = 0.0
    adjoint = np.zeros((6, 6))
    i = target
    while i != source:
        s = by[i]
        fill_adjoint(T_step[s], adjoint)
        behind = product(T_step[s], T)
        for r in range(4):
            for c in range(4):
                T[r, c] = behind[r, c]
        carried = product(product(adjoint, total), adjoint.T)
        for r in range(6):
            for c in range(6):
                total[r, c] = covariance[s, r, c] + carried[r, c]
        i = came[i]
