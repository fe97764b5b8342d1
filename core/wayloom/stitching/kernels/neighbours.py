"""Neighbours in space: confirmation of points by other drives, and votes pooled over voxels of one surface.

Rows are sorted by cell: cell (C,) packed keys with `start` (C + 1,) into the rows; the edge of a cell is at least the radius.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from wayloom.stitching.kernels.cells import find

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
KERNEL_STEPS = 256
OWN_WEIGHT = 16
"""How much more than votes beside it a voxel's own weigh."""
LEAST_WEIGHT = 26
"""Of KERNEL_STEPS: a tenth. Lighter neighbours are not said to have seen a voxel."""


@njit(cache=True, error_model="numpy")
def confirmed(xyz, drive, group, key, start, table, steps, radius2, out):  # type: ignore[no-untyped-def]
    """Whether a point of another drive and the same group lies within the radius of each of P points: out (P,), in place."""
    for c in range(len(key)):
        for s in range(len(steps)):
            other = find(key[c] + steps[s, 0], key, table)
            if other < 0:
                continue
            for p in range(start[c], start[c + 1]):
                if out[p]:
                    continue
                for q in range(start[other], start[other + 1]):
                    if drive[q] != drive[p] and group[q] == group[p] and _distance2(xyz[p], xyz[q]) < radius2:
                        out[p] = True
                        break


@njit(cache=True, error_model="numpy")
def _distance2(a, b):  # type: ignore[no-untyped-def]
    return (a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2


@njit(cache=True, error_model="numpy")
def kernel_weight(a, b, normal, on_surface, reach2, lone_reach2, thickness):  # type: ignore[no-untyped-def]
    """0 to KERNEL_STEPS: (1 - d^2 / r^2)^2 of b's distance d from a (biweight), 0 beyond r and, on a surface, off its plane."""
    d2 = _distance2(a, b)
    r2 = reach2 if on_surface else lone_reach2
    if d2 >= r2:
        return 0
    if on_surface:
        off = normal[0] * (b[0] - a[0]) + normal[1] * (b[1] - a[1]) + normal[2] * (b[2] - a[2])
        if abs(off) > thickness:
            return 0
    share = 1.0 - d2 / r2
    return int(KERNEL_STEPS * share * share)


@njit(cache=True, error_model="numpy")
def _adds_a_drive(drive, drive_start, v, u):  # type: ignore[no-untyped-def]
    """Whether voxel u has a drive that v has not. The drives of each are increasing."""
    i = drive_start[v]
    for j in range(drive_start[u], drive_start[u + 1]):
        while i < drive_start[v + 1] and drive[i] < drive[j]:
            i += 1
        if i == drive_start[v + 1] or drive[i] != drive[j]:
            return True
    return False


@njit(cache=True, error_model="numpy")
def pool(  # type: ignore[no-untyped-def]
    xyz, normal, on_surface, votes, first_ns, last_ns, drive_start, drive, wanted,
    key, start, table, steps, reach2, lone_reach2, thickness, drive_count,
    pooled, pooled_first_ns, pooled_last_ns, pooled_drives, pooled_drive_start,
):  # fmt: skip
    """Votes, drives and times of the voxels around each of W wanted voxels, in place.

    A voxel adds its votes to another's where it has a drive that the other has not: within a drive, points beside each other have
    shared their votes already (labelling), and pooling them again blurs edges.

    xyz, normal (V, 3), on_surface (V,), votes (V, 19) int64, first_ns, last_ns (V,), and the ragged drives of V voxels; wanted (W,)
    rows; pooled (W, 19); pooled_drives (M,) rows of drives, increasing within a voxel, of which the first pooled_drive_start[W] are
    written. Returns that number, or -1 where M is too few.
    """
    seen = np.zeros(drive_count, np.bool_)
    used, size = np.empty(drive_count, np.int64), 0
    cell_of = np.empty(len(xyz), np.int64)
    for c in range(len(key)):
        cell_of[start[c] : start[c + 1]] = c
    for w in range(len(wanted)):
        v, met = wanted[w], 0
        for s in range(len(steps)):
            other = find(key[cell_of[v]] + steps[s, 0], key, table)
            if other < 0:
                continue
            for u in range(start[other], start[other + 1]):
                weight = kernel_weight(xyz[v], xyz[u], normal[v], on_surface[v], reach2, lone_reach2, thickness)
                if weight == 0:
                    continue
                if u == v or _adds_a_drive(drive, drive_start, v, u):
                    for k in range(votes.shape[1]):
                        pooled[w, k] += (OWN_WEIGHT * weight if u == v else weight) * votes[u, k]
                if weight < LEAST_WEIGHT:
                    continue
                pooled_first_ns[w] = min(pooled_first_ns[w], first_ns[u])
                pooled_last_ns[w] = max(pooled_last_ns[w], last_ns[u])
                for d in range(drive_start[u], drive_start[u + 1]):
                    if not seen[drive[d]]:
                        seen[drive[d]] = True
                        used[met] = drive[d]
                        met += 1
        if size + met > len(pooled_drives):
            return -1
        pooled_drives[size : size + met] = np.sort(used[:met])
        for i in range(met):
            seen[used[i]] = False
        size += met
        pooled_drive_start[w + 1] = size
    return size
