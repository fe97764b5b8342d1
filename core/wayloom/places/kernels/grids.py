"""Similarity of bird's-eye grids: packed occupancy by counting bits, and whole numbers by cross-correlation over shifts."""

import numpy as np
from numba import njit

FIVES, THREES, FIFTEENS = np.uint64(0x5555555555555555), np.uint64(0x3333333333333333), np.uint64(0x0F0F0F0F0F0F0F0F)


@njit(inline="always")
def ones(word):  # type: ignore[no-untyped-def]
    """Bits that are set in a uint64."""
    word = word - ((word >> np.uint64(1)) & FIVES)
    word = (word & THREES) + ((word >> np.uint64(2)) & THREES)
    word = (word + (word >> np.uint64(4))) & FIFTEENS
    word += word >> np.uint64(8)
    word += word >> np.uint64(16)
    return (word + (word >> np.uint64(32))) & np.uint64(127)


@njit(cache=True, error_model="numpy", nogil=True)
def best_overlap(signatures, weights, variants, query_weights, rows, out):  # type: ignore[no-untyped-def]
    """Fills out (r,) float32 for rows (r,) of signatures (N, C, W) uint64: the largest, over variants (V, C, W) of the query, of
    the sum over channels of common bits times weights (N, C) times query_weights (C,) float32."""
    for i in range(len(rows)):
        row = rows[i]
        best = np.float32(0.0)
        for v in range(variants.shape[0]):
            total = np.float32(0.0)
            for c in range(variants.shape[1]):
                common = np.uint64(0)
                for w in range(variants.shape[2]):
                    common += ones(signatures[row, c, w] & variants[v, c, w])
                total += np.float32(common) * weights[row, c] * query_weights[c]
            best = max(best, total)
        out[i] = best


@njit(cache=True, error_model="numpy", nogil=True)
def best_correlation(grids, norms, queries, query_norm, reach, rows, score, which):  # type: ignore[no-untyped-def]
    """For rows (r,) of grids (N, C, A, L) uint8, fills score (r,) float64: the largest cross-correlation with queries
    (Q, C, A + 2 reach[0] + 1, L + 2 reach[1]) uint8 over shifts up to reach (2,) cells, each channel over its norms (N, C) and
    query_norm (C,); and which (r,) query gave it.

    The queries have a border of zeros, and one line more below. Lines of the grids are filled up with zeros to the same length, so
    that a shift is one offset and its products one run, whose sum of whole numbers vectorises.
    """
    channels, along, across = grids.shape[1:]
    width = across + 2 * reach[1]
    run = along * width
    flat, line = queries.reshape(queries.shape[0], channels, -1), np.zeros((channels, along, width), np.uint8)
    for i in range(len(rows)):
        row = rows[i]
        line[:, :, :across] = grids[row]
        ours = line.reshape(channels, run)
        score[i], which[i] = -1.0, 0
        for q in range(queries.shape[0]):
            for da in range(2 * reach[0] + 1):
                for dl in range(2 * reach[1] + 1):
                    offset, total = da * width + dl, 0.0
                    for c in range(channels):
                        scale = norms[row, c] * query_norm[c]
                        if scale > 0.0:
                            total += whole_product(ours[c], flat[q, c, offset : offset + run]) / scale
                    if total > score[i]:
                        score[i], which[i] = total, q


@njit(cache=True, error_model="numpy", nogil=True)
def whole_product(a, b):  # type: ignore[no-untyped-def]
    """Sum of products of a and b (n,) uint8, n under 2^15."""
    total = np.uint32(0)
    for k in range(len(a)):
        total += np.uint32(a[k]) * np.uint32(b[k])
    return total
