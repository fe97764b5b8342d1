"""Extraction of a drive's looks from its images: one pass over keyframes along the road."""

from dataclasses import replace
from typing import Final, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.config.progress import Progress, silent
from wayloom.config.side_by_side import in_order
from wayloom.dense.disparity import dense_disparity, search_px
from wayloom.dense.kernels.patches import encode_depths, reduce_patches
from wayloom.dense.packing import PackedLooks, Packing, pack
from wayloom.dense.settings import LookSettings
from wayloom.dense.types import DEPTHS_M, KINDS_OF_CLASS, OPEN_SKY
from wayloom.geometry.camera import PinholeCamera, StereoRig
from wayloom.logs.types import DriveLog
from wayloom.odometry.frame_source import one_opencv_thread
from wayloom.odometry.types import OdometryResult
from wayloom.places.road import road_m, spaced
from wayloom.places.stereo_pair import LeftLabels, StereoPair, read_pair, right_rectifier

Image = NDArray[np.uint8]
FloatArray = NDArray[np.float64]
Number = TypeVar("Number", np.float64, np.uint8)
SIGMA_PX: Final = 0.5
"""Of a disparity, of the images that are matched: what is worse than the sub-pixel noise is the pull of neighbours."""
Look = tuple[Image, Image, Image]
"""near, far and kinds (h, w)."""


def make_looks(
    log: DriveLog,
    odometry: OdometryResult,
    images: LeftLabels,
    settings: LookSettings = LookSettings(),
    progress: Progress = silent,
    threads: int = 1,
) -> PackedLooks:
    """The looks of a drive, so many at a time. Raises StageError where an image's labels are missing, LogError where an image
    cannot be read."""
    keyframes, rectifier = odometry.keyframes, right_rectifier(odometry)
    chosen = np.flatnonzero(spaced(road_m(keyframes.T_world_cam), keyframes.segment, settings.spacing_m))
    camera, edge = small_camera(odometry.rig.camera, settings.width_px)
    packed = Packing()

    def look(k: int) -> bytes:
        pair = read_pair(log, int(keyframes.frame[k]), images.left(k), rectifier)
        depth = matched_depth(pair, odometry.rig, odometry.disparity_bias_px, settings)
        return pack(*look_of(depth, pair.label, camera, edge, settings.sure_share))

    with one_opencv_thread():
        for one in in_order(look, chosen.tolist(), threads):
            packed.append(one)
            progress(len(packed) / len(chosen), f"look {len(packed)} of {len(chosen)}")
    sigma = SIGMA_PX * (1 << _level(odometry.rig.camera.width, settings.match_width_px)) / odometry.rig.bf
    return packed.of_frames(camera, sigma, keyframes.frame[chosen].astype(np.uint32))


def dense_depth(pair: StereoPair, rig: StereoRig, bias_px: float, settings: LookSettings) -> FloatArray:
    """(h, w) m along the left camera's z axis, of every pixel of the pair; NaN where it is not sure, infinite without disparity.

    bias_px : of the disparities, at the full size of the images
    """
    return _at_full_size(matched_depth(pair, rig, bias_px, settings), pair.left.shape, np.nan)


def matched_depth(pair: StereoPair, rig: StereoRig, bias_px: float, settings: LookSettings) -> FloatArray:
    """`dense_depth` at the size at which the images are matched: halved as often as it takes to be `match_width_px` wide."""
    left, right, level = pair.left, pair.right, _level(pair.left.shape[1], settings.match_width_px)
    for _ in range(level):
        left, right = _halved(left), _halved(right)
    scale = 2.0**level
    small = replace(rig, camera=rig.camera.at_level(level))
    disparity = scale * dense_disparity(left, right, search_px(small), settings.check_px) - bias_px
    depth = np.where(np.isnan(disparity), np.nan, np.inf)
    return np.divide(rig.bf, disparity, out=depth, where=disparity > 0.0)


def _level(width: int, match_width_px: int) -> int:
    """How often images of this width are halved before they are matched."""
    level = 0
    while width >> level > match_width_px:
        level += 1
    return level


def _halved(image: Image) -> Image:
    """Means of 2 x 2 pixels, as of `PinholeCamera.at_level`; a last odd row or column is left out."""
    even = image[: image.shape[0] & ~1, : image.shape[1] & ~1]
    return np.asarray(cv2.resize(even, (even.shape[1] // 2, even.shape[0] // 2), interpolation=cv2.INTER_AREA), np.uint8)


def _at_full_size(values: NDArray[Number], shape: tuple[int, ...], border: float) -> NDArray[Number]:
    """Values (h >> n, w >> n), each repeated over its pixels; a border that is no whole pixel of theirs is filled."""
    if values.shape == shape:
        return values
    times = shape[0] // values.shape[0]
    large = np.full(shape, border, values.dtype)
    repeated = values.repeat(times, axis=0).repeat(times, axis=1)
    large[: repeated.shape[0], : repeated.shape[1]] = repeated
    return large


def small_camera(camera: PinholeCamera, width_px: int) -> tuple[PinholeCamera, int]:
    """The camera whose pixels are patches of so many pixels that its image is at most `width_px` wide, and how many."""
    edge = -(-camera.width // width_px)
    fx, fy, cx, cy = camera.fx / edge, camera.fy / edge, (camera.cx + 0.5) / edge - 0.5, (camera.cy + 0.5) / edge - 0.5
    return PinholeCamera(fx, fy, cx, cy, -(-camera.width // edge), -(-camera.height // edge)), edge


def look_of(depth: FloatArray, label: Image, camera: PinholeCamera, edge: int, sure_share: float) -> Look:
    """The look of a depth image m, (H, W) or halved n times, and its labels (H, W).

    Sky is a look to infinity where no depth says otherwise; where one does, one of the two is wrong and neither is believed.
    """
    kinds = KINDS_OF_CLASS[label]
    near_code, far_code = np.empty(depth.shape, np.uint8), np.empty(depth.shape, np.uint8)
    encode_depths(depth, DEPTHS_M, near_code, far_code)
    near, far, all_kinds = (np.empty((camera.height, camera.width), np.uint8) for _ in range(3))
    times = max(1, label.shape[0] // depth.shape[0])
    reduce_patches(near_code, far_code, times, kinds, OPEN_SKY, edge, sure_share, near, far, all_kinds)
    return near, far, all_kinds
