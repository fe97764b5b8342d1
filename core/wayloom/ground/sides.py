"""Two sides of a kerb: cells around the steps that were found, made of the planes of road and upper side; votes given to them."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.ground.edges import Steps, beside_steps, windowed
from wayloom.ground.kernels.edges import nearest_steps
from wayloom.ground.raster import Cells, Raster
from wayloom.ground.sheet import CELL_M
from wayloom.ground.view import BESIDE, ROAD

FloatArray = NDArray[np.float64]
SIDE_M: Final = 0.8
"""Cells so near to a step belong to its sides, whatever their labels."""
SMEAR_M: Final = 0.25
"""Matching mixes both sides so far: heights there are those of the planes further away."""
FAR_M, HALF_M = 1.3, 0.75
"""Of the planes: m across from the step, and along to either side."""
ALONG_M: Final = 0.3
RISE_STATIONS: Final = 4
"""Heights of steps are means over so many stations to either side."""
MOST_LACK_M: Final = 0.03
"""By how much matching may draw the two planes together: it is smooth over more than the smear."""


def laid(steps: Steps, cells: Cells, raster: Raster) -> tuple[Cells, NDArray[np.uint8]]:
    """The cells with both sides of the steps told apart, and the side (H, W) of each, ROAD or BESIDE, 0 where there is no step."""
    height, group = cells.height.copy(), cells.group.copy()
    side = np.zeros(height.shape, np.uint8)
    nearest, distance2 = np.full(height.shape, -1, np.int64), np.full(height.shape, np.inf)
    nearest_steps(steps.facts, CELL_M, raster.low, SIDE_M, ALONG_M, nearest, distance2)
    r, c = np.nonzero((nearest >= 0) & (cells.information > 0.0))
    s = nearest[r, c]
    across, along = _from_step(steps, s, raster.low + (np.column_stack([c, r]) + 0.5) * CELL_M)
    side[r, c] = np.where(across < 0.0, ROAD, BESIDE)
    group[r, c] = side[r, c]
    divided = Cells(height, cells.information, group)
    road = beside_steps(steps, divided, ROAD, (-FAR_M, -SMEAR_M, HALF_M), raster)
    upper = beside_steps(steps, divided, BESIDE, (SMEAR_M, FAR_M, HALF_M), raster)
    rise = _even(steps)
    lack = np.nan_to_num(np.clip(rise - (upper - road)[:, 0], -MOST_LACK_M, MOST_LACK_M))
    upper = np.where(np.isnan(upper), road + rise[:, None] * [1.0, 0.0, 0.0], upper)
    plane = np.where((across < 0.0)[:, None], road[s], upper[s])
    level = plane[:, 0] + plane[:, 1] * across + plane[:, 2] * along
    height[r, c] = np.where((np.abs(across) < SMEAR_M) & np.isfinite(level), level, height[r, c])
    fading = np.maximum(1.0 - np.abs(across) / SIDE_M, 0.0)
    height[r, c] += np.where(across < 0.0, -0.5, 0.5) * lack[s] * fading
    return Cells(height, cells.information, group), side


def _from_step(steps: Steps, station: NDArray[np.int64], xy: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(N,) m of places xy (N, 2) across the step of their station, away from the road, and along it."""
    x, y = (xy - steps.xy[station]).T
    nx, ny = steps.normals[station].T
    return x * nx + y * ny - steps.at[station], y * nx - x * ny


def _even(steps: Steps) -> FloatArray:
    """(S,) m: the steps' heights, each the mean of those around, weighted by how sure they are; NaN without a step."""
    there = np.isfinite(steps.at)
    weight = np.where(there, steps.gain, 0.0)
    moment, total = (windowed(values, steps.start, RISE_STATIONS) for values in (np.where(there, weight * steps.rise, 0.0), weight))
    return np.where(there, moment / np.maximum(total, 1e-12), np.nan)


def give_to_sides(votes: NDArray[np.float32], side: NDArray[np.uint8]) -> None:
    """Give the votes (H, W, >= 3) of road, sidewalk and terrain, in place, to the side on which a cell lies: kerbs end the road.

    On the upper side the road's votes go to what else has more, sidewalk where nothing has.
    """
    road, beside = side == ROAD, side == BESIDE
    votes[road, 0] += votes[road, 1] + votes[road, 2]
    votes[road, 1:3] = 0.0
    rows, columns = np.nonzero(beside)
    to = np.where(votes[rows, columns, 2] > votes[rows, columns, 1], 2, 1)
    votes[rows, columns, to] += votes[rows, columns, 0]
    votes[beside, 0] = 0.0
