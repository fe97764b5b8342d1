"""Sparse Cholesky factorisation of symmetric block matrices over a graph: the pattern analysed once, factors for any block size."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.mapping.kernels import cholesky, dissection, ordering, selected_inverse, supernodes

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
FEW: Final = 32
"""Variables that are eliminated together, as one dense matrix: no order of them would save what it takes to find."""


class NotPositiveDefiniteError(ArithmeticError):
    """A matrix that was to be factored is singular or indefinite; `variable` is where elimination failed."""

    def __init__(self, variable: int) -> None:
        self.variable = variable
        super().__init__(f"not positive definite at variable {variable}")


@dataclass(frozen=True, slots=True)
class BlockPattern:
    """Where a symmetric matrix of N x N blocks has entries, and how they are eliminated; ranks as in `kernels.supernodes`.

    order, first, border_start, border, above: as the kernels take them
    entry_start, entry_rank, entry: the matrix's blocks by rows in the order of elimination
    """

    order: IntArray
    first: IntArray
    border_start: IntArray
    border: IntArray
    above: IntArray
    entry_start: IntArray
    entry_rank: IntArray
    entry: IntArray

    @property
    def variables(self) -> int:
        """N."""
        return len(self.order)

    def stored_blocks(self) -> int:
        """Blocks of the factor."""
        k, m = np.diff(self.first), np.diff(self.border_start)
        return int((k * (k + m)).sum())


@dataclass(frozen=True, slots=True)
class BlockFactor:
    """U of A = U^T U, d rows a variable."""

    pattern: BlockPattern
    block: int
    offset: IntArray
    values: FloatArray

    def solve(self, right: FloatArray) -> FloatArray:
        """x (N, d, r) with A x = right (N, d, r)."""
        p = self.pattern
        return np.asarray(
            cholesky.solve(np.ascontiguousarray(right), p.order, p.first, p.border_start, p.border, self.offset, self.values)
        )

    def diagonal_of_inverse(self) -> FloatArray:
        """(N, d, d): the blocks of A^-1 on its diagonal."""
        p = self.pattern
        return np.asarray(
            selected_inverse.diagonal_of_inverse(
                self.block, p.order, p.first, p.border_start, p.border, p.above, self.offset, self.values
            )
        )


def block_pattern(variables: int, rows: IntArray, columns: IntArray) -> BlockPattern:
    """Analyse a matrix with blocks at rows (P,) and columns (P,), each pair once in one direction, and on its diagonal."""
    order, first, border_start, border, above = _together(variables) if variables <= FEW else _ordered(variables, rows, columns)
    rank = np.empty(variables, np.int64)
    rank[order] = np.arange(variables)
    a, b = rank[rows], rank[columns]
    entry = np.where(a < b, np.arange(len(rows)), ~np.arange(len(rows)))
    low, high = np.minimum(a, b), np.maximum(a, b)
    by_row = np.lexsort((high, low))
    entry_start = np.searchsorted(low[by_row], np.arange(variables + 1))
    return BlockPattern(order, first, border_start, border, above, entry_start, high[by_row], entry[by_row])


def _together(variables: int) -> tuple[IntArray, ...]:
    """All in one supernode without a border."""
    none = np.zeros(0, np.int64)
    if variables == 0:
        return none, np.zeros(1, np.int64), np.zeros(1, np.int64), none, none
    return np.arange(variables), np.array([0, variables]), np.zeros(2, np.int64), none, np.array([-1])


def _ordered(variables: int, rows: IntArray, columns: IntArray) -> tuple[IntArray, ...]:
    """By minimum degree or by nested dissection, whichever leaves less to do."""
    start, adjacent = supernodes.compressed(variables, rows, columns)
    by_degree = ordering.minimum_degree(start, adjacent.copy())
    by_parts = dissection.nested_dissection(start, adjacent)
    analyses = (_analysed(start, adjacent, order) for order in (by_degree, by_parts))
    return min(analyses, key=lambda analysis: _work(*analysis[1:3]))


def _analysed(start: IntArray, adjacent: IntArray, order: IntArray) -> tuple[IntArray, ...]:
    """The order in postorder, and first, border_start, border, above."""
    order = order[supernodes.postorder(supernodes.elimination_tree(start, adjacent, order))]
    parent = supernodes.elimination_tree(start, adjacent, order)
    first = supernodes.supernode_starts(parent, supernodes.column_counts(start, adjacent, order, parent))
    return order, first, *supernodes.borders(start, adjacent, order, first)


def _work(first: IntArray, border_start: IntArray) -> float:
    """Multiplications of a factorisation, up to the cube of the blocks' size."""
    k, m = np.diff(first).astype(float), np.diff(border_start)
    return float((k**3 / 3.0 + k * k * m + k * m * m).sum())


def block_factor(pattern: BlockPattern, diagonal: FloatArray, blocks: FloatArray) -> BlockFactor:
    """Factor the matrix with diagonal (N, d, d) and blocks (P, d, d) at the pattern's rows and columns.

    Raises NotPositiveDefiniteError.
    """
    d = diagonal.shape[1]
    offset, waiting = cholesky.storage(pattern.first, pattern.border_start, pattern.above, d)
    values, stack = np.empty(offset[-1]), np.empty(waiting)
    failed = cholesky.factorise(
        diagonal,
        blocks,
        pattern.order,
        pattern.entry_start,
        pattern.entry_rank,
        pattern.entry,
        pattern.first,
        pattern.border_start,
        pattern.border,
        pattern.above,
        offset,
        values,
        stack,
    )
    if failed >= 0:
        raise NotPositiveDefiniteError(failed)
    return BlockFactor(pattern, d, offset, values)
