"""Orthophoto and votes of a sheet: every cell from the views that see it best."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_COUNT, MOVING_CLASSES
from wayloom.config.side_by_side import Each, runs
from wayloom.geometry import se3
from wayloom.geometry.camera import StereoRig
from wayloom.ground.kernels.picture import add_colours, add_votes
from wayloom.ground.raster import Raster
from wayloom.ground.settings import GroundSettings
from wayloom.ground.sheet import CELL_M, GROUND_CLASSES
from wayloom.ground.view import GroundView, numbers

FloatArray = NDArray[np.float64]
POWER: Final = 3
"""Of the sharpness, by which views weigh: so high that the best view all but decides, so low that no seam shows."""
SLACK: Final = 0.12
"""Share of a disparity by which a view's own may differ before something else is seen there."""
OTHER: Final = len(GROUND_CLASSES)
STRIPS: Final = 4
"""Of a sheet's rows, that several threads fill."""
KIND_OF: Final = np.full(256, -1, np.int8)
"""(256,) column of the votes of a train id; -1 for what moves and void, which say nothing of the ground."""
KIND_OF[[c for c in range(CLASS_COUNT) if c not in MOVING_CLASSES]] = OTHER
KIND_OF[list(GROUND_CLASSES)] = np.arange(len(GROUND_CLASSES))


@dataclass(frozen=True, slots=True)
class Picture:
    """votes (H, W, 4) 1/m of the ground's classes and all others; colour (2H, 2W, C), sharpness (2H, 2W) px/m, 0 unseen."""

    votes: NDArray[np.float32]
    colour: NDArray[np.float32]
    sharpness: NDArray[np.float32]


def picture_of(
    views: list[GroundView], raster: Raster, height: FloatArray, rig: StereoRig, bias_px: float, settings: GroundSettings,
    each: Each = map,
) -> Picture:  # fmt: skip
    """What the views show of a surface of heights (H, W); each : of strips of its rows."""
    rows, columns = raster.shape
    channels = views[0].image.shape[2]
    votes = np.zeros((rows, columns, OTHER + 1), np.float32)
    colour = np.zeros((2 * rows, 2 * columns, channels), np.float32)
    weight, sharp = (np.zeros((2 * rows, 2 * columns), np.float32) for _ in range(2))
    camera = numbers(rig.camera)

    def fill(strip: slice) -> None:
        for view in views:
            T_cam_sheet = se3.inverse(view.T_sheet_cam)
            window = raster.window(view.T_sheet_cam[:2, 3], settings.reach_m)
            window[:2] = window[:2].clip(strip.start, strip.stop)
            if window[0] == window[1]:
                continue
            sight = (view.above, view.first_row, view.plane_row, camera, rig.bf, bias_px, T_cam_sheet, settings.reach_m, SLACK)
            add_votes(height, raster.low, CELL_M, window, view.label, KIND_OF, *sight, votes)
            add_colours(
                height, raster.low, CELL_M, window, view.image, view.first_row, view.gain, view.offset, view.fall_off, view.shown,
                *sight, POWER, colour, weight, sharp,
            )  # fmt: skip
        fine = slice(2 * strip.start, 2 * strip.stop)
        weight[fine][weight[fine] == 0.0] = 1.0
        colour[fine] /= weight[fine, :, None]
        sharp[fine] /= weight[fine]

    list(each(fill, runs(rows, STRIPS)))
    return Picture(votes, colour, sharp)
