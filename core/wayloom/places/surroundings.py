"""Bird's-eye grids of many stations, and which of them are like another one."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.places.birds_eye import SHAPE, WORDS, occupancy, packed, turned, variants
from wayloom.places.kernels.grids import best_correlation, best_overlap

Grid = NDArray[np.uint8]
FloatArray = NDArray[np.float64]
COMPARED: Final = 48
"""Stations whose grids are correlated: those with the likest signatures."""
REACH_CELLS: Final = np.array([3, 2])
"""Shifts that are tried, along and across: half the road between stations, and a lane."""


class Surroundings:
    """Grids and signatures by row: 2.3 kB a station."""

    def __init__(self) -> None:
        self.grids = np.zeros((0, *SHAPE), np.uint8)
        self.norms = np.zeros((0, SHAPE[0]))
        self.signatures = np.zeros((0, SHAPE[0], WORDS), np.uint64)
        self.weights = np.zeros((0, SHAPE[0]), np.float32)

    def grow(self, rows: int) -> None:
        """Make room for so many rows."""
        for name in ("grids", "norms", "signatures", "weights"):
            array = getattr(self, name)
            setattr(self, name, np.concatenate([array, np.zeros((rows - len(array), *array.shape[1:]), array.dtype)]))

    def put(self, rows: NDArray[np.int32], grids: Grid) -> None:
        """Hold grids (n, 3, 32, 24) in rows (n,)."""
        occupied = occupancy(grids)
        self.grids[rows], self.norms[rows] = grids, norms(grids)
        self.signatures[rows], self.weights[rows] = packed(occupied), weights(occupied)

    def alike(self, grid: Grid, rows: NDArray[np.int64]) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Likeness (r,), 0 to 1, of the rows (r,) to grid (3, 32, 24), and whether turned; 0 where the signature rules it out."""
        occupied = occupancy(grid[None])
        overlap = np.empty(len(rows), np.float32)
        best_overlap(self.signatures, self.weights, variants(occupied[0]), weights(occupied)[0], rows, overlap)
        chosen = (
            np.flatnonzero(overlap >= np.partition(overlap, -COMPARED)[-COMPARED]) if len(rows) > COMPARED else np.arange(len(rows))
        )
        score, which = np.empty(len(chosen)), np.empty(len(chosen), np.int64)
        best_correlation(self.grids, self.norms, _bordered(grid), norms(grid[None])[0], REACH_CELLS, rows[chosen], score, which)
        like, is_turned = np.zeros(len(rows)), np.zeros(len(rows), bool)
        like[chosen], is_turned[chosen] = score / SHAPE[0], which == 1
        return like, is_turned

    @property
    def nbytes(self) -> int:
        """Memory of grids and signatures."""
        return sum(array.nbytes for array in (self.grids, self.norms, self.signatures, self.weights))


def _bordered(grid: Grid) -> Grid:
    """(2, 3, 39, 28): the grid (3, 32, 24) as it is and turned, in the border that `best_correlation` wants."""
    (a, b), both = REACH_CELLS.tolist(), np.stack([grid, turned(grid)])
    return np.pad(both, ((0, 0), (0, 0), (a, a + 1), (b, b)))


def norms(grids: Grid) -> FloatArray:
    """(N, 3) Euclidean norm of each channel of grids (N, 3, 32, 24)."""
    return np.asarray(np.sqrt((grids.astype(np.float64) ** 2).sum(axis=(2, 3))))


def weights(occupied: NDArray[np.bool_]) -> NDArray[np.float32]:
    """(N, 3): one over the root of the cells that are occupied in each channel; 0 where none is."""
    cells = occupied.sum(axis=(2, 3))
    return np.where(cells > 0, 1.0 / np.sqrt(np.maximum(cells, 1)), 0.0).astype(np.float32)
