"""Relocalisation of lost frames: SIFT matches (Lowe 2004) with a keyframe whose stereo pair gives them depth, P3P in RANSAC.

Only lost or doubtful frames come here; the direct alignment has the last word on what is found.

The result depends on nothing but the images: OpenCV's RANSAC draws from a generator with a fixed seed.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.geometry.camera import StereoRig
from wayloom.odometry.points import stereo
from wayloom.odometry.settings import OdometrySettings

Image = NDArray[np.uint8]
FloatArray = NDArray[np.float64]
FEATURES, RATIO = 1500, 0.8
FARTHEST_M = 80.0
REPROJECTION_PX, DRAWS, CONFIDENCE = 2.0, 1000, 0.9999
MIN_MATCHES, MIN_INLIERS, MIN_SHARE = 12, 20, 0.3
LARGE_PX = 300_000
"""Of an image from which on features are looked for at half its size first."""
SMOOTHING_PX = 2.0
LEAST_SPREAD = 2.0


@dataclass(frozen=True, slots=True)
class Features:
    """uv (n, 2) float64 px, descriptors (n, 128) float32, grey (n,) smoothed grey value, n features of an image."""

    uv: FloatArray
    descriptors: NDArray[np.float32]
    grey: FloatArray

    def __getitem__(self, rows: NDArray[np.int64]) -> "Features":
        return Features(self.uv[rows], self.descriptors[rows], self.grey[rows])


@dataclass(frozen=True, slots=True)
class Landmarks:
    """Features of a keyframe with their places p_cam (n, 3) m in its left camera."""

    features: Features
    p_cam: FloatArray


@dataclass(frozen=True, slots=True)
class Sighting:
    """T_frame_keyframe (4, 4) by `inliers` of `matches` features; brightness (2,) gain, offset of the frame against it."""

    T_frame_keyframe: FloatArray
    inliers: int
    matches: int
    brightness: FloatArray

    @property
    def decisive(self) -> bool:
        """Whether so many features agree that chance is out of the question."""
        return self.inliers >= MIN_INLIERS and self.inliers >= MIN_SHARE * self.matches


def shrinks(image: Image) -> tuple[int, ...]:
    """By what an image (h, w) is made smaller for its features, one after the other while they do not decide: half the size takes a
    quarter of the time, and finds what was seen a second ago; the whole one finds more of it from farther away."""
    return (2, 1) if image.size > LARGE_PX else (1,)


def find_features(image: Image, shrink: int = 1) -> Features:
    """The strongest features of an image (h, w) made `shrink` times smaller, in an order that the image alone decides."""
    height, width = image.shape
    seen = image if shrink == 1 else cv2.resize(image, (width // shrink, height // shrink), interpolation=cv2.INTER_AREA)
    keypoints, descriptors = cv2.SIFT.create(FEATURES).detectAndCompute(seen, None)
    if descriptors is None:
        return Features(np.zeros((0, 2)), np.zeros((0, 128), np.float32), np.zeros(0))
    uv = np.array([keypoint.pt for keypoint in keypoints], np.float64).reshape(-1, 2)
    uv = (uv + 0.5) * (width / seen.shape[1], height / seen.shape[0]) - 0.5  # odd sizes lose a pixel
    column, row = np.clip(np.rint(uv).astype(int), 0, (image.shape[1] - 1, image.shape[0] - 1)).T
    grey = cv2.GaussianBlur(image, (0, 0), SMOOTHING_PX)[row, column].astype(np.float64)
    return Features(uv, np.asarray(descriptors, np.float32), grey)


def landmarks(
    left: Image, right: Image, rig: StereoRig, bias_px: float, settings: OdometrySettings, shrink: int = 1
) -> Landmarks:  # fmt: skip
    """The features of a keyframe that its own pair, images (h, w) with aligned rows, gives a depth of up to 80 m; shrink as
    of `find_features`."""
    features, s = find_features(left, shrink), settings
    pixels = np.clip(np.rint(features.uv).astype(np.int64), s.border, np.array(left.shape[::-1]) - 1 - s.border)
    found = stereo.match(left, right, pixels, s.max_disparity, s.uniqueness, s.max_cost, s.slope_cap)
    disparity = found[:, 0] - bias_px
    good = np.flatnonzero((found[:, 1] < s.max_sigma) & (disparity > rig.bf / FARTHEST_M))
    return Landmarks(features[good], rig.camera.rays(features.uv[good]) * (rig.bf / disparity[good])[:, None])


def matches(ours: Features, theirs: Features) -> NDArray[np.int64]:
    """(m, 2) rows of ours and theirs that are each other's nearest and much nearer than the second nearest."""
    if min(len(ours.uv), len(theirs.uv)) < 2:
        return np.zeros((0, 2), np.int64)
    forward, back = (_nearest(a.descriptors, b.descriptors) for a, b in ((ours, theirs), (theirs, ours)))
    rows = np.flatnonzero(forward >= 0)
    rows = rows[back[forward[rows]] == rows]
    return np.column_stack([rows, forward[rows]])


def _nearest(a: NDArray[np.float32], b: NDArray[np.float32]) -> NDArray[np.int64]:
    """(n,) row of b nearest to each row of a, -1 where the second nearest is about as near.

    SIFT's numbers are whole and small: every sum is exact in float32, whatever order BLAS adds in.
    """
    squared = (a * a).sum(axis=1)[:, None] + (b * b).sum(axis=1)[None] - 2.0 * (a @ b.T)
    best = np.argmin(squared, axis=1)
    two = np.partition(squared, 1, axis=1)[:, :2]
    return np.where(two[:, 0] < RATIO**2 * two[:, 1], best, -1)


def sight(known: Landmarks, seen: Features, K: FloatArray) -> Sighting | None:
    """Where the image with the features `seen` was taken, against the keyframe of the landmarks; None where too little agrees.

    K : (3, 3) px
    """
    pairs = matches(known.features, seen)
    if len(pairs) < MIN_MATCHES:
        return None
    p_cam, uv = known.p_cam[pairs[:, 0]], seen.uv[pairs[:, 1]]
    ok, rotation, translation, inliers = cv2.solvePnPRansac(
        p_cam, uv, K, None, iterationsCount=DRAWS, reprojectionError=REPROJECTION_PX, confidence=CONFIDENCE, flags=cv2.SOLVEPNP_P3P
    )
    if not ok or inliers is None or len(inliers) < MIN_MATCHES:
        return None
    rows = np.sort(np.asarray(inliers, np.int64).ravel())
    rotation, translation = cv2.solvePnPRefineLM(p_cam[rows], uv[rows], K, None, rotation, translation)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = cv2.Rodrigues(rotation)[0], np.ravel(translation)
    if not np.isfinite(T).all():
        return None
    brightness = relative_brightness(known.features.grey[pairs[rows, 0]], seen.grey[pairs[rows, 1]])
    return Sighting(T, len(rows), len(pairs), brightness)


def relative_brightness(theirs: FloatArray, ours: FloatArray) -> FloatArray:
    """(2,) gain, offset with ours = gain theirs + offset, from the spread and the median of grey values (n,) of the same things."""
    spread_ours, spread_theirs = (max(float(np.subtract(*np.percentile(grey, (84, 16)))), LEAST_SPREAD) for grey in (ours, theirs))
    gain = spread_ours / spread_theirs
    return np.array([gain, float(np.median(ours)) - gain * float(np.median(theirs))])
