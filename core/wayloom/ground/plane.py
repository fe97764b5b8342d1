"""Ground plane of one stereo pair in disparity space, and matching against it.

A plane of the world is one of disparities: d(u, v) = a u + b v + c. The right image, warped by it, lies on the left one wherever
the scene is on the plane, so that slanted ground has the disparity zero: few disparities are searched, and blocks lie on what
they match
(Williamson and Thorpe, "A specialized multibaseline stereo technique for obstacle detection", CVPR 1998).
A pixel at height H over the plane, of a camera h above it, is left with e = d - d_plane = H d / h.
"""

from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.dense.disparity import SUBPIXELS
from wayloom.geometry.camera import StereoRig
from wayloom.ground.kernels.plane import robust_plane

Image = NDArray[np.uint8]
BoolArray = NDArray[np.bool_]
FloatArray = NDArray[np.float64]
COARSE_WIDTH_PX: Final = 300
"""Images are halved to this width, at least, before their plane is looked for."""
COUNTED_WIDTH_PX: Final = 360
"""LEAST_PIXELS are of images that are halved to this width, at least."""
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
BLOCK_PX, SMALL_BLOCK_PX = 5, 3
"""Of images at full size, and of those in which the plane is looked for."""
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


def find_plane(left: Image, right: Image, is_ground: BoolArray, first_row: int, rig: StereoRig) -> GroundPlane | None:
    """The plane of a pair (h', w), rows aligned; None where too little ground is matched, or what is matched is no ground.

    is_ground : (h', w) pixels by whose disparities it is fitted
    first_row : of the whole image, from which on they are given (`first_to_match`)
    """
    scale, counted = _scale(left.shape[1]), _scale(left.shape[1], COUNTED_WIDTH_PX)
    least = LEAST_PIXELS * (counted / scale) ** 2
    size = (left.shape[1] // scale, left.shape[0] // scale)
    whole = (slice(scale * size[1]), slice(scale * size[0]))
    small = [np.asarray(cv2.resize(image[whole], size, interpolation=cv2.INTER_AREA), np.uint8) for image in (left, right)]
    search = int(STEP * np.ceil(rig.bf / scale / NEAREST_M / STEP))
    ground = is_ground[whole][scale // 2 :: scale, scale // 2 :: scale]
    if not ground.any():
        return None
    disparity = _matched(small[0], small[1], 0, search, SMALL_BLOCK_PX)
    plane = _fitted(disparity, (disparity > 0.0) & ground, scale, least)
    if plane is None:
        return None
    # matching is drawn to the disparities of the row above; against the plane there is nothing to be drawn to
    above = above_plane(small[0], small[1], plane, 0, STEP // 2, SMALL_BLOCK_PX)
    of_plane = plane.disparity(np.arange(float(size[0])), np.arange(float(size[1]))[:, None])
    plane = _fitted(of_plane + above, np.isfinite(above) & ground, scale, least)
    return None if plane is None else _at_full_size(plane, scale, first_row)


def _fitted(disparity: NDArray[np.floating[Any]], is_used: BoolArray, scale: int, least: float) -> GroundPlane | None:
    """The plane of the used pixels' disparities (h, w), by weights of Cauchy that grow strict; None of fewer than `least`, and
    where it does not rise to the horizon. scale : by which the images are smaller"""
    v, u = np.nonzero(is_used)
    if len(u) < least:
        return None
    scales_px = np.geomspace(FIRST_SCALE_PX, LAST_SCALE_PX, ROUNDS) / scale
    x = robust_plane(u.astype(np.float64), v.astype(np.float64), disparity[v, u].astype(np.float64), scales_px)
    return GroundPlane(*x) if x[1] > 0.0 and abs(x[0]) < x[1] else None


def _at_full_size(plane: GroundPlane, scale: int, first_row: int) -> GroundPlane:
    """The plane of smaller images, whose row 0 is first_row of the large ones. Pixels of theirs lie amid scale x scale."""
    middle = 0.5 * (scale - 1)
    offset = scale * plane.offset - plane.slope_u * middle - plane.slope_v * (first_row + middle)
    return GroundPlane(plane.slope_u, plane.slope_v, offset)


def first_to_match(is_ground: BoolArray) -> int:
    """The row of an image (h, w) from which on its plane is looked for; all of it for one without ground."""
    scale = _scale(is_ground.shape[1])
    first = int(is_ground.any(axis=1).argmax()) // scale
    return int(scale * max(min(first - ROWS_ABOVE, is_ground.shape[0] // scale - FEWEST_ROWS), 0))


def _scale(width: int, least_px: int = COARSE_WIDTH_PX) -> int:
    """By how much images of this width are made smaller, so that least_px are left."""
    scale = 1
    while width // (2 * scale) >= least_px:
        scale *= 2
    return scale


def above_plane(
    left: Image, right: Image, plane: GroundPlane, first_row: int, search: int, block: int = BLOCK_PX
) -> NDArray[np.float32]:
    """(h', w) px: e = d - d_plane of the left pixels (h', w); NaN without a sure match.

    first_row : of the whole image, from which on the pair is given
    search    : px on either side of the plane, a multiple of 8; block: px, side of what is compared
    A right pixel u - d lies in the warped image at u - e / (1 - slope_u).
    """
    height, width = left.shape
    share = 1.0 - plane.slope_u
    offset = plane.slope_v * first_row + plane.offset
    warp = np.array([[share, -plane.slope_v, -offset], [0.0, 1.0, 0.0]])
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    warped = cv2.warpAffine(right, warp, (width, height), flags=flags, borderMode=cv2.BORDER_REPLICATE)
    found = _matched(left, np.asarray(warped, np.uint8), -search, 2 * search, block)
    seen = np.arange(width) * share - (plane.slope_v * np.arange(height)[:, None] + offset) >= search
    return np.where((found > -search) & seen, share * found, UNMATCHED).astype(np.float32)


def _matched(left: Image, right: Image, lowest: int, search: int, block: int) -> NDArray[np.float32]:
    """(h, w) px from `lowest` on; lowest - 1 without a match. The columns that OpenCV leaves empty are added first."""
    before, behind = max(lowest + search, 0), max(-lowest, 0)
    bordered = [cv2.copyMakeBorder(np.ascontiguousarray(i), 0, 0, before, behind, cv2.BORDER_REPLICATE) for i in (left, right)]
    small_step, large_step = 8 * block**2, 32 * block**2
    matcher = cv2.StereoSGBM.create(
        lowest, search, block, small_step, large_step, 1, CONTRAST, UNIQUENESS_PERCENT, SPECKLE_PX, SPECKLE_STEP,
        cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )  # fmt: skip
    found = matcher.compute(*bordered)[:, before : bordered[0].shape[1] - behind]
    return np.asarray(found / SUBPIXELS, np.float32)
