"""Association of map points with labelled LiDAR points and pixels, and the paper's filters, each counted.

Labelled LiDAR points up to 100 m are projected into each keyframe's image with the given poses; a point of the keyframe is matched
to the nearest one in the image, rejected where the depths disagree, and judged only where LiDAR and image have the same label,
which is neither void nor sky; points at label boundaries are told apart.
"""

from dataclasses import dataclass, field
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from wayloom.config.classes import SKY, VOID
from wayloom.config.progress import Progress, silent
from wayloom.evaluation.label_truth import LabelTruth, TrueFrame
from wayloom.odometry.types import OdometryResult

FloatArray = NDArray[np.float64]
Labels = NDArray[np.uint8]

REASONS: Final = (
    "kept", "image without labels", "no LiDAR point near", "depths disagree", "LiDAR and image disagree", "void", "sky", "boundary",
)  # fmt: skip
"""The filters in their order; a point is counted at the first that rejects it."""
KEPT, NO_IMAGE, NO_LIDAR, OTHER_DEPTH, DISAGREE, IS_VOID, IS_SKY, BOUNDARY = range(len(REASONS))


@dataclass(frozen=True, slots=True)
class MatchSettings:
    """max_distance_m of LiDAR points; match_px: no further in the image; depth_share: depths may differ by so much of the LiDAR's;
    boundary_px: nearer than this to another label in the image is at a boundary; hidden_px, hidden_share: a LiDAR point is hidden
    by one at most hidden_px away in the image that is nearer by more than this share."""

    max_distance_m: float = 100.0
    match_px: float = 3.0
    depth_share: float = 0.05
    boundary_px: int = 3
    hidden_px: int = 2
    hidden_share: float = 0.10


@dataclass(frozen=True, slots=True)
class Matches:
    """reason (P,) index into REASONS; truth (P,) train ids, 255 where the point is not matched."""

    reason: NDArray[np.int8]
    truth: Labels
    filters: dict[str, int] = field(default_factory=dict)

    @property
    def judged(self) -> NDArray[np.bool_]:
        """(P,) the paper's points."""
        return np.asarray(self.reason == KEPT)

    @property
    def judged_with_boundaries(self) -> NDArray[np.bool_]:
        """(P,) the same and those at boundaries."""
        return np.asarray((self.reason == KEPT) | (self.reason == BOUNDARY))


def match_points(
    odometry: OdometryResult, truth: LabelTruth, settings: MatchSettings = MatchSettings(), progress: Progress = silent
) -> Matches:
    """Match every point in its host. Raises LogError where a file of the truth cannot be read."""
    points, count = odometry.points, len(odometry.keyframes)
    reason = np.full(len(points), NO_IMAGE, np.int8)
    labels = np.full(len(points), VOID, np.uint8)
    for k in range(count):
        progress(k / count, f"truth of keyframe {k + 1} of {count}")
        rows = np.flatnonzero(points.host == k)
        known = truth.frame(int(odometry.keyframes.frame[k])) if len(rows) else None
        if known is not None:
            d = points.inverse_depth[rows].astype(np.float64)
            reason[rows], labels[rows] = _match(odometry, points.uv_host[rows].astype(np.float64), d, known, settings)
    progress(1.0, f"truth of {count} keyframes")
    return Matches(reason, labels, {name: int((reason == code).sum()) for code, name in enumerate(REASONS)})


def _match(
    odometry: OdometryResult, uv: FloatArray, inverse_depth: FloatArray, known: TrueFrame, settings: MatchSettings
) -> tuple[NDArray[np.int8], Labels]:
    """Reason and label (N,) of points at uv (N, 2) px of one keyframe."""
    reason = np.full(len(uv), NO_LIDAR, np.int8)
    uv_lidar, z_lidar, labels_lidar = visible_lidar(odometry, known, settings)
    if not len(uv_lidar):
        return reason, np.full(len(uv), VOID, np.uint8)
    distance, nearest = cKDTree(uv_lidar).query(uv, distance_upper_bound=settings.match_px)
    near = np.isfinite(distance)
    nearest[~near] = 0
    column, row = np.floor(uv + 0.5).astype(np.intp).T
    in_image = known.image[np.clip(row, 0, known.image.shape[0] - 1), np.clip(column, 0, known.image.shape[1] - 1)]
    label, z = labels_lidar[nearest], z_lidar[nearest]
    with np.errstate(divide="ignore", invalid="ignore"):
        same_depth = np.abs(1.0 / inverse_depth - z) <= settings.depth_share * z
    edge = boundary(known.image, settings.boundary_px)[
        np.clip(row, 0, known.image.shape[0] - 1), np.clip(column, 0, known.image.shape[1] - 1)
    ]
    verdicts = [
        (NO_LIDAR, ~near), (OTHER_DEPTH, ~same_depth), (DISAGREE, label != in_image), (IS_VOID, label == VOID),
        (IS_SKY, label == SKY), (BOUNDARY, edge),
    ]  # fmt: skip
    reason[:] = KEPT
    for code, fails in reversed(verdicts):
        reason[fails] = code
    judged = (reason == KEPT) | (reason == BOUNDARY)
    return reason, np.where(judged, label, np.uint8(VOID))


def visible_lidar(odometry: OdometryResult, known: TrueFrame, settings: MatchSettings) -> tuple[FloatArray, FloatArray, Labels]:
    """uv (M, 2) px, z (M,) m and labels of the LiDAR points in the image that no nearer one hides."""
    camera = odometry.rig.camera
    z = known.points_cam[:, 2]
    within = (z > 0.5) & (z <= settings.max_distance_m)
    p, labels = known.points_cam[within], known.labels[within]
    uv, z = camera.project(p), p[:, 2]
    inside = camera.contains(uv)
    uv, z, labels = uv[inside], z[inside], labels[inside]
    column, row = np.floor(uv + 0.5).astype(np.intp).T
    nearest = np.full((camera.height, camera.width), np.inf, np.float32)
    np.minimum.at(nearest, (row, column), z.astype(np.float32))
    side = 2 * settings.hidden_px + 1
    around = -cv2.dilate(-nearest, np.ones((side, side), np.uint8))
    seen = z * (1.0 - settings.hidden_share) <= around[row, column]
    return uv[seen], z[seen], labels[seen]


def boundary(image: Labels, radius_px: int) -> NDArray[np.bool_]:
    """(h, w) whether another label, void among them, lies within radius_px (a square) of the pixel."""
    window = np.ones((2 * radius_px + 1, 2 * radius_px + 1), np.uint8)
    return np.asarray(cv2.dilate(image, window) != cv2.erode(image, window))
