"""Grid look-up of drives that may overlap: their submaps' surroundings, widened by their covariance, share a cell.

The cells of a drive depend on it alone, so a store can keep them and find a new drive's neighbours by a look-up.
"""

from collections.abc import Iterable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.submaps.submap import PlacedSubmap

FloatArray = NDArray[np.float64]
Cell = tuple[int, int]
CELL_M: Final = 128.0
SEEN_M: Final = 40.0
"""How far a submap's surroundings reach beyond its cameras."""
SIGMAS: Final = 3.0


def cells_of(placed: Iterable[PlacedSubmap]) -> frozenset[Cell]:
    """Cells (east, north) of CELL_M that a drive may see, none where it has no place in the map."""
    cells: set[Cell] = set()
    for item in placed:
        if item.frame is not None:
            low, high = box_of(item)
            first, last = (np.floor(corner / CELL_M).astype(int).tolist() for corner in (low, high))
            cells.update((e, n) for e in range(first[0], last[0] + 1) for n in range(first[1], last[1] + 1))
    return frozenset(cells)


def box_of(item: PlacedSubmap) -> tuple[FloatArray, FloatArray]:
    """Lower and upper corner (2,) m, east and north, of what a submap may see."""
    track = item.track_enu()
    J = np.concatenate([np.eye(3), -se3.hat(track.mean(axis=0))], axis=1)
    margin = SEEN_M + SIGMAS * np.sqrt(np.maximum(np.diag(J @ item.covariance @ J.T)[:2], 0.0))
    return track[:, :2].min(axis=0) - margin, track[:, :2].max(axis=0) + margin


def pairs_of_drives(cells: dict[str, frozenset[Cell]]) -> list[tuple[str, str]]:
    """Pairs of drives that share a cell, each with the lesser id first, in order."""
    drives_of: dict[Cell, list[str]] = {}
    for drive_id in sorted(cells):
        for cell in cells[drive_id]:
            drives_of.setdefault(cell, []).append(drive_id)
    return sorted({(a, b) for drives in drives_of.values() for k, a in enumerate(drives) for b in drives[k + 1 :]})
