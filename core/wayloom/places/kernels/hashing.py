"""Locality-sensitive hashing of binary descriptors by sampled bits: keys, and votes of entries whose keys differ by few bits."""

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy", nogil=True)
def sampled_keys(bits, positions, out):  # type: ignore[no-untyped-def]
    """bits (n, B) uint8 to out (T, n) uint32: in row t the bits at positions (T, S), the first one the highest."""
    for t in range(positions.shape[0]):
        for i in range(bits.shape[0]):
            key = np.uint32(0)
            for s in range(positions.shape[1]):
                at = positions[t, s]
                key = np.uint32((key << np.uint32(1)) | np.uint32((bits[i, at >> 3] >> (at & 7)) & 1))
            out[t, i] = key


@njit(cache=True, error_model="numpy", nogil=True)
def count_entries(head, keys, shift, queries, flips, counts):  # type: ignore[no-untyped-def]
    """Adds to counts (q,) int64 how many entries have the key of each query (q,) uint32, or that with one of flips (f,) uint32.

    keys : (E,) uint32 of the entries, increasing; those of bucket b = key >> shift are rows head[b] to head[b + 1].
    """
    for i in range(len(queries)):
        for flip in flips:
            key = np.uint32(queries[i] ^ flip)
            bucket = key >> shift
            for row in range(head[bucket], head[bucket + 1]):
                if keys[row] == key:
                    counts[i] += 1


@njit(cache=True, error_model="numpy", nogil=True)
def add_votes(head, keys, owners, shift, queries, flips, weights, votes):  # type: ignore[no-untyped-def]
    """Adds the weight (q,) int64 of each query to votes (N,) int64 of the owners (E,) int32 of its entries, as `count_entries`."""
    for i in range(len(queries)):
        if weights[i] == 0:
            continue
        for flip in flips:
            key = np.uint32(queries[i] ^ flip)
            bucket = key >> shift
            for row in range(head[bucket], head[bucket + 1]):
                if keys[row] == key:
                    votes[owners[row]] += weights[i]
