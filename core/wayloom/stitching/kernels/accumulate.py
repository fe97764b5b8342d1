"""Voxel accumulation in fixed-point integers, so that no order of adding changes a bit."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

IntArray = NDArray[np.int64]


@njit(cache=True, error_model="numpy")
def add_points(
    voxel: IntArray,
    weight: IntArray,
    offset: IntArray,
    seen_ns: IntArray,
    vote_start: IntArray,
    vote_class: NDArray[np.uint8],
    vote_weight: IntArray,
    weight_sum: IntArray,
    offset_sum: IntArray,
    votes: IntArray,
    count: IntArray,
    first_seen_ns: IntArray,
    last_seen_ns: IntArray,
) -> None:
    """Add P points to V voxels, in place.

    voxel (P,) row of each point's voxel; weight (P,); offset (P, 3) place within the voxel; seen_ns (P,); the ragged votes of the
    points; weight_sum (V,), offset_sum (V, 3), votes (V, C), count, first_seen_ns, last_seen_ns (V,) are added to.
    """
    for p in range(len(voxel)):
        v = voxel[p]
        weight_sum[v] += weight[p]
        for axis in range(3):
            offset_sum[v, axis] += weight[p] * offset[p, axis]
        for k in range(vote_start[p], vote_start[p + 1]):
            votes[v, vote_class[k]] += vote_weight[k]
        count[v] += 1
        first_seen_ns[v] = min(first_seen_ns[v], seen_ns[p])
        last_seen_ns[v] = max(last_seen_ns[v], seen_ns[p])
