"""Rectified stereo pair of a keyframe with its label image, and depth at its pixels."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_COUNT, MOVING_CLASSES, SKY
from wayloom.logs.types import DriveLog
from wayloom.odometry.frame_source import grey_pair
from wayloom.odometry.points import stereo
from wayloom.odometry.rig.rows import RightRectifier
from wayloom.odometry.types import OdometryResult

Image = NDArray[np.uint8]
FloatArray = NDArray[np.float64]
MAX_DISPARITY_PX = 180
UNIQUENESS = 0.85
MAX_COST = 12.0
SLOPE_CAP = 60
LARGEST_SIGMA_PX = 0.3
"""Of a match by its patch alone: those that are less sure are mostly wrong."""
SIGMA_FLOOR_PX, SIGMA_FACTOR = 0.15, 1.7
"""Patches that are not flat move a disparity, and hide how much: its sigma is the root of floor^2 + (factor sigma)^2."""
STATIC = np.array([c < CLASS_COUNT and c != SKY and c not in MOVING_CLASSES for c in range(256)])
"""(256,) whether a train id may be kept of a place."""


class LeftLabels(Protocol):
    """Label images of the keyframes, as `wayloom.segmentation.keyframe_labels.KeyframeLabels`."""

    def left(self, keyframe: int, /) -> NDArray[np.uint8]:
        """(h, w) uint8 train ids of the left image of the keyframe in this row."""
        ...


@dataclass(frozen=True, slots=True)
class StereoPair:
    """left, right (h, w) uint8 grey, rows aligned and the lens undone; label (h, w) uint8 train ids of the left image."""

    left: Image
    right: Image
    label: Image

    def depth(self, pixels: NDArray[np.int64], odometry: OdometryResult) -> tuple[FloatArray, FloatArray]:
        """Depth along the left camera's z axis and its sigma, m, (n,) each, of left pixels (n, 2); NaN without a sure match."""
        found = stereo.match(self.left, self.right, pixels, MAX_DISPARITY_PX, UNIQUENESS, MAX_COST, SLOPE_CAP)
        disparity = found[:, 0] - odometry.disparity_bias_px
        sigma_px = np.hypot(SIGMA_FLOOR_PX, SIGMA_FACTOR * np.minimum(found[:, 1], LARGEST_SIGMA_PX))
        matched = (found[:, 1] < LARGEST_SIGMA_PX) & (disparity > 2.0 * sigma_px)
        depth = np.where(matched, odometry.rig.bf / np.where(matched, disparity, 1.0), np.nan)
        return depth, depth * depth * sigma_px / odometry.rig.bf


def right_rectifier(odometry: OdometryResult) -> RightRectifier:
    """The rectification of the log's right images as the odometry left it.

    Its row coefficients hold what the lens does to the rows, which the rectifier does by itself: they are told apart by a rectifier
    of the lens alone.
    """
    of_lens = RightRectifier(odometry.rig, odometry.lens, np.zeros(3)).all_rows()
    return RightRectifier(odometry.rig, odometry.lens, odometry.row_coefficients - of_lens)


def read_pair(log: DriveLog, frame: int, label: Image, rectifier: RightRectifier) -> StereoPair:
    """The pair `frame` of the log. Raises LogError where an image cannot be read."""
    pair = grey_pair(log, frame)
    return StereoPair(pair.left, rectifier.align(pair.right), label)
