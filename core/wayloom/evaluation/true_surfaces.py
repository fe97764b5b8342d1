"""Distance of points to the true surfaces of a simulated city."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.evaluation.kernels import triangles
from wayloom.simulation.city.city import City

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
MOST_M: Final = 3.0
"""Nothing is said to be further off."""
CELL_M: Final = 3.0
TILE_M: Final = 40.0


@dataclass(frozen=True, slots=True)
class TrueSurfaces:
    """Triangles: corners (T, 3, 3) m ENU; a plan of cells, `start` (X * Y + 1,) into `triangle`: those within MOST_M."""

    corners: FloatArray
    low: FloatArray
    shape: IntArray
    start: IntArray
    triangle: IntArray

    def distance(self, points: FloatArray) -> FloatArray:
        """(N,) m from each point (N, 3) to the nearest true surface, at most MOST_M."""
        out = np.empty(len(points))
        triangles.nearest(
            np.ascontiguousarray(points), self.corners, self.start, self.triangle, self.low, self.shape, CELL_M, MOST_M, out
        )
        return out


def true_surfaces(city: City, places: FloatArray, reach_m: float, classes: tuple[int, ...]) -> TrueSurfaces:
    """The triangles of these classes that stand still within reach_m of the places (K, 3) m."""
    tiles = np.unique(np.floor(places[:, :2] / TILE_M).astype(np.int64), axis=0)
    found = {}
    for x, y in ((tiles + 0.5) * TILE_M).tolist():
        for tile, chunk in city.around(x, y, reach_m + TILE_M / 2).chosen:
            mesh = tile.mesh.rows(slice(int(tile.starts[chunk]), int(tile.starts[chunk + 1])))
            found[id(tile), chunk] = mesh.corners[np.isin(mesh.class_id, classes)]
    return sorted_triangles(np.concatenate([np.zeros((0, 3, 3)), *found.values()]).astype(np.float64))


def sorted_triangles(corners: FloatArray) -> TrueSurfaces:
    """Triangles (T, 3, 3), T > 0, entered into every cell of the plan that they come within MOST_M of."""
    plan = corners[:, :, :2]
    low = plan.min(axis=(0, 1)) - MOST_M
    first = np.floor((plan.min(axis=1) - MOST_M - low) / CELL_M).astype(np.int64)
    last = np.floor((plan.max(axis=1) + MOST_M - low) / CELL_M).astype(np.int64)
    shape = last.max(axis=0) + 1
    size = last - first + 1
    count = size.prod(axis=1)
    triangle = np.repeat(np.arange(len(corners)), count)
    number = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    x, y = first[triangle, 0] + number // size[triangle, 1], first[triangle, 1] + number % size[triangle, 1]
    cell = x * shape[1] + y
    order = np.argsort(cell, kind="stable")
    start = np.searchsorted(cell[order], np.arange(shape.prod() + 1))
    return TrueSurfaces(corners, low, shape, start, triangle[order])
