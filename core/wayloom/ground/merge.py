"""Merge of ground sheets of all drives into the ground of one square of the map.

The square is a function of the set of sheets within `HALO_M` of it. Each block of 0.8 m is shown by one sheet, chosen over metres
(`choice`), in colours and heights that are balanced over tens of metres (`balance`). Heights of sheets that agree are averaged by
their sigmas, votes are summed. Sums are of whole numbers, and every choice is by a strict order, so neither the order of the sheets
nor the square's size changes a bit.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.ground.balance import CHOICE_BLOCKS, HALO_TILES, at_blocks, balance_fields
from wayloom.ground.choice import Ranking, ranked_sheets
from wayloom.ground.ground_map import LARGEST_SIGMA_MM, NO_HEIGHT, GroundMap
from wayloom.ground.kernels import merging
from wayloom.ground.kernels.detail import block_detail
from wayloom.ground.kernels.merging import BLOCK, PRECISION, SAMPLES, TILE_BLOCKS
from wayloom.ground.placed_sheet import PlacedSheet, canonical_sheets, kernel_arrays, place_sigma_mm, place_variance, reach
from wayloom.ground.sheet import CELL_M

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
TILE_M: Final = TILE_BLOCKS * BLOCK * CELL_M
HALO_BLOCKS: Final = HALO_TILES * TILE_BLOCKS
HALO_M: Final = HALO_TILES * TILE_M
"""How far around a square sheets bear on it."""
HELD_SHEETS: Final = 32
"""In memory at a time, some ten megabytes each."""
AGREEING_MM: Final = 30.0
"""Heights so near the best sheet's, or within three sigma, are averaged."""


@dataclass(frozen=True, slots=True)
class _Square:
    """corner (2,) of its first block in the map's grid; blocks along its edge; sheets that reach it or its halo, in order, with
    what the kernels read of each; their sums (S, N, N, 8) and fields (S, 4, n, n) with the halo; ages (S,) from 1."""

    corner: IntArray
    blocks: int
    sheets: Sequence[PlacedSheet]
    arrays: Callable[[int], tuple[Any, ...]]
    channels: Sequence[int]
    t_ns: IntArray
    ages: IntArray
    sums: IntArray
    fields: FloatArray

    @property
    def first_tile(self) -> IntArray:
        """Of the fields, in the map's grid."""
        return self.corner // TILE_BLOCKS - HALO_TILES

    def ranking(self) -> Ranking:
        """Of the sheets, in the blocks of the square and CHOICE_BLOCKS around: what the halo holds beyond is for the fields."""
        part = slice(HALO_BLOCKS - CHOICE_BLOCKS, CHOICE_BLOCKS - HALO_BLOCKS)
        balance = at_blocks(self.fields)[..., part, part]
        return ranked_sheets(self.sums[:, part, part], balance, self.ages, lru_cache(None)(self.detail))

    def detail(self, row: int) -> NDArray[np.int16]:
        """(n, n, 4, 4) of one sheet, of the blocks of the square and CHOICE_BLOCKS around (`kernels.detail`)."""
        wide = self.blocks + 2 * CHOICE_BLOCKS
        out = np.empty((wide, wide, SAMPLES, SAMPLES), np.int16)
        block_detail(self.arrays(row), self.corner - CHOICE_BLOCKS, out)
        return out


def merge_sheets(placed: Iterable[PlacedSheet], low: FloatArray, edge_m: float) -> GroundMap | None:
    """The ground of a square; None where no sheet shows any.

    low    : (2,) m east and north of its corner, and edge_m: whole numbers of TILE_M
    placed : at least every sheet within HALO_M of it, in any order; one that comes twice counts once
    """
    tiles = np.rint(np.array([*low, edge_m]) / TILE_M).astype(np.int64)
    if np.abs(tiles * TILE_M - [*low, edge_m]).max() > 1e-6:
        raise ValueError(f"a square at {low} of {edge_m} m does not lie on the grid of {TILE_M} m")
    square = _surveyed(canonical_sheets(placed), tiles[:2] * TILE_BLOCKS, int(tiles[2]) * TILE_BLOCKS)
    if not square.sheets:
        return None
    ranking = square.ranking()
    here, and_next = slice(CHOICE_BLOCKS, -CHOICE_BLOCKS), slice(CHOICE_BLOCKS - 1, 1 - CHOICE_BLOCKS)
    made = _painted(square, ranking.order[:, here, here], ranking.allowed[here, here], ranking.gain[:, and_next, and_next])
    return None if made.is_empty else made


def _surveyed(sheets: Sequence[PlacedSheet], corner: IntArray, blocks: int) -> _Square:
    """The sheets near a square with their sums and fields."""
    near, sums, sigmas, times, channels = [], [], [], [], []
    wide, first = blocks + 2 * HALO_BLOCKS, corner - HALO_BLOCKS
    for one in sheets:
        sheet = one.read()
        low, high = reach(sheet, one.T_map_submap)
        if (high < first * BLOCK * CELL_M).any() or (low > (first + wide) * BLOCK * CELL_M).any():
            continue
        here = np.zeros((wide, wide, 8), np.int64)
        merging.block_sums(kernel_arrays(sheet, one.T_map_submap), first, here)
        if not here.any():
            continue
        x, y = one.T_map_submap[:2, 3]
        variance = place_variance(one.covariance) @ np.array([1.0, x, y, x * x, x * y, y * y])
        near.append(one)
        sums.append(here)
        sigmas.append(np.sqrt(max(variance, 0.0)) / 1000.0)
        times.append(sheet.t_ns)
        channels.append(sheet.colour.shape[2])
    t_ns = np.array(times, np.int64).reshape(-1, 2)
    ages = np.empty(len(near), np.int64)
    ages[np.lexsort((np.arange(len(near)), t_ns[:, 0], t_ns[:, 1]))] = np.arange(1, len(near) + 1)
    held = np.array(sums, np.int64).reshape(len(near), wide, wide, 8)
    arrays = lru_cache(HELD_SHEETS)(lambda k: kernel_arrays(near[k].read(), near[k].T_map_submap))
    return _Square(corner, blocks, near, arrays, channels, t_ns, ages, held, balance_fields(held, np.array(sigmas)))


