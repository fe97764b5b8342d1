"""Ground plane of one stereo pair in disparity space, and matching against it.

A plane of the world is one of disparities: d(u, v) = a u + b v + c. The right image, warped by it, lies on the left one wherever
the scene is on the plane, so that slanted ground has the disparity zero: few disparities are searched, and blocks lie on what
they match
(Williamson and Thorpe, "A specialized multibaseline stereo technique for obstacle detection", CVPR 1998).
A pixel at height H over the plane, of a camera h above it, is left with e = d - d_plane = H d / h.
"""

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.dense.disparity import SUBPIXELS
from wayloom.geometry.camera import StereoRig

Image = NDArray[np.uint8]
FloatArray = NDArray[np.float64]
COARSE_WIDTH_PX: Final = 360
"""Images are halved to this width, at least, before their plane is looked for."""
STEP: Final = 16
"""OpenCV searches multiples of so many pixels."""
NEAREST_M: Final = 2.5
LEAST_PIXELS: Final = 150
ROWS_ABOVE: Final = 8
"""Of the small images, over the first one with ground: from where matching has settled."""
FEWEST_ROWS: Final = 16
"""That are matched."""
ROUNDS: Final = 12
FIRST_SCALE_PX, LAST_SCALE_PX = 4.0, 0.4
BLOCK_PX: Final = 5
CONTRAST: Final = 63
UNIQUENESS_PERCENT: Final = 5
SPECKLE_PX, SPECKLE_STEP = 60, 1
UNMATCHED: Final = np.float32(np.nan)


@dataclass(frozen=True, slots=True)
class GroundPlane:
    """d = slope_u u + slope_v v + offset, px of disparity as measured (the rig's bias in it), at full size."""

    slope_u: float
    slope_v: float
    offset: float

    def disparity(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Disparities at pixels u, v."""
        return self.slope_u * u + self.slope_v * v + self.offset

    def row_of(self, disparity: float, column: float) -> float:
        """The row in which the plane has this disparity at a column; the plane's horizon for 0."""
        return (disparity - self.offset - self.slope_u * column) / self.slope_v

    def camera_height_m(self, rig: StereoRig, bias_px: float) -> float:
        """Distance of the camera from the plane: d - bias = bf n·ray / h, n the plane's normal."""
        camera = rig.camera
        level = self.slope_u * camera.cx + self.slope_v * camera.cy + self.offset - bias_px
        return float(rig.bf / np.linalg.norm([self.slope_u * camera.fx, self.slope_v * camera.fy, level]))


def find_plane(left: Image, right: Image, is_ground: NDArray[np.bool_], rig: StereoRig) -> GroundPlane | None:
    """The plane of a pair (h, w), rows aligned; None where too little ground is matched, or what is matched is no ground.

    is_ground : (h, w) pixels by whose disparities it is fitted
    """
    level = 0
    while left.shape[1] >> (level + 1) >= COARSE_WIDTH_PX:
        level += 1
    scale = 1 << level
    size = (left.shape[1] // scale, left.shape[0] // scale)
    small = [np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8) for image in (left, right)]
    search = int(STEP * np.ceil(rig.bf / scale / NEAREST_M / STEP))
    ground = is_ground[scale // 2 :: scale, scale // 2 :: scale][: size[1], : size[0]]
    rows = np.flatnonzero(ground.any(axis=1))
    if not len(rows):
        return None
    first = max(min(int(rows[0]) - ROWS_ABOVE, size[1] - FEWEST_ROWS), 0)
    disparity = _matched(small[0][first:], small[1][first:], 0, search)
    v, u = np.nonzero((disparity > 0.0) & ground[first:])
    if len(u) < LEAST_PIXELS:
        return None
    uv = np.column_stack([u, v + first]).astype(np.float64) * scale + 0.5 * (scale - 1)
    return fit_plane(uv[:, 0], uv[:, 1], scale * disparity[v, u].astype(np.float64))


def fit_plane(u: FloatArray, v: FloatArray, disparity: FloatArray) -> GroundPlane | None:
    """The plane of disparities (N,) px at pixels u, v (N,), by weights of Cauchy that grow strict; None where it does not rise to
    the horizon."""
    A = np.column_stack([u, v, np.ones(len(u))])
    weight = np.ones(len(u))
    x: FloatArray = np.zeros(3)
    for scale in np.geomspace(FIRST_SCALE_PX, LAST_SCALE_PX, ROUNDS):
        W = A * weight[:, None]
        x = np.asarray(np.linalg.lstsq(W.T @ A, W.T @ disparity)[0], np.float64)
        weight = 1.0 / (1.0 + ((A @ x - disparity) / scale) ** 2)
    return GroundPlane(*x.tolist()) if x[1] > 0.0 and abs(x[0]) < x[1] else None


def above_plane(left: Image, right: Image, plane: GroundPlane, first_row: int, search: int) -> NDArray[np.float32]:
    """(h - first_row, w) px: e = d - d_plane of the left pixels from first_row on; NaN without a sure match.

    search : px on either side of the plane, a multiple of 8
    A right pixel u - d lies in the warped image at u - e / (1 - slope_u).
    """
    height, width = left.shape
    share = 1.0 - plane.slope_u
    offset = plane.slope_v * first_row + plane.offset
    warp = np.array([[share, -plane.slope_v, -offset], [0.0, 1.0, first_row]])
    size = (width, height - first_row)
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    warped = cv2.warpAffine(right, warp, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
    found = _matched(left[first_row:], np.asarray(warped, np.uint8), -search, 2 * search)
    seen = np.arange(width) * share - (plane.slope_v * np.arange(size[1])[:, None] + offset) >= search
    return np.where((found > -search) & seen, share * found, UNMATCHED).astype(np.float32)


def _matched(left: Image, right: Image, lowest: int, search: int) -> NDArray[np.float32]:
    """(h, w) px from `lowest` on; lowest - 1 without a match. The columns that OpenCV leaves empty are added first."""
    before, behind = max(lowest + search, 0), max(-lowest, 0)
    bordered = [cv2.copyMakeBorder(np.ascontiguousarray(i), 0, 0, before, behind, cv2.BORDER_REPLICATE) for i in (left, right)]
    small_step, large_step = 8 * BLOCK_PX**2, 32 * BLOCK_PX**2
    matcher = cv2.StereoSGBM.create(
        lowest, search, BLOCK_PX, small_step, large_step, 1, CONTRAST, UNIQUENESS_PERCENT, SPECKLE_PX, SPECKLE_STEP,
        cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )  # fmt: skip
    found = matcher.compute(*bordered)[:, before : bordered[0].shape[1] - behind]
    return np.asarray(found / SUBPIXELS, np.float32)
