"""Height surface of a sheet: robust heights of cells from all views, smoothed where they are one surface.

Far from the camera, views err together over metres: what no near view tells is held to the surface around it.
"""

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.config.side_by_side import Each, runs
from wayloom.geometry.camera import StereoRig
from wayloom.ground.edges import find_steps
from wayloom.ground.kernels.samples import gather_heights
from wayloom.ground.kernels.surface import block_heights, cell_heights, smooth_blocks, smooth_surface
from wayloom.ground.raster import Cells, Raster
from wayloom.ground.settings import GroundSettings
from wayloom.ground.sheet import CELL_M
from wayloom.ground.sides import laid
from wayloom.ground.view import BESIDE, ROAD, GroundView, numbers

FloatArray = NDArray[np.float64]
SIGMA_PX: Final = 0.3
"""Of the disparity of one view's pixels in a cell."""
CORRELATED: Final = 8.0
"""Samples of neighbouring cells and views that are wrong together: so many count as one."""
FLOOR_M: Final = 0.014
"""Sigma that no number of views takes away: what they have in common."""
FILLED_M: Final = 0.03
"""Sigma that is added where a cell's height comes from its neighbours alone."""
BORDER_CELLS: Final = 2
BORDER_M, AT_STEP_M = 0.04, 0.02
"""Sigma that is added so near to ground of the other group: where no step was found, since matching smears what there is of
one, and where one was."""
STEP_M: Final = 0.03
"""Heights that differ from the plane by more are of another surface."""
BLOCK_CELLS, BROAD_BLOCKS = 4, 5
"""Of the broad surface: cells of a block's side, and blocks to either side over which it is a plane, 2.2 m."""
BEND_M: Final = 0.05
"""Sigma of what the ground is off its broad surface, and the scale by which blocks and cells are of another one."""
MOST_ABOVE: Final = (0.35, 0.06)
"""m, and share of the depth: what is further over or under a view's plane is no ground."""


VIEWS_AT_ONCE: Final = 16
"""Whose samples are gathered in one piece of memory."""
STRIPS: Final = 4
"""Of a sheet's rows, that several threads smooth."""


@dataclass(frozen=True, slots=True)
class Surface:
    """height (H, W) m, NaN without surface; sigma (H, W) m; side (H, W) uint8: ROAD or BESIDE around kerbs, else 0."""

    height: FloatArray
    sigma: FloatArray
    side: NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Samples:
    """Heights by view and cell: key (N,) 2 * cell + group - 1, height (N,) m, variance (N,) m^2."""

    key: NDArray[np.int64]
    height: FloatArray
    variance: FloatArray


def surface_of(
    views: list[GroundView], raster: Raster, rig: StereoRig, bias_px: float, settings: GroundSettings, each: Each = map
) -> Surface:
    """The surface that the views tell of. bias_px : of the disparities; each : of the views, of stations, and of strips of rows."""
    cells = fuse(gather(views, raster, rig, bias_px, settings.reach_m, each), raster.shape)  # samples are held by nobody else
    cells, side = laid(find_steps(views, raster, cells, rig, bias_px, each), cells, raster)
    return smooth(cells, side, round(settings.smoothing_m / CELL_M), each)


