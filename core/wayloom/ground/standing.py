"""Ground beside things that stand on it, whatever their labels: shown in no orthophoto.

A network that misses a person, or half of one, takes the legs for ground. Their depth tells: what stands above the surface, in
this one view, is refused with the margin that labelled persons have, which also takes the feet. So is what stereo cannot match
in one piece, as sides of cars and what only the left image sees.
"""

from dataclasses import replace
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_ID
from wayloom.geometry.camera import StereoRig
from wayloom.ground.kernels.pieces import large_pieces
from wayloom.ground.kernels.standing import add_feet, stands
from wayloom.ground.raster import Raster
from wayloom.ground.settings import GroundSettings
from wayloom.ground.sheet import CELL_M
from wayloom.ground.view import GROUP, GroundView, numbers, within

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
LEAST_M, LEAST_OVER_PLANE_M = 0.08, 0.2
LARGE_STATIC: Final = np.isin(np.arange(256), [CLASS_ID[name] for name in ("building", "wall", "fence", "vegetation")])
"""(256,) whether a train id is one of large things that stay: they get the margin, but are not followed to their feet."""
NOISE_PX: Final = 0.5
LEAST_STANDING, LEAST_UNMATCHED = 2e-5, 6e-5
"""Smallest pieces that get a margin, as shares of the square of the image's width; smaller ones are refused themselves."""


def without_standing(
    view: GroundView, raster: Raster, height: FloatArray, rig: StereoRig, bias_px: float, settings: GroundSettings
) -> GroundView:
    """The view that shows nothing where something stands or nothing is matched, nor near to pieces of it.

    height : (H, W) m of the raster's cells, NaN without surface
    """
    standing, reached = np.zeros(view.above.shape, np.bool_), np.zeros(view.above.shape, np.bool_)
    foot = np.zeros(view.above.shape, np.int32)
    stands(
        view.above, view.first_row, view.plane_row, numbers(rig.camera), rig.bf, bias_px, view.plane.camera_height_m(rig, bias_px),
        view.T_sheet_cam, settings.reach_m, height, raster.low, CELL_M, LEAST_M, LEAST_OVER_PLANE_M, NOISE_PX, standing, foot,
    )  # fmt: skip
    label = view.label[view.first_row :]
    unmatched = np.isnan(view.above) & (cv2.LUT(label, GROUP) > 0)
    width = view.label.shape[1]
    standing_pieces = pieces(standing, LEAST_STANDING * width**2)
    add_feet(standing_pieces & (cv2.LUT(label, LARGE_STATIC.view(np.uint8)) == 0), foot, reached)
    large = reached | standing_pieces | pieces(unmatched, LEAST_UNMATCHED * width**2)
    near = within(large.view(np.uint8), round(settings.mover_margin_share * width)).view(np.bool_)
    shown = view.shown.copy()
    shown[near | standing | unmatched] = 0.0
    return replace(view, shown=shown)


def pieces(marked: BoolArray, least: float) -> BoolArray:
    """The marked (h, w) of pieces, joined by their sides, that have at least so many. By runs, which are far fewer than the pixels
    that OpenCV labels."""
    out = np.zeros(marked.shape, np.bool_)
    large_pieces(marked, least, out)
    return out
