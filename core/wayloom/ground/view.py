"""View of the ground: what one keyframe's stereo pair tells of the ground before it."""

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_COUNT, CLASS_ID, MOVING_CLASSES
from wayloom.geometry.camera import PinholeCamera
from wayloom.ground.kernels.pieces import near
from wayloom.ground.plane import GroundPlane, above_plane, find_plane, first_to_match
from wayloom.ground.settings import GroundSettings
from wayloom.ground.sheet import GROUND_CLASSES
from wayloom.logs.types import DriveLog
from wayloom.odometry.rig.rows import RightRectifier
from wayloom.odometry.tracking.pyramid import grey

Image = NDArray[np.uint8]
FloatArray = NDArray[np.float64]
ROAD, BESIDE = 1, 2
GROUP: Final = np.zeros(256, np.uint8)
"""(256,) group of a train id: surfaces of different groups are not one surface. 0 is no ground."""
GROUP[list(GROUND_CLASSES)] = [ROAD if c == CLASS_ID["road"] else BESIDE for c in GROUND_CLASSES]
MAY_MOVE: Final = np.array([c >= CLASS_COUNT or c in MOVING_CLASSES for c in range(256)])
"""(256,) whether a train id is one of persons and vehicles, or void, which may be one."""
SEARCH_STEP: Final = 8
FEATHER_PX: Final = 8
SURE_INSIDE: Final = 0.25
"""Of `shown`: pixels that tell heights. Nearer to what stands there, matching mixes the two."""
LEAST_ROWS: Final = 16
HORIZON_SHARE: Final = 1.3
"""Rows are matched from where the plane is so many times the reach away: ground falls and rises."""


@dataclass(frozen=True, slots=True)
class GroundView:
    """T_sheet_cam (4, 4); plane of disparities; rows from first_row on: above (h', w) px over the plane, image (h', w, C) uint8 of
    the left camera, right (h', w) uint8 of the right one, rows aligned, and shown (h', w) float32 0 to 1: how far inside of what
    may be shown; 0 where a person, a vehicle or no ground is near. A sheet holds all its views: none keeps whole images alive.

    label   (h, w) uint8 train ids of the whole image
    gain, offset, fall_off   take the image's values to the drive's exposure (`exposure.DriveExposure`)
    """

    T_sheet_cam: FloatArray
    plane: GroundPlane
    first_row: int
    above: NDArray[np.float32]
    image: Image
    right: Image
    label: Image
    shown: NDArray[np.float32]
    gain: float
    offset: float
    fall_off: float

    @property
    def group(self) -> Image:
        """(h', w) group of the matched rows' pixels, 0 where they may not be used."""
        return np.where(self.shown >= SURE_INSIDE, cv2.LUT(self.label[self.first_row :], GROUP), np.uint8(0))

    @property
    def plane_row(self) -> FloatArray:
        """(3,) of the plane, as kernels take it."""
        return np.array([self.plane.slope_u, self.plane.slope_v, self.plane.offset])


def see_ground(
    log: DriveLog,
    frame: int,
    label: Image,
    rectifier: RightRectifier,
    T_sheet_cam: FloatArray,
    exposure: tuple[float, float, float],
    settings: GroundSettings,
) -> GroundView | None:
    """The view of one frame; None where it shows too little ground. Raises LogError where an image cannot be read.

    exposure : gain, offset and fall_off of the view (`GroundView`)
    """
    pair, rig = log.frame(frame), log.rig
    left, whole_right = grey(pair.left), grey(pair.right)
    shown = may_be_shown(label, settings.mover_margin_share)
    start = first_to_match(shown > 0.0)
    right = rectifier.align(whole_right, start)
    plane = find_plane(left[start:], right, shown[start:] > 0.0, start, rig)
    if plane is None:
        return None
    height, width = left.shape
    least = rig.bf / (HORIZON_SHARE * settings.reach_m)
    first_row = int(np.ceil(min(plane.row_of(least, column) for column in (0.0, width - 1.0))))
    first_row = max(first_row, 0)
    if height - first_row < LEAST_ROWS:
        return None
    search = SEARCH_STEP * max(1, round(settings.search_share * width / SEARCH_STEP))
    right = right[first_row - start :].copy() if first_row >= start else rectifier.align(whole_right, first_row)
    above = above_plane(left[first_row:], right, plane, first_row, search)
    image = pair.left[first_row:].copy().reshape(height - first_row, width, -1)
    return GroundView(T_sheet_cam, plane, first_row, above, image, right, label, shown[first_row:].copy(), *exposure)


def numbers(camera: PinholeCamera) -> FloatArray:
    """(4,) fx, fy, cx, cy, as kernels take them."""
    return np.array([camera.fx, camera.fy, camera.cx, camera.cy])


def may_be_shown(label: Image, margin_share: float) -> NDArray[np.float32]:
    """(h, w) 0 to 1 of an image of train ids: 0 but on ground that no person or vehicle is nearer to than the margin, 1 well
    inside of it."""
    margin = round(margin_share * label.shape[1])
    shown = np.zeros(label.shape, np.float32)
    ground = cv2.LUT(label, GROUP)
    first = max(int(ground.any(axis=1).argmax()) - 1, 0)
    ground = ground[first:]
    above = min(margin, first)
    movers = np.asarray(cv2.LUT(label[first - above :], MAY_MOVE.view(np.uint8)), np.uint8)
    ground[within(movers, margin)[above:] > 0] = 0
    inside = cv2.distanceTransform(cv2.copyMakeBorder(ground, 1, 1, 1, 1, cv2.BORDER_REPLICATE), cv2.DIST_L2, 3)[1:-1, 1:-1]
    np.clip((inside - 1.0) / FEATHER_PX, 0.0, 1.0, out=shown[first:])
    return shown


def within(marked: Image, radius: int) -> Image:
    """(h, w) uint8: 1 where a pixel of marked (h, w) uint8 that is not 0 lies within a disc of the radius, 0 elsewhere."""
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    out = np.zeros(marked.shape, np.uint8)
    near(marked, np.asarray(disc.sum(axis=1) // 2, np.uint16), out)
    return out
