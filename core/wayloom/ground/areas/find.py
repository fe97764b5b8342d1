"""Areas of one square of a raster of the ground: polygons of its classes that tile it with those of the squares around it.

The classes of the cells are made on a raster that reaches beyond the square (`classes.reach_m`), so the squares on both sides of an
edge agree on them, and put the same points on it. No outline crosses an edge, and none is drawn twice: the areas of neighbours have
no gap between them and nothing in common.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.ground.areas.arcs import arcs_of
from wayloom.ground.areas.classes import WHOLE, area_classes, least_cells, patches, vote_shares, without_cut_off
from wayloom.ground.areas.faces import doubled_area, faces_of
from wayloom.ground.areas.settings import AreaSettings
from wayloom.ground.sheet import CELL_M

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
PARTS: Final = 4
"""What a square's edge cuts off a patch is left to its neighbours where it is smaller than the smallest patch by this factor."""


@dataclass(frozen=True)
class Area:
    """A patch of ground of one class within a square.

    column      of the votes
    rings       (K, 2) m each, x and y in the raster's frame: the outline, counter-clockwise, then holes, clockwise; none gives its
                first point again
    area_m2     that they enclose
    confidence  share of the votes for its class, the mean over its cells
    """

    column: int
    rings: tuple[FloatArray, ...]
    area_m2: float
    confidence: float


def find_areas(votes: NDArray[np.uint32], corner: IntArray, halo: int, settings: AreaSettings) -> list[Area]:
    """The areas of the square that a raster reaches beyond by `halo` cells on each side, by their south-western cells.

    votes  : (H, H, K) of classes, in any unit
    corner : (2,) column and row, in cells of CELL_M, of the raster's first cell in the frame of the areas
    """
    shares = vote_shares(votes)
    around = area_classes(shares, settings)[halo - 1 : len(votes) - halo + 1, halo - 1 : len(votes) - halo + 1]
    classes = without_cut_off(around[1:-1, 1:-1], max(1, least_cells(settings) // PARTS))
    numbers, count = patches(classes)
    faces = faces_of(arcs_of(numbers, around), settings.tolerance_m / CELL_M)
    class_of = np.zeros(count + 1, np.int64)
    class_of[numbers] = classes
    first = np.full(count + 1, numbers.size)
    np.minimum.at(first, numbers.ravel(), np.arange(numbers.size))
    mean = _mean_shares(shares[halo:-halo, halo:-halo], class_of[numbers] - 1, numbers, count)
    origin = np.asarray(corner, np.int64) + halo
    return [
        Area(
            int(class_of[number]) - 1,
            tuple(np.asarray((ring + origin) * CELL_M, np.float64) for ring in rings),
            sum(map(doubled_area, rings)) * CELL_M**2 / 2.0,
            float(mean[number]),
        )
        for number, rings in sorted(faces.items(), key=lambda item: int(first[item[0]]))
        if class_of[number]
    ]


def _mean_shares(shares: IntArray, columns: IntArray, numbers: IntArray, count: int) -> FloatArray:
    """(count + 1,) the mean over each patch of the share (N, N, K) of the column (N, N) of its cells; -1 is none."""
    own = np.take_along_axis(shares, np.maximum(columns, 0)[..., None], axis=2)[..., 0]
    sums = np.bincount(numbers.ravel(), own.ravel().astype(np.float64), count + 1)
    return np.asarray(sums / np.maximum(np.bincount(numbers.ravel(), minlength=count + 1), 1) / WHOLE)
