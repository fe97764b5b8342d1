"""Dense disparity of a rectified stereo pair by semi-global matching, left against right and right against left.

Hirschmüller, "Stereo Processing by Semiglobal Matching and Mutual Information" (TPAMI 2008), in OpenCV's form: costs of
Birchfield and Tomasi over blocks, three paths. It computes in whole numbers, so the same images give the same bits.
"""

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.dense.kernels.patches import keep_returning
from wayloom.geometry.camera import StereoRig

Image = NDArray[np.uint8]
FloatArray = NDArray[np.float64]
NEAREST_M: Final = 2.0
"""Nothing nearer is matched."""
STEP: Final = 16
"""OpenCV searches multiples of so many pixels."""
LARGEST_PX: Final = 192
BLOCK_PX: Final = 3
SMALL_STEP, LARGE_STEP = 8 * BLOCK_PX**2, 32 * BLOCK_PX**2
"""Penalties of disparities that change by one pixel and by more, as OpenCV recommends them."""
CONTRAST: Final = 63
UNIQUENESS_PERCENT: Final = 15
SUBPIXELS: Final = 16.0


def search_px(rig: StereoRig) -> int:
    """Disparities that are searched."""
    return int(min(STEP * np.ceil(rig.bf / NEAREST_M / STEP), LARGEST_PX))


def dense_disparity(left: Image, right: Image, search: int, check_px: float) -> FloatArray:
    """(h, w) px: u_left - u_right of each left pixel; NaN where the search from the right image does not come back to it.

    left, right : (h, w) uint8, rows aligned
    search      : disparities up to this are found, a multiple of STEP
    """
    there = _matched(left, right, search)
    back = _matched(right[:, ::-1], left[:, ::-1], search)
    sure = np.empty_like(there)
    keep_returning(there, back, check_px, sure)
    return sure


def _matched(left: Image, right: Image, search: int) -> FloatArray:
    """(h, w) px; not positive without a match. OpenCV leaves `search` columns at the left empty: they are added first."""
    bordered = [cv2.copyMakeBorder(np.ascontiguousarray(image), 0, 0, search, 0, cv2.BORDER_REPLICATE) for image in (left, right)]
    matcher = cv2.StereoSGBM.create(
        0, search, BLOCK_PX, SMALL_STEP, LARGE_STEP, -1, CONTRAST, UNIQUENESS_PERCENT, 0, 0, cv2.STEREO_SGBM_MODE_SGBM_3WAY
    )
    found = matcher.compute(*bordered)[:, search:]
    return np.asarray(found / SUBPIXELS, np.float64)
