"""Image pyramids and the camera models of their levels."""

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.geometry.camera import PinholeCamera
from wayloom.odometry.kernels.arrays import Rig
from wayloom.odometry.kernels.images import halved

SMALLEST_SIDE = 16
Image = NDArray[np.uint8]
Pyramid = list[NDArray[np.uint8] | NDArray[np.float32]]
"""An image (h, w) uint8 and its halves, quarters …, float32."""


def grey(image: Image) -> Image:
    """(h, w) or (h, w, 3) RGB uint8 to contiguous (h, w) uint8."""
    return np.ascontiguousarray(image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY))


def level_count(camera: PinholeCamera, wanted: int) -> int:
    """At most `wanted` levels, fewer where the coarsest would be smaller than 16 px."""
    levels = 1
    while levels < wanted and min(camera.width, camera.height) >> levels >= SMALLEST_SIDE:
        levels += 1
    return levels


def halve(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """(h, w) float32 to (h // 2, w // 2): means of 2x2 pixels, an odd last row or column left out."""
    h, w = image.shape[0] // 2, image.shape[1] // 2
    return np.asarray(cv2.resize(image[: 2 * h, : 2 * w], (w, h), interpolation=cv2.INTER_AREA), np.float32)


def build(image: Image, levels: int) -> Pyramid:
    """(h, w) uint8 to `levels` images, finest first: itself, and float32 ones half as large each."""
    out: Pyramid = [image]
    if levels > 1:
        below = np.asarray(halved(image), np.float32)
        out.append(below)
        for _ in range(2, levels):
            below = halve(below)
            out.append(below)
    return out


def level_cameras(camera: PinholeCamera, levels: int) -> list[NDArray[np.float64]]:
    """(4,) fx, fy, cx, cy in px of each level, finest first."""
    cameras = [camera.at_level(level) for level in range(levels)]
    return [np.array([c.fx, c.fy, c.cx, c.cy]) for c in cameras]


def rig_numbers(camera: PinholeCamera, t_right_left: tuple[float, float, float]) -> Rig:
    """The rig as the kernels take it."""
    return Rig(camera.fx, camera.fy, camera.cx, camera.cy, *(float(t) for t in t_right_left))
