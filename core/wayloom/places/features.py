"""Local features of a keyframe: oriented FAST corners with binary descriptors (ORB, Rublee et al. 2011) and stereo depth."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.odometry.types import OdometryResult
from wayloom.places.settings import PlaceSettings
from wayloom.places.stereo_pair import STATIC, StereoPair
from wayloom.places.types import PlaceFeatures

FloatArray = NDArray[np.float64]
BYTES = 32
EDGE_PX = 12
"""Corners nearer to the enlarged image's edge are left out; their patches reach over it there and are mirrored."""
FAST_THRESHOLD = 7
MORE = 5
"""Corners that are found for one that is kept: the grid and the stereo choose."""
CELLS = 96
"""Cells of the grid over the image, about; each keeps its strongest corners."""


def describe(pair: StereoPair, keyframe: int, odometry: OdometryResult, settings: PlaceSettings) -> PlaceFeatures:
    """The keyframe's local features, spread over the image, on static classes and with a depth."""
    scale = max(1, round(settings.describe_width_px / pair.left.shape[1]))
    image = np.asarray(cv2.resize(pair.left, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC), np.uint8)
    mask = cv2.resize(STATIC[pair.label].astype(np.uint8), image.shape[::-1], interpolation=cv2.INTER_NEAREST)
    orb = cv2.ORB.create(MORE * settings.features, 1.2, 6, EDGE_PX, 0, 2, cv2.ORB_HARRIS_SCORE, 31, FAST_THRESHOLD)
    corners = orb.detect(image, mask)
    uv = (np.asarray(cv2.KeyPoint.convert(corners), np.float64).reshape(-1, 2) + 0.5) / scale - 0.5
    pixels = np.clip(np.rint(uv), 0, np.array(pair.left.shape[::-1]) - 1).astype(np.int64)
    depth, sigma = pair.depth(pixels, odometry)
    sure = sigma < settings.feature_depth_share * depth
    response = np.array([corner.response for corner in corners], np.float64)
    chosen = np.flatnonzero(sure)[spread(uv[sure], response[sure], pair.left.shape, settings.features)]
    bits, chosen = _bits(orb, image, corners, chosen)
    p_cam = odometry.rig.camera.rays(uv[chosen]) * depth[chosen, None]
    return PlaceFeatures(
        np.full(len(chosen), keyframe, np.int32), bits, uv[chosen].astype(np.float32), p_cam.astype(np.float32),
        sigma[chosen].astype(np.float32),
    )  # fmt: skip


def spread(uv: FloatArray, response: FloatArray, shape: tuple[int, ...], count: int) -> NDArray[np.int64]:
    """Rows of at most `count` of the corners uv (n, 2) px, increasing: the strongest of every cell first, then the second ones …"""
    side = (shape[0] * shape[1] / CELLS) ** 0.5
    column, row = (uv // side).astype(np.int64).T if len(uv) else np.zeros((2, 0), np.int64)
    cell = row * (int(shape[1] // side) + 1) + column
    order = np.lexsort((-response, cell))
    first = np.searchsorted(cell[order], cell[order])
    rank = np.empty(len(uv), np.int64)
    rank[order] = np.arange(len(uv)) - first
    chosen: NDArray[np.int64] = np.sort(np.lexsort((-response, rank))[:count])
    return chosen


def _bits(
    orb: Any, image: NDArray[np.uint8], corners: Any, chosen: NDArray[np.int64]
) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
    """Descriptors (n, 32) of the chosen corners and the rows of those that have one."""
    kept = [corners[i] for i in chosen]
    for corner, i in zip(kept, chosen.tolist(), strict=True):
        corner.class_id = i
    described, bits = orb.compute(image, kept) if kept else ((), None)
    if bits is None:
        return np.zeros((0, BYTES), np.uint8), chosen[:0]
    return np.asarray(bits, np.uint8), np.array([corner.class_id for corner in described], np.int64)
