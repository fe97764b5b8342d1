"""Bird's-eye descriptor of a place: what stands around it, by kind, in cells of a grid along the level heading of the camera.

A vehicle that comes the other way finds the grid turned by half a turn and moved by a lane: two grids are compared as they are and
turned, over small shifts. Both take the same surroundings because a view gathers as much behind the anchor as before it.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_ID
from wayloom.places.types import PlaceView

Grid = NDArray[np.uint8]
Words = NDArray[np.uint64]
KINDS: Final = (("building", "wall", "fence"), ("vegetation",), ("pole", "traffic light", "traffic sign"))
CELL_M: Final = 2.0
SHAPE: Final = (len(KINDS), 32, 24)
"""Channels, cells along the heading, cells across it."""
STEPS: Final = 8.0
"""A cell holds STEPS log(1 + points)."""
LOWEST_M: Final = 1.0
HIGHEST_M: Final = 12.0
"""Height above the ground of what counts."""
COARSER: Final = 2
"""Cells of the grid beside each other that make one of the signature."""
OCCUPIED: Final = 8
"""Points in a cell of the signature that make it occupied."""
WORDS: Final = 3
"""Words of 64 bits that hold a channel's signature."""
_KIND: Final = np.full(256, -1)
for _channel, _names in enumerate(KINDS):
    _KIND[[CLASS_ID[name] for name in _names]] = _channel
_GROUND: Final = (CLASS_ID["road"], CLASS_ID["sidewalk"])


def birds_eye(view: PlaceView) -> Grid:
    """The grid (3, 32, 24) of a view."""
    channels, along, across = SHAPE
    x, y, z = view.xyz.astype(np.float64).T
    height = z - ground_height(view)
    i, j = np.floor(y / CELL_M).astype(int) + along // 2, np.floor(x / CELL_M).astype(int) + across // 2
    kind = _KIND[view.label]
    inside = (kind >= 0) & (height > LOWEST_M) & (height < HIGHEST_M) & (i >= 0) & (i < along) & (j >= 0) & (j < across)
    cell = (kind[inside] * along + i[inside]) * across + j[inside]
    points = np.bincount(cell, minlength=channels * along * across).reshape(SHAPE)
    return np.minimum(np.rint(STEPS * np.log1p(points)), 255).astype(np.uint8)


def ground_height(view: PlaceView) -> float:
    """m, in the level frame: the median of the road's and sidewalks' points; 1.7 m under the camera where there are few."""
    ground = view.xyz[np.isin(view.label, _GROUND), 2]
    return float(np.median(ground)) if len(ground) >= 50 else -1.7


def turned(grid: Grid) -> Grid:
    """The grid (…, A, L) seen by who comes the other way."""
    return np.ascontiguousarray(grid[..., ::-1, ::-1])


def occupancy(grids: Grid) -> NDArray[np.bool_]:
    """(N, 3, 16, 12) which coarser cells of grids (N, 3, 32, 24) are occupied."""
    n, (channels, along, across) = len(grids), SHAPE
    points = np.expm1(grids / STEPS).reshape(n, channels, along // COARSER, COARSER, across // COARSER, COARSER).sum(axis=(3, 5))
    return np.asarray(points > OCCUPIED - 0.5)


def packed(occupied: NDArray[np.bool_]) -> Words:
    """(N, 3, 3) uint64 of occupancy (N, 3, 16, 12)."""
    n, channels = occupied.shape[:2]
    bits = np.packbits(occupied.reshape(n, channels, -1), axis=2, bitorder="little")
    return np.ascontiguousarray(bits).view("<u8").astype(np.uint64).reshape(n, channels, WORDS)


def variants(occupied: NDArray[np.bool_]) -> Words:
    """(18, 3, 3): the signature of occupancy (3, 16, 12) as it is and turned, each moved by up to a cell along and across."""
    found = []
    for one in (occupied, occupied[:, ::-1, ::-1]):
        padded = np.pad(one, ((0, 0), (1, 1), (1, 1)))
        found += [padded[:, a : a + one.shape[1], b : b + one.shape[2]] for a in range(3) for b in range(3)]
    return packed(np.array(found))
