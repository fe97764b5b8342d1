"""Things: connected groups of points of one kind, as change is judged of them, never of single points.

Points of one kind in columns of the grid that touch are one thing. One that is larger than `thing_m` (a hedge, a row of cars) and
what is no single thing (walls) is cut along a grid. So a thing has the same points in every region that holds one of them or its
middle.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from wayloom.config.classes import CLASS_COUNT, CLASS_ID, MOVING_CLASSES
from wayloom.dense.types import BUILT, GREEN, GROUND, KINDS_OF_CLASS, MOVING, THIN
from wayloom.stitching.grid import lowest, pack_cells

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
PIECE_M: Final = 2.0
"""Edge of the cells by which what is larger is cut."""
GROUP_OF_KIND: Final = {THIN: 1, GREEN: 2, MOVING: 3, BUILT: 4}
BOARDS: Final = (CLASS_ID["traffic light"], CLASS_ID["traffic sign"])
BOARD_GROUP: Final = 5
"""Boards are things apart from posts: a sign that goes may have stood beside a lamp that stays."""
_FORWARD: Final = ((0, 1), (1, -1), (1, 0), (1, 1))
"""Half of a column's neighbours: the other half finds it."""


@dataclass(frozen=True, slots=True)
class Things:
    """T things of R points, these sorted by thing.

    rows   (R,) of the points; start (T + 1,) where each thing's begin
    kind   (T,) uint8 bit of `wayloom.dense.types`; label (T,) uint8 the class of most of its points, the lower on a tie
    """

    rows: IntArray
    start: IntArray
    kind: NDArray[np.uint8]
    label: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.kind)

    @property
    def thing(self) -> IntArray:
        """(R,) thing of each of its points."""
        return np.repeat(np.arange(len(self)), np.diff(self.start))


def kinds_of(label: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """(P,) uint8 bit of each point's class: what may move counts as MOVING though it be parked; 0 for ground and sky."""
    kinds = np.where(np.isin(label, MOVING_CLASSES), MOVING, KINDS_OF_CLASS[label]).astype(np.uint8)
    return np.where(kinds == GROUND, 0, kinds).astype(np.uint8)


def find_things(xyz: FloatArray, label: NDArray[np.uint8], rows: IntArray, link_m: float, thing_m: float) -> Things:
    """The things of points xyz (P, 3) m of classes label (P,), of those of these rows.

    link_m : edge of the columns; thing_m : a thing reaches no further east or north
    """
    kinds = kinds_of(label[rows])
    rows, kinds = rows[kinds > 0], kinds[kinds > 0]
    group = _groups(kinds, label[rows])
    whole = _linked(xyz[rows], group, link_m)
    large = _extent(xyz[rows], whole) > thing_m
    cut = large[whole] | (kinds == BUILT)
    pieces = np.floor(xyz[rows] / PIECE_M).astype(np.int64)
    piece = pack_cells(pieces, lowest(pieces), group)
    _, thing = np.unique(np.column_stack([cut, np.where(cut, piece, whole)]), axis=0, return_inverse=True)
    order = np.argsort(thing, kind="stable")
    start = np.searchsorted(thing[order], np.arange(thing.max(initial=-1) + 2))
    counts = np.zeros((len(start) - 1, CLASS_COUNT), np.int64)
    np.add.at(counts, (thing, label[rows]), 1)
    return Things(rows[order], start, kinds[order][start[:-1]], np.argmax(counts, axis=1).astype(np.uint8))


def _groups(kinds: NDArray[np.uint8], label: NDArray[np.uint8]) -> IntArray:
    """(R,) of points, of their kinds (R,) and classes (R,): only those of one group are one thing."""
    group = np.zeros(256, np.int64)
    group[list(GROUP_OF_KIND)] = list(GROUP_OF_KIND.values())
    return np.where(np.isin(label, BOARDS), BOARD_GROUP, group[kinds])


def _linked(xyz: FloatArray, group: IntArray, link_m: float) -> IntArray:
    """(R,) number of the connected columns that each point lies in."""
    columns = np.column_stack([np.floor(xyz[:, :2] / link_m), np.zeros(len(xyz))]).astype(np.int64)
    low = lowest(columns) - 1
    key, place = np.unique(pack_cells(columns, low, group), return_inverse=True)
    origin = pack_cells(np.zeros((1, 3), np.int64), np.zeros(3, np.int64))[0]
    pairs = [np.zeros((2, 0), np.int64)]
    for east, north in _FORWARD:
        step = pack_cells(np.array([[east, north, 0]]), np.zeros(3, np.int64))[0] - origin
        other = np.minimum(np.searchsorted(key, key + step), max(len(key) - 1, 0))
        here = np.flatnonzero(key[other] == key + step) if len(key) else np.zeros(0, np.int64)
        pairs.append(np.stack([here, other[here]]))
    one, other = np.concatenate(pairs, axis=1)
    graph = coo_array((np.ones(len(one), np.int8), (one, other)), shape=(len(key), len(key)))
    return np.asarray(connected_components(graph, directed=False)[1], np.int64)[place] if len(key) else place


def _extent(xyz: FloatArray, thing: IntArray) -> FloatArray:
    """(T,) m: the greater of how far each thing reaches east and north."""
    count = thing.max(initial=-1) + 1
    low, high = np.full((count, 2), np.inf), np.full((count, 2), -np.inf)
    np.minimum.at(low, thing, xyz[:, :2])
    np.maximum.at(high, thing, xyz[:, :2])
    return np.asarray((high - low).max(axis=1, initial=0.0))
