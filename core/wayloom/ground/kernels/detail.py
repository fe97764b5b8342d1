"""Detail of ground sheets: brightness at 20 cm, and how far that of two sheets agrees whatever the light."""

import numpy as np
from numba import njit

from wayloom.ground.kernels.merging import BLOCK, SAMPLES
from wayloom.ground.kernels.resampling import CELL_M, colour_of, place

UNSEEN = -1
STEPS_A_GREY_LEVEL = 16
LEAST_STEP = 8
"""Half a grey level: less is noise."""


@njit(cache=True, error_model="numpy", nogil=True)
def block_detail(sheet, corner, out):  # type: ignore[no-untyped-def]
    """Mean brightness of the SAMPLES x SAMPLES places of each block of a window (N, N, SAMPLES, SAMPLES) int16, in place: of four
    points of each, in sixteenths of a grey level; UNSEEN where one of them was not seen."""
    step = BLOCK * CELL_M / SAMPLES
    colour = np.zeros(sheet[3].shape[2])
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            for a in range(SAMPLES):
                for b in range(SAMPLES):
                    total, seen = 0.0, 0
                    for k in range(4):
                        x = (corner[0] + j) * (BLOCK * CELL_M) + (b + 0.25 + 0.5 * (k % 2)) * step
                        y = (corner[1] + i) * (BLOCK * CELL_M) + (a + 0.25 + 0.5 * (k // 2)) * step
                        u, v, _, _ = place(sheet, x, y)
                        if colour_of(sheet, u, v, colour) > 0:
                            total += colour.sum() / len(colour)
                            seen += 1
                    out[i, j, a, b] = int(np.rint(STEPS_A_GREY_LEVEL * total / 4.0)) if seen == 4 else UNSEEN


@njit(cache=True, error_model="numpy", inline="always")
def _agreement(one_low, one_high, other_low, other_high):  # type: ignore[no-untyped-def]
    """1 where both steps go the same way, -1 where they do not, 0 where one of them is none."""
    if min(one_low, one_high, other_low, other_high) < 0:
        return 0
    one, other = int(one_high) - int(one_low), int(other_high) - int(other_low)
    if abs(one) < LEAST_STEP or abs(other) < LEAST_STEP:
        return 0
    return 1 if (one > 0) == (other > 0) else -1


@njit(cache=True, error_model="numpy", nogil=True)
def step_agreement(one, other, counts):  # type: ignore[no-untyped-def]
    """Of the steps between neighbouring places of the blocks of two sheets (N, N, S, S), in place, counts (2, N, N) int64: how many
    more agree in their sign than do not, and how many there are in both."""
    size = one.shape[2]
    for i in range(one.shape[0]):
        for j in range(one.shape[1]):
            for a in range(size):
                for b in range(size):
                    if b + 1 < size:
                        n = _agreement(one[i, j, a, b], one[i, j, a, b + 1], other[i, j, a, b], other[i, j, a, b + 1])
                        counts[0, i, j] += n
                        counts[1, i, j] += abs(n)
                    if a + 1 < size:
                        n = _agreement(one[i, j, a, b], one[i, j, a + 1, b], other[i, j, a, b], other[i, j, a + 1, b])
                        counts[0, i, j] += n
                        counts[1, i, j] += abs(n)
