"""Looks: small images of how far a drive saw, by keyframe."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_ID, MOVING_CLASSES, SKY
from wayloom.geometry.camera import PinholeCamera

Image = NDArray[np.uint8]
UNSURE, INFINITY = 0, 255
"""Codes of a patch that was not matched, and of what is further than all depths."""
DEPTH_RATIO: Final = 1.0175
DEPTHS_M: Final = np.multiply.accumulate(np.concatenate([[1.0], np.full(INFINITY - 2, DEPTH_RATIO)]))
"""(254,) m along the camera's z axis: code c, 1 to 254, is DEPTHS_M[c - 1]. By products, so that they are the same everywhere."""
MOVING, OPEN_SKY, THIN, GREEN, BUILT, GROUND = (1 << bit for bit in range(6))
"""Bits of a patch's kinds: pixels of which it has."""
KINDS_OF_CLASS: Final = np.zeros(256, np.uint8)
for _bit, _names in (
    (THIN, ("pole", "traffic light", "traffic sign")), (GREEN, ("vegetation",)), (BUILT, ("building", "wall", "fence")),
    (GROUND, ("road", "sidewalk", "terrain")),
):  # fmt: skip
    KINDS_OF_CLASS[[CLASS_ID[name] for name in _names]] = _bit
KINDS_OF_CLASS[list(MOVING_CLASSES)] = MOVING
KINDS_OF_CLASS[SKY] = OPEN_SKY


@dataclass(frozen=True, slots=True)
class Looks:
    """N looks of one drive.

    camera  of the small image: its pixels are patches of the left image's
    sigma   1/m, of the inverse depth of a pixel
    frame   (N,) uint32 frames of the drive, increasing: keyframes
    near    (N, h, w) uint8 code of the nearest sure pixel of each patch, rounded towards the camera; UNSURE; INFINITY
    far     (N, h, w) uint8 code of the furthest, rounded away from it
    kinds   (N, h, w) uint8 bits of what the patch's pixels were taken for
    """

    camera: PinholeCamera
    sigma: float
    frame: NDArray[np.uint32]
    near: Image
    far: Image
    kinds: Image

    def __len__(self) -> int:
        return len(self.frame)

    def take(self, rows: NDArray[np.int64]) -> "Looks":
        """The looks of these rows (n,)."""
        return Looks(self.camera, self.sigma, self.frame[rows], self.near[rows], self.far[rows], self.kinds[rows])
