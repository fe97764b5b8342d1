"""Normal equations of a pose graph's edges, as blocks."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from wayloom.mapping.kernels import planar_edges, spatial_edges

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
def add_spatial(
    T: FloatArray,
    first: IntArray,
    second: IntArray,
    measured: FloatArray,
    errors: FloatArray,
    information: FloatArray,
    slot: IntArray,
    diagonal: FloatArray,
    blocks: FloatArray,
    gradient: FloatArray,
) -> None:
    """Add edges in SE(3) to diagonal (N, 6, 6), blocks (P, 6, 6), gradient (N, 6) of half of chi2.

    slot (E,): row of blocks for nodes first and second, or ~row where that block is for second and first;
    len(blocks) where there is none
    """
    by_first, by_second = np.empty((6, 6)), np.empty((6, 6))
    for e in range(len(first)):
        spatial_edges.fill_jacobians(T[first[e]], T[second[e]], errors[e], by_first, by_second)
        add_edge(first[e], second[e], errors[e], information[e], by_first, by_second, slot[e], diagonal, blocks, gradient)


@njit(cache=True, error_model="numpy")
def add_planar(
    poses: FloatArray,
    first: IntArray,
    second: IntArray,
    measured: FloatArray,
    errors: FloatArray,
    information: FloatArray,
    slot: IntArray,
    diagonal: FloatArray,
    blocks: FloatArray,
    gradient: FloatArray,
) -> None:
    """The same for edges in the plane, d = 3."""
    by_first, by_second = np.empty((3, 3)), np.empty((3, 3))
    for e in range(len(first)):
        planar_edges.fill_jacobians(poses[first[e]], poses[second[e]], measured[e], by_first, by_second)
        add_edge(first[e], second[e], errors[e], information[e], by_first, by_second, slot[e], diagonal, blocks, gradient)


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
        weighted = spatial_edges.product(information, own)  # Omega J
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
