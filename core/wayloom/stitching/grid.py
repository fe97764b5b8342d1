"""Voxel grid of the map's frame: packed keys, and neighbours of cells."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.stitching.kernels.cells import CELLS_PER_AXIS, fill_table

IntArray = NDArray[np.int64]
KEY_BITS, KEY_BITS_UP = 22, 19  # 63 in all: 209 km east and north, 26 km up at 0.1 m, where the plane has left the Earth by 3 km
KEY_LIMIT, KEY_LIMIT_UP = 1 << (KEY_BITS - 1), 1 << (KEY_BITS_UP - 1)
KEY_LIMITS: Final = np.array([KEY_LIMIT, KEY_LIMIT, KEY_LIMIT_UP])


def pack(keys: IntArray) -> IntArray:
    """keys (V, 3) to one sortable whole number each."""
    shifted = keys + KEY_LIMITS
    return np.asarray((shifted[:, 0] << (KEY_BITS + KEY_BITS_UP)) | (shifted[:, 1] << KEY_BITS_UP) | shifted[:, 2])


def unpack(packed: IntArray) -> IntArray:
    """The inverse of `pack`."""
    mask, mask_up = (1 << KEY_BITS) - 1, (1 << KEY_BITS_UP) - 1
    shifted = np.column_stack([packed >> (KEY_BITS + KEY_BITS_UP), (packed >> KEY_BITS_UP) & mask, packed & mask_up])
    return np.asarray(shifted - KEY_LIMITS)


def pack_cells(cells: IntArray, low: IntArray, group: IntArray | int = 0) -> IntArray:
    """cells (N, 3) of a region, low (3,) its lowest less one, group (N,) small, to one whole number each."""
    shifted = cells - low
    return np.asarray(((group * CELLS_PER_AXIS + shifted[:, 0]) * CELLS_PER_AXIS + shifted[:, 1]) * CELLS_PER_AXIS + shifted[:, 2])


def lowest(cells: IntArray) -> IntArray:
    """(3,) the least of cells (N, 3) along each axis; zeros without any."""
    return np.asarray(cells.min(axis=0)) if len(cells) else np.zeros(3, np.int64)


def hash_table(key: IntArray) -> IntArray:
    """The table of `wayloom.stitching.kernels.cells` of distinct keys (K,), at most half full."""
    table = np.full(1 << max(int(2 * len(key)).bit_length(), 4), -1, np.int64)
    fill_table(key, table)
    return table


def neighbour_steps() -> IntArray:
    """(27, 4): packed difference, and axes, from a cell to itself, its faces', edges' and corners' neighbours, in this order."""
    axes = np.array([[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)], np.int64)
    axes = axes[np.argsort(np.abs(axes).sum(axis=1), kind="stable")]
    packed = (axes[:, 0] * CELLS_PER_AXIS + axes[:, 1]) * CELLS_PER_AXIS + axes[:, 2]
    return np.column_stack([packed, axes])
