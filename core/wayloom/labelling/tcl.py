"""Temporally consistent labelling: every image in which a point was really seen votes for its class.

"Vision-based Large-scale 3D Semantic Mapping for Autonomous Driving Applications" (Cheng, Zeller, Cremers; 2022), sec. III-C:

    l(p) = argmax_c  sum_{q_j in Q}  w_j [L_j(q_j) = c]            (eq. 2)
    w_j  = d_j  where d_j < 1 / dist_min,  else 0                   (eq. 3)

Q holds the point in its host's left image, its projections into the left image of every keyframe j of obs(p), and the projections
of those into the right images; d_j is its inverse depth in j: the nearer an observer, the more it knows, unless it is so near
that the projection is worth nothing. Only right images with which the odometry found the point consistent vote.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_COUNT, VOID
from wayloom.config.progress import Progress, silent
from wayloom.errors import StageError
from wayloom.geometry.camera import StereoRig
from wayloom.labelling.kernels.voting import count_votes, read_votes, sparse_votes
from wayloom.labelling.settings import LabellingSettings
from wayloom.labelling.types import PointLabels
from wayloom.odometry.types import OdometryResult, Points


class LabelImages(Protocol):
    """Label images by keyframe row, (h, w) uint8 train ids: `wayloom.segmentation.stage.KeyframeLabels` is one."""

    def left(self, keyframe: int, /) -> NDArray[np.uint8]: ...
    def right(self, keyframe: int, /) -> NDArray[np.uint8]: ...


@dataclass(frozen=True, slots=True)
class _Ballot:
    """One row for each (point, keyframe that may vote on it), by point, the host first.

    start     (P + 1,) the rows of point p are start[p]:start[p + 1]
    point     (M,) row's point; keyframe (M,) row's voter; right (M,) whether the voter's right image votes as well
    """

    start: NDArray[np.int64]
    point: NDArray[np.int64]
    keyframe: NDArray[np.int32]
    right: NDArray[np.bool_]


def label_points(
    odometry: OdometryResult,
    images: LabelImages,
    settings: LabellingSettings = LabellingSettings(),
    progress: Progress = silent,
) -> PointLabels:
    """Label the odometry's P points by the label images of its keyframes (eqs. 2 and 3), one keyframe after the other.

    A void pixel does not vote. Of classes with equal votes the baseline's wins, else the lowest. A point on which nothing votes
    keeps its baseline. A point seen only by its host has its baseline as mono label.
    Raises StageError where an image is missing or has not the size of the rig's camera.
    """
    ballot = _ballot(odometry.points)
    labels, weights, baseline = _collect(odometry, images, ballot, 1.0 / settings.dist_min_m, progress)
    mono, stereo, kinds = count_votes(ballot.start, labels, weights, baseline, CLASS_COUNT)
    vote_start, vote_class, vote_weight = sparse_votes(ballot.start, labels, weights, kinds, CLASS_COUNT)
    return PointLabels(baseline, mono, stereo, vote_start, vote_class, vote_weight)


def _ballot(points: Points) -> _Ballot:
    """Who may vote on what: a point's host, then its observers."""
    count = len(points)
    seen = np.diff(points.obs_start)
    start = points.obs_start + np.arange(count + 1)
    total = int(start[-1])
    is_host = np.zeros(total, bool)
    is_host[start[:-1]] = True
    keyframe = np.empty(total, np.int32)
    keyframe[is_host], keyframe[~is_host] = points.host, points.obs_keyframe
    right = np.empty(total, bool)
    right[is_host], right[~is_host] = points.host_right, points.obs_right
    return _Ballot(start, np.repeat(np.arange(count), seen + 1), keyframe, right)


def _collect(
    odometry: OdometryResult, images: LabelImages, ballot: _Ballot, max_inverse_depth: float, progress: Progress
) -> tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.uint8]]:
    """Open one keyframe's images at a time: (M, 2) labels, (M, 2) weights, and the (P,) baseline."""
    points, count = odometry.points, len(odometry.keyframes)
    labels = np.full((len(ballot.point), 2), VOID, np.uint8)
    weights = np.zeros((len(ballot.point), 2), np.float32)
    by_keyframe = np.argsort(ballot.keyframe, kind="stable")
    bounds = np.searchsorted(ballot.keyframe[by_keyframe], np.arange(count + 1))
    hosted = np.argsort(points.host, kind="stable")
    host_bounds = np.searchsorted(points.host[hosted], np.arange(count + 1))
    for j in range(count):
        progress(j / count, f"votes of keyframe {j + 1} of {count}")
        rows = by_keyframe[bounds[j] : bounds[j + 1]]
        if len(rows):
            left, right = _pair(images, j, odometry.rig)
            labels[rows], weights[rows] = _votes_of_keyframe(odometry, ballot, j, rows, left, right, max_inverse_depth)
            own = hosted[host_bounds[j] : host_bounds[j + 1]]
            at = ballot.start[own]
            labels[at, 0], weights[at, 0] = _own_votes(points, own, left, max_inverse_depth)
    progress(1.0, f"votes of {count} keyframes counted")
    return labels, weights, labels[ballot.start[:-1], 0]


def _votes_of_keyframe(
    odometry: OdometryResult,
    ballot: _Ballot,
    j: int,
    rows: NDArray[np.int64],
    left: NDArray[np.uint8],
    right: NDArray[np.uint8],
    max_inverse_depth: float,
) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """(N, 2) labels and weights that keyframe j gives to the N rows of the ballot that are its own."""
    points, T_world_cam = odometry.points, odometry.keyframes.T_world_cam
    camera = odometry.rig.camera
    p = ballot.point[rows]
    host = points.host[p]
    first, last = int(host.min()), int(host.max())
    T_observer_host = np.linalg.inv(T_world_cam[j]) @ T_world_cam[first : last + 1]
    if first <= j <= last:
        T_observer_host[j - first] = np.eye(4)
    result: tuple[NDArray[np.uint8], NDArray[np.float32]] = read_votes(
        camera.rays(points.uv_host[p].astype(np.float64)),
        points.inverse_depth[p].astype(np.float64),
        host - first,
        T_observer_host,
        ballot.right[rows],
        left,
        right,
        np.array([camera.fx, camera.fy, camera.cx, camera.cy]),
        np.array(odometry.rig.t_right_left),
        float(odometry.disparity_bias_px),
        np.asarray(odometry.row_coefficients, np.float64),
        max_inverse_depth,
    )
    return result


def _own_votes(
    points: Points, own: NDArray[np.int64], left: NDArray[np.uint8], max_inverse_depth: float
) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """L_i(p) of the points hosted in this image, read at their own pixel without any projection, and their weights."""
    height, width = left.shape
    u, v = np.floor(points.uv_host[own].astype(np.float64) + 0.5).astype(np.intp).T
    baseline = left[np.clip(v, 0, height - 1), np.clip(u, 0, width - 1)]
    d = points.inverse_depth[own]
    votes = (baseline != VOID) & (d > 0) & (d < max_inverse_depth)
    return baseline, np.where(votes, d, np.float32(0))


def _pair(images: LabelImages, j: int, rig: StereoRig) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    left, right = images.left(j), images.right(j)
    size = (rig.camera.height, rig.camera.width)
    if left.shape != size or right.shape != size:
        raise StageError(f"label images of keyframe {j} are {left.shape} and {right.shape}, the camera's are {size}; segment again")
    return left, right