def _painted(square: _Square, order: IntArray, allowed: IntArray, gain: FloatArray) -> GroundMap:
    """The ground by the order (S, B, B) of the sheets of each block, of which the first `allowed` (B, B) are shown, with gains
    (S, B + 2, B + 2, 3): those of a block more on each side."""
    used = [k for k in range(len(square.sheets)) if _wanted(order, allowed, k).any()]
    cells, channels = square.blocks * BLOCK, max((square.channels[k] for k in used), default=1)
    colour = np.zeros((2 * cells, 2 * cells, channels), np.uint8)
    sharpness, shown = np.zeros((2 * cells, 2 * cells), np.uint8), np.zeros((2 * cells, 2 * cells), np.uint16)
    height = np.full((cells, cells), np.nan)
    number = {k: row for row, k in enumerate(used, 1)}
    for rank in range(int(allowed.max(initial=0))):
        painted, laid = _full(shown != 0, 2 * BLOCK), _full(~np.isnan(height), BLOCK)
        here = np.where(rank < allowed, order[rank], -1)
        for k in np.unique(here[here >= 0]).tolist():
            about = (square.corner, square.fields[k], square.first_tile)
            level = np.ascontiguousarray(gain[k])
            merging.paint(square.arrays(k), number[k], (here == k) & ~painted, *about, level, (colour, sharpness, shown))
            merging.lay(square.arrays(k), (here == k) & ~laid, *about, height)
    summed = _summed(square, order, allowed, used, height)
    by_age = np.zeros(len(square.sheets) + 1, np.uint16)
    by_age[square.ages[used]] = np.arange(1, len(used) + 1)
    return GroundMap(
        corner=(square.corner * BLOCK).astype(np.int32),
        height_mm=summed.height_mm,
        sigma_mm=summed.sigma_mm,
        own_sigma_mm=summed.own_sigma_mm,
        votes=summed.votes.astype(np.uint32),
        looks=np.minimum(summed.looks, 255).astype(np.uint8),
        newest=by_age[summed.newest],
        colour=colour,
        sharpness=sharpness,
        shown=shown,
        sheets=tuple((square.sheets[k].drive_id, square.sheets[k].digest) for k in used),
        t_ns=square.t_ns[used],
        place_sigma_mm=np.array([place_sigma_mm(square.sheets[k]) for k in used], np.uint16),
    )


@dataclass(frozen=True, slots=True)
class _Summed:
    """Rasters (Q, Q) of cells."""

    height_mm: NDArray[np.int32]
    sigma_mm: NDArray[np.uint16]
    own_sigma_mm: NDArray[np.uint16]
    votes: IntArray
    looks: IntArray
    newest: IntArray


def _summed(square: _Square, order: IntArray, allowed: IntArray, used: Sequence[int], height: FloatArray) -> _Summed:
    """Heights, votes and ages, drive by drive: the sheets of one share its place, so the best of them counts for it."""
    cells = len(height)
    sums, votes = np.zeros((cells, cells, 2), np.int64), np.zeros((cells, cells, 3), np.int64)
    looks, newest = np.zeros((cells, cells), np.int64), np.zeros((cells, cells), np.int64)
    known = np.zeros((cells, cells, 2), np.int64)
    for drive_id in sorted({square.sheets[k].drive_id for k in used}):
        best = np.zeros((cells, cells, 2), np.int64)
        for k in [k for k in used if square.sheets[k].drive_id == drive_id]:
            about = (int(square.ages[k]), place_variance(square.sheets[k].covariance), AGREEING_MM)
            out = (sums, best, votes, looks, newest)
            wanted = _wanted(order, allowed, k)
            merging.add_cells(square.arrays(k), wanted, square.corner, square.fields[k], square.first_tile, about, height, out)
        known += best
    there = sums[..., 0] > 0
    mean = np.rint(sums[..., 1] / np.maximum(10 * sums[..., 0], 1))
    variance = PRECISION / np.maximum(known, 1)
    sigma, own = (np.where(there, _sigma_mm(one), 0).astype(np.uint16) for one in (variance.sum(axis=-1), variance[..., 0]))
    return _Summed(np.where(there, mean, NO_HEIGHT).astype(np.int32), sigma, own, votes, looks, newest)


def _sigma_mm(variance: FloatArray) -> FloatArray:
    return np.asarray(np.clip(np.ceil(np.sqrt(variance)), 1, LARGEST_SIGMA_MM))


def _wanted(order: IntArray, allowed: IntArray, k: int) -> NDArray[np.bool_]:
    """(B, B) where sheet k is shown or may be."""
    rank = np.argmax(order == k, axis=0)
    return np.asarray(rank < allowed)


def _full(there: NDArray[np.bool_], span: int) -> NDArray[np.bool_]:
    """(B, B): all of a block's span x span cells are there."""
    blocks = len(there) // span
    return np.asarray(there.reshape(blocks, span, blocks, span).all(axis=(1, 3)))
