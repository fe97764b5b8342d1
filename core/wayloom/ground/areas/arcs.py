"""Arcs of a partition of a square raster into patches: the borders between two patches, from one node to the next.

Lattice points are the corners of cells, x to the east and y to the north, whole numbers. Nodes are the points where more than two
patches meet, the square's corners, and the points of the square's edge where the classes on either side of it change. Each arc
borders two patches, so that what happens to it happens to both.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

IntArray = NDArray[np.int64]
Point = tuple[int, int]
STEPS: Final = ((1, 0), (0, 1), (-1, 0), (0, -1))
"""East, north, west, south: directions, each left of the one before."""


@dataclass(frozen=True)
class Arc:
    """points      (K, 2) x and y of its ends and of every corner between; of a loop without a node the first is the last
    left, right  the patches on its sides, 0 beyond the square
    leaves       direction of its first step; arrives: of its last
    """

    points: IntArray
    left: int
    right: int
    leaves: int
    arrives: int

    @property
    def is_loop(self) -> bool:
        """Whether it ends where it begins."""
        return bool((self.points[0] == self.points[-1]).all())


def arcs_of(numbers: IntArray, classes: NDArray[np.uint8]) -> list[Arc]:
    """The arcs of the patches (N, N), in an order that depends on them alone.

    numbers : of the patches, from 1 on
    classes : (N + 2, N + 2) of the square's cells and of those around it, as the squares beside it see them too: where they change
              along an edge, on either side, both put a node
    """
    return _Tracer(numbers, classes).arcs()


class _Tracer:
    """Walks along the sides between cells of different patches."""

    def __init__(self, numbers: IntArray, classes: NDArray[np.uint8]) -> None:
        size = len(numbers) + 1
        self._cells = np.pad(numbers, 1)
        cells = self._cells
        self._side = np.zeros((4, size, size), bool)  # whether a step from y, x in a direction goes along a border
        self._side[0, :, :-1] = cells[1:, 1:-1] != cells[:-1, 1:-1]
        self._side[1, :-1, :] = cells[1:-1, 1:] != cells[1:-1, :-1]
        self._side[2, :, 1:], self._side[3, 1:, :] = self._side[0, :, :-1], self._side[1, :-1, :]
        self._free = self._side.copy()
        self._is_node = self._side.sum(axis=0) > 2
        self._is_node[np.ix_((0, -1), (0, -1))] = True
        changes = classes[:, 1:] != classes[:, :-1], classes[1:, :] != classes[:-1, :]
        for edge, two in ((0, slice(None, 2)), (-1, slice(-2, None))):
            self._is_node[edge, 1:-1] |= changes[0][two, 1:-1].any(axis=0)
            self._is_node[1:-1, edge] |= changes[1][1:-1, two].any(axis=1)

    def arcs(self) -> list[Arc]:
        """From node to node, then the loops that meet none."""
        found = []
        for y, x in np.argwhere(self._is_node).tolist():
            found += [self._walk(x, y, way) for way in range(4) if self._free[way, y, x]]
        for y, x in np.argwhere(self._free[0]).tolist():
            if self._free[0, y, x]:
                found.append(self._walk(x, y, 0))
        return found

    def _walk(self, x: int, y: int, way: int) -> Arc:
        """To the next node, or back to the start."""
        start, leaves, sides = (x, y), way, self._sides(x, y, way)
        points = [start]
        while True:
            self._free[way, y, x] = False
            x, y = x + STEPS[way][0], y + STEPS[way][1]
            self._free[(way + 2) % 4, y, x] = False
            if self._is_node[y, x] or (x, y) == start:
                return Arc(np.array([*points, (x, y)], np.int64), *sides, leaves, way)
            following = next(turn for turn in (way, (way + 1) % 4, (way + 3) % 4) if self._side[turn, y, x])
            if following != way:
                points.append((x, y))
            way = following

    def _sides(self, x: int, y: int, way: int) -> tuple[int, int]:
        """The patches left and right of a step; the cell north-east of a point is at y + 1, x + 1 of the padded ones."""
        around = [int(self._cells[y + v, x + u]) for u, v in ((1, 1), (0, 1), (0, 0), (1, 0))]
        return around[way], around[way - 1]