def gather(
    views: list[GroundView], raster: Raster, rig: StereoRig, bias_px: float, reach_m: float, each: Each = map
) -> Samples:  # fmt: skip
    """One sample for each view, cell and group."""

    def of_views(some: slice) -> Samples:
        return _joined(_gather(views[some], raster, rig, bias_px, reach_m))

    return _joined(list(each(of_views, runs(len(views), -(-len(views) // VIEWS_AT_ONCE)))))


def _joined(parts: list[Samples]) -> Samples:
    """All of them, taken out of the list: no more than a column is in memory twice."""
    columns = {name: [getattr(part, name) for part in parts] for name in ("key", "height", "variance")}
    parts.clear()
    return Samples(*(np.concatenate(columns.pop(name)) for name in ("key", "height", "variance")))


def _gather(views: list[GroundView], raster: Raster, rig: StereoRig, bias_px: float, reach_m: float) -> list[Samples]:
    """Of each view."""
    cells = 2 * raster.shape[0] * raster.shape[1]
    sums, counts = np.zeros((cells, 2)), np.zeros(cells, np.int32)
    parts: list[Samples] = []
    camera = numbers(rig.camera)
    for view in views:
        room = view.above.size
        key, height, variance = np.empty(room, np.int64), np.empty(room), np.empty(room)
        found = gather_heights(
            view.above, view.group, view.plane_row, view.first_row, camera, rig.bf, bias_px, view.T_sheet_cam, reach_m,
            np.array([view.plane.camera_height_m(rig, bias_px), *MOST_ABOVE]), raster.low, CELL_M, np.array(raster.shape), sums,
            counts, key, height, variance,
        )  # fmt: skip
        parts.append(Samples(key[:found].copy(), height[:found].copy(), SIGMA_PX**2 * variance[:found]))
    return parts


def fuse(samples: Samples, shape: tuple[int, int]) -> Cells:
    """What the samples tell of each cell by itself."""
    height, information = np.zeros(shape), np.zeros(shape)
    group = np.zeros(shape, np.uint8)
    order = np.argsort(samples.key, kind="stable")
    flat = (height.reshape(-1), information.reshape(-1), group.reshape(-1))
    cell_heights(samples.key, order, samples.height, samples.variance, *flat)
    return Cells(height, information, group)


def smooth(cells: Cells, side: NDArray[np.uint8], radius: int, each: Each = map) -> Surface:
    """The surface of cells (H, W), whose side (H, W) is told of with it; radius in cells."""
    height, information, group = cells.height, cells.information, cells.group
    smoothed, variance, filled = np.zeros(height.shape), np.zeros(height.shape), np.zeros(height.shape, bool)
    broad, bend2 = broad_surface(height, information, group), BEND_M**2 / CORRELATED

    def smooth_rows(rows: slice) -> None:
        about = (height, information, group, *broad, BLOCK_CELLS, bend2, radius, STEP_M, rows.start, rows.stop)
        smooth_surface(*about, smoothed, variance, filled)

    list(each(smooth_rows, runs(len(height), STRIPS)))
    sigma = np.sqrt(CORRELATED * variance + FLOOR_M**2 + np.where(filled, FILLED_M**2, 0.0) + _border_variance(group, side))
    return Surface(np.where(variance > 0.0, smoothed, np.nan), sigma, side)


def _border_variance(group: NDArray[np.uint8], side: NDArray[np.uint8]) -> FloatArray:
    """(H, W) m^2 that the border of road and what is beside it adds."""
    square = np.ones((2 * BORDER_CELLS + 1, 2 * BORDER_CELLS + 1), np.uint8)
    near_road, near_beside = (cv2.dilate((group == of).astype(np.uint8), square) > 0 for of in (ROAD, BESIDE))
    at_border = np.where(side > 0, AT_STEP_M**2, BORDER_M**2)
    return np.where(near_road & near_beside, at_border, 0.0)


def broad_surface(height: FloatArray, information: FloatArray, group: NDArray[np.uint8]) -> tuple[FloatArray, FloatArray]:
    """Height m and variance m^2 (0: none) by group of the blocks of cells (H, W): (2, rows, columns) of blocks each."""
    shape = (2, *(-(-side // BLOCK_CELLS) for side in height.shape))
    blocks, weights, broad, variance = (np.zeros(shape) for _ in range(4))
    block_heights(height, information, group, BLOCK_CELLS, BEND_M, blocks, weights)
    smooth_blocks(blocks, weights, BROAD_BLOCKS, BEND_M, broad, variance)
    return broad, variance
