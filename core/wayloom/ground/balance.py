"""Photometric balance of overlapping sheets, and that of their heights: fields that bring each one to what all say together.

Only what varies over tens of metres is balanced: exposure, a wet day, a place that is centimetres too high. At a tile of 3.2 m,
with L_s the logarithm of the mean colour (or the mean height) of sheet s, and D_st the median of L_t - L_s over the tiles around
that both saw, so that what has changed on a part of them does not count,

    g_s = sum_t w_t D_st / sum_t w_t,

where w_t falls to nothing towards the border of a sheet whose neighbours go on. So where a sheet ends the others are left as they
are and it is brought to them: there is no step. One sheet alone stays as it is, and none further away than `HALO_TILES` matters.
All is counted in whole numbers: a field has the same bits in every window.
"""

import itertools
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.ground.kernels.balancing import medians
from wayloom.ground.kernels.merging import COLOURS, HEIGHT, HEIGHTS, SEEN, TILE_BLOCKS

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
COVER_TILES: Final = 3
MEDIAN_TILES, MEDIAN_STRIDE, SMOOTH_TILES = 4, 2, 1
CHOICE_TILES: Final = 3
"""How far around a block fields bear on what shows it (`wayloom.ground.choice`): on who is shown over 7 blocks, on the gains with
which patches meet over 5 more (`wayloom.ground.levelling`, and the next block for interpolation)."""
CHOICE_BLOCKS: Final = 16
"""How far around a block sheets bear on what shows it, at least: on who is shown over 9 blocks (the score over 5, what is outdated
by most around over 2, one ground by the steps around over 2), on the gains over 4 more, and the next block for interpolation."""
HALO_TILES: Final = CHOICE_TILES + 1 + max(MEDIAN_TILES + SMOOTH_TILES, COVER_TILES)
"""Around a window: what the choice asks for, the next tile for interpolation, and what the field there depends on."""
LEAST_SAMPLES: Final = 16
"""Of 256: a tile that a sheet saw less of says nothing."""
LOG_STEPS: Final = 65_536.0
"""Logarithms of colours are whole numbers of this fraction, heights of a 64th of a millimetre."""
MM_STEPS: Final = 64.0
WEIGHT_STEPS: Final = 1024
LARGEST_LOG_GAIN: Final = 1.0
BEST_PLACE_M: Final = 0.01
GAIN_DECIMALS, MM_DECIMALS = 4, 2


def balance_fields(sums: IntArray, place_sigma_m: FloatArray) -> FloatArray:
    """(S, 4, n, n): gain of each channel and mm to add to heights, at the middles of tiles.

    sums          (S, N, N, 8) of the blocks of a window with its halo (`kernels.merging.block_sums`), N = TILE_BLOCKS n
    place_sigma_m (S,) of the height of each sheet's place in the map: the better placed count more for heights
    """
    count, n = len(sums), sums.shape[1] // TILE_BLOCKS
    tiles = sums.reshape(count, n, TILE_BLOCKS, n, TILE_BLOCKS, sums.shape[3]).sum(axis=(2, 4))
    seen, known = (np.where(tiles[..., kind] >= LEAST_SAMPLES, tiles[..., kind], 0) for kind in (SEEN, HEIGHTS))
    level = np.log(np.maximum(tiles[..., COLOURS] / np.maximum(16.0 * seen, 1.0)[..., None], 1.0))
    logs = np.rint(LOG_STEPS * np.moveaxis(level, -1, 1)).astype(np.int64)
    height = np.rint(MM_STEPS * tiles[..., HEIGHT] / np.maximum(known, 1)).astype(np.int64)[:, None]
    trust = np.maximum(np.rint(1.0 / np.maximum(place_sigma_m, BEST_PLACE_M) ** 2), 1.0).astype(np.int64)
    log_gain = np.clip(_balanced(logs, seen, np.ones(count, np.int64)) / LOG_STEPS, -LARGEST_LOG_GAIN, LARGEST_LOG_GAIN)
    offset_mm = _balanced(height, known, trust) / MM_STEPS
    return np.concatenate([np.round(np.exp(log_gain), GAIN_DECIMALS), np.round(offset_mm, MM_DECIMALS)], axis=1)


def at_blocks(field: FloatArray) -> FloatArray:
    """A field (..., n, n) at the middles of blocks (..., N, N), bilinear, constant beyond the outermost middles."""
    for axis in (-2, -1):
        n = field.shape[axis]
        place = np.clip((np.arange(n * TILE_BLOCKS) + 0.5) / TILE_BLOCKS - 0.5, 0.0, n - 1.0)
        low = np.minimum(place.astype(np.int64), n - 2)
        share = (place - low).reshape((-1, 1) if axis == -2 else (-1,))
        field = (1.0 - share) * np.take(field, low, axis) + share * np.take(field, low + 1, axis)
    return field


def box_sum(values: IntArray, reach: int) -> IntArray:
    """(..., N, N): sums over 2 reach + 1 squares a side, nothing beyond the edges."""
    for axis in (-2, -1):
        width = [(0, 0)] * values.ndim
        width[axis] = (reach + 1, reach)
        total = np.cumsum(np.pad(values, width), axis=axis)
        length = values.shape[axis]
        ahead = np.take(total, np.arange(2 * reach + 1, 2 * reach + 1 + length), axis)
        values = ahead - np.take(total, np.arange(length), axis)
    return values


def _steps(difference: IntArray, both: NDArray[np.bool_]) -> tuple[IntArray, NDArray[np.bool_]]:
    """(K, n, n): smoothed medians of differences over the tiles around that both saw; where there are any."""
    median, met = np.zeros_like(difference), np.zeros(both.shape, np.bool_)
    medians(difference, both, MEDIAN_TILES, MEDIAN_STRIDE, median, met)
    count = box_sum(met.astype(np.int64), SMOOTH_TILES)
    return np.rint(box_sum(median * met, SMOOTH_TILES) / np.maximum(count, 1)).astype(np.int64), count > 0


def _balanced(level: IntArray, seen: IntArray, trust: IntArray) -> FloatArray:
    """(S, K, n, n): what to add to each sheet's levels (S, K, n, n), seen by so many samples (S, n, n); trust (S,) weighs them."""
    cover = box_sum(seen, COVER_TILES)
    most = np.maximum(cover.max(axis=0, initial=0), 1)
    weight = np.maximum(np.rint(WEIGHT_STEPS * (2.0 * cover / most - 1.0)).astype(np.int64), 0) * trust[:, None, None]
    total, sums = weight.copy(), np.zeros_like(level)
    for s, t in itertools.combinations(range(len(level)), 2):
        common = np.minimum(seen[s], seen[t])
        if not common.any():
            continue
        step, met = _steps(level[t] - level[s], common > 0)
        for one, other, sign in ((s, t, 1), (t, s, -1)):
            sums[one] += sign * weight[other] * step
            total[one] += weight[other] * met
    return np.asarray(sums / np.maximum(total, 1)[:, None])
