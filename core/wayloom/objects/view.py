"""View of a keyframe that is searched for objects: its pair, labels and place, at a size that is quick to match."""

from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.geometry.camera import StereoRig
from wayloom.objects.kernels.matching import match_rectangles
from wayloom.places.stereo_pair import StereoPair

Image = NDArray[np.uint8]
FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
WIDEST_PX: Final = 900
"""Wider images are halved: poles and signs within reach have pixels enough in them."""
NEAREST_M: Final = 2.0
MOST_PX: Final = 160
UNIQUENESS: Final = 0.85


@dataclass(frozen=True, slots=True)
class ObjectView:
    """left, right, label (h, w); rig of this size and bias_px of its disparities; T_level_cam (4, 4); t_ns of the image."""

    left: Image
    right: Image
    label: Image
    rig: StereoRig
    bias_px: float
    T_level_cam: FloatArray
    t_ns: int

    def match(self, rectangles: IntArray, start: IntArray | None = None) -> tuple[FloatArray, FloatArray]:
        """Disparity, without bias, and its sigma (n,) px of rectangles (n, 4) u0, v0, u1, v1; NaN without a sure match.

        start : (g + 1,) where groups of rectangles begin that have one disparity; results are (g,) then
        """
        start = np.arange(len(rectangles) + 1) if start is None else start
        found = np.empty((len(start) - 1, 2))
        most = int(min(np.ceil(self.rig.bf / NEAREST_M), MOST_PX))
        match_rectangles(self.left, self.right, np.ascontiguousarray(rectangles, np.int64), start, most, UNIQUENESS, found)
        return found[:, 0] - self.bias_px, found[:, 1]

    def rays(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """(n, 3) directions of pixels, z = 1, camera frame."""
        c = self.rig.camera
        return np.column_stack([(u - c.cx) / c.fx, (v - c.cy) / c.fy, np.ones(len(u))])

    def points(self, u: FloatArray, v: FloatArray, disparity: FloatArray) -> FloatArray:
        """(n, 3) m, level frame, of pixels with their disparities px."""
        in_cam = self.rays(u, v) * (self.rig.bf / disparity)[:, None]
        return in_cam @ self.T_level_cam[:3, :3].T + self.T_level_cam[:3, 3]


def view_of(pair: StereoPair, rig: StereoRig, bias_px: float, T_level_cam: FloatArray, t_ns: int) -> ObjectView:
    """The view of a pair, halved until it is at most WIDEST_PX wide. bias_px : of the disparities at full size."""
    left, right, label, level = pair.left, pair.right, pair.label, 0
    while left.shape[1] > WIDEST_PX:
        even = (slice(0, left.shape[0] & ~1), slice(0, left.shape[1] & ~1))
        size = (left.shape[1] // 2, left.shape[0] // 2)
        left, right = (np.asarray(cv2.resize(one[even], size, interpolation=cv2.INTER_AREA), np.uint8) for one in (left, right))
        label, level = label[even][::2, ::2], level + 1
    small = replace(rig, camera=rig.camera.at_level(level)) if level else rig
    return ObjectView(left, right, np.ascontiguousarray(label), small, bias_px / 2**level, T_level_cam, t_ns)
