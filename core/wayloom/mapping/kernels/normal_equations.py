"""Normal equations of a pose graph's edges, as blocks."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from wayloom.mapping.kernels.spatial_edges import product

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@njit(cache=True, error_model="numpy")
def fill_costs(errors: FloatArray, information: FloatArray, chi2: FloatArray) -> None:
    """chi2 (E,) of errors (E, d) with information (E, d, d)."""
    d = errors.shape[1]
    for e in range(len(errors)):
        total = 0.0
        for i in range(d):
            row = 0.0
            for j in range(d):
                row += information[e, i, j] * errors[e, j]
            total += errors[e, i] * row
        chi2[e] = total


@njit(cache=True, error_model="numpy")
def add_edges(
    first: IntArray,
    second: IntArray,
    errors: FloatArray,
    information: FloatArray,
    weight: FloatArray,
    by_first: FloatArray,
    by_second: FloatArray,
    slot: IntArray,
    diagonal: FloatArray,
    blocks: FloatArray,
    gradient: FloatArray,
) -> None:
    """Add edges with errors (E, d) and Jacobians (E, d, d) to diagonal (N, d, d), blocks (P, d, d), gradient (N, d) of half of the
    weighted chi2.

    slot (E,): row of blocks for nodes first and second, or ~row where that block is for second and first;
    len(blocks) where there is none
    """
    for e in range(len(first)):
        if weight[e] > 0.0:
            omega = weight[e] * information[e]
            add_edge(first[e], second[e], errors[e], omega, by_first[e], by_second[e], slot[e], diagonal, blocks, gradient)


@njit(cache=True, error_model="numpy")
def add_edge(
    i: int,
    j: int,
    error: FloatArray,
    information: FloatArray,
    by_first: FloatArray,
    by_second: FloatArray,
    slot: int,
    diagonal: FloatArray,
    blocks: FloatArray,
    gradient: FloatArray,
) -> None:
    """Add J^T Omega J and J^T Omega e of one edge between nodes i and j."""
    d = len(error)
    for side in range(2):
        own, node = (by_first, i) if side == 0 else (by_second, j)
        weighted = product(information, own)  # Omega J
        for a in range(d):
            for c in range(d):
                gradient[node, c] += weighted[a, c] * error[a]
                for b in range(d):
                    diagonal[node, b, c] += own[a, b] * weighted[a, c]
        if side == 1 and slot < len(blocks):
            for a in range(d):
                for b in range(d):
                    for c in range(d):
                        if slot >= 0:
                            blocks[slot, b, c] += by_first[a, b] * weighted[a, c]
                        else:
                            blocks[~slot, c, b] += by_first[a, b] * weighted[a, c]
