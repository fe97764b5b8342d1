"""Projection of one host's points into a voter's images, and the weighted votes that they get there (eqs. 2 and 3)."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.labelling.images import Image, VoterImages
from wayloom.labelling.kernels.visibility import ncc_weights, occluded, patch_descriptors
from wayloom.labelling.kernels.voting import add_hard_votes, add_soft_votes, project, read_labels
from wayloom.labelling.settings import LabellingSettings
from wayloom.odometry.types import OdometryResult
from wayloom.segmentation.keyframe_labels import SMALL
from wayloom.segmentation.scores import STEPS_PER_NAT

FloatArray = NDArray[np.float64]
Weights = NDArray[np.float32]
Mask = NDArray[np.bool_]

MIN_NCC: Final = 0.3
"""Below this normalised cross-correlation of the patches in host and observer a point is not visible there."""
CELL_PX: Final = 8.0
"""Size of a cell of the occlusion buffer."""
OCCLUSION_MARGIN: Final = 0.15
"""A point occludes what is further away by more than this share of the depth."""


@dataclass(frozen=True, slots=True)
class HostedPoints:
    """The N points of one host.

    uv (N, 2) px; rays (N, 3), z = 1; inverse_depth and its sigma (N,) 1/m; descriptors (N, S) of their patches, None: no NCC
    """

    uv: FloatArray
    rays: FloatArray
    inverse_depth: FloatArray
    sigma: FloatArray
    descriptors: NDArray[np.float32] | None


@dataclass(frozen=True, slots=True)
class Projections:
    """Which of the host's N points are projected into a voter's images.

    is_host           whether the voter is the host itself
    left, right       (N,) whether the point is projected into this image
    occlusion_buffer  (rows, columns) of the voter's left image, None: no depth test
    """

    is_host: bool
    left: Mask
    right: Mask
    occlusion_buffer: NDArray[np.float32] | None


def add_votes(
    votes: FloatArray,
    points: HostedPoints,
    T_voter_host: FloatArray,
    images: VoterImages,
    projections: Projections,
    odometry: OdometryResult,
    settings: LabellingSettings,
) -> NDArray[np.uint8]:
    """Add the voter's votes to votes (2, N, C), left and right image.

    Returns the labels (N,) of the points in its left image, 255 = void, where it is their host: elsewhere they are read only where
    the scores are not enough.
    """
    uv, d_voter = _projected(points.inverse_depth, points, T_voter_host, odometry, settings)
    if projections.is_host:
        uv[0] = points.uv
    left_labels: NDArray[np.uint8] = (
        np.zeros(len(uv[0]), np.uint8)
        if images.scores_suffice and not projections.is_host
        else read_labels(images.labels[0], uv[0])
    )
    if not d_voter.any():
        return left_labels  # every point lies behind it, or too near
    for side in (0, 1) if projections.right.any() else (0,):
        weight = d_voter[side] if settings.inverse_depth_power == 1 else d_voter[side] ** np.float32(settings.inverse_depth_power)
        in_host = projections.is_host and side == 0
        if not in_host:
            weight = weight * _visibility(points, uv[side], d_voter[side], side, images, projections, settings)
        to_boundary = None if images.to_boundary is None else images.to_boundary[side]
        if to_boundary is not None:
            weight = weight * _boundary_weight(to_boundary, uv[side], settings.boundary_px)
        if settings.reprojection_px > 0:
            moved = _projected(points.inverse_depth + points.sigma, points, T_voter_host, odometry, settings)[0][side]
            shift = np.linalg.norm(moved - uv[side], axis=1) if not in_host else np.zeros(len(uv[side]))
            weight = weight / (1.0 + (shift / settings.reprojection_px) ** 2).astype(np.float32)
        image, scores = images.labels[side], images.scores[side]
        labels = left_labels if side == 0 else np.zeros(len(weight), np.uint8) if image is None else read_labels(image, uv[1])
        if scores is None:
            add_hard_votes(votes[side], labels, weight)
        else:
            (best, rest), size = scores, images.labels[0].shape
            grid = (best.classes, best.steps, rest, STEPS_PER_NAT, best.covered)
            add_soft_votes(votes[side], *grid, size, uv[side], labels, weight)
    return left_labels


def host_descriptors(image: Image, uv: FloatArray) -> NDArray[np.float32]:
    """(N, S) patch descriptors of points at uv (N, 2) px of the full image, sampled in their host's small image."""
    descriptors: NDArray[np.float32] = patch_descriptors(image, (uv + 0.5) / SMALL - 0.5, np.ones(len(uv)))
    return descriptors


def _projected(
    inverse_depth: FloatArray, points: HostedPoints, T_voter_host: FloatArray, odometry: OdometryResult, settings: LabellingSettings
) -> tuple[FloatArray, Weights]:
    """Pixels (2, N, 2) and inverse depths (2, N), 1/m, in the voter's left and right image as they are.

    Of the right camera's lens, the columns are moved here: what it does to the rows and its displacement are in the odometry's row
    field and rig.
    """
    camera = odometry.rig.camera
    uv, d_voter = project(
        points.rays, inverse_depth, T_voter_host, np.array(odometry.rig.t_right_left),
        np.array([camera.fx, camera.fy, camera.cx, camera.cy]), float(odometry.disparity_bias_px),
        np.asarray(odometry.row_coefficients, np.float64), 1.0 / settings.dist_min_m,
    )  # fmt: skip
    if not odometry.lens.is_ideal:
        uv[1, :, 0] = odometry.lens.real_pixels(camera, odometry.rig.baseline_m, uv[1])[:, 0]
    return uv, d_voter


def _visibility(
    points: HostedPoints,
    uv: FloatArray,
    d_voter: Weights,
    side: int,
    images: VoterImages,
    projections: Projections,
    settings: LabellingSettings,
) -> Weights:
    """(N,) 0 to 1: visibility of each point in the voter's left (side 0) or right image, by depth test and NCC.

    uv : (N, 2) px and d_voter : (N,) 1/m in that image
    """
    visible = projections.right if side else projections.left
    if projections.occlusion_buffer is not None and side == 0 and not projections.is_host:
        visible = visible & ~occluded(uv, d_voter, projections.occlusion_buffer, CELL_PX, OCCLUSION_MARGIN)
    small = None if images.small is None else images.small[side]
    if settings.ncc_power == 0 or points.descriptors is None or small is None:
        return visible.astype(np.float32)
    weights: Weights = ncc_weights(
        points.descriptors, small, SMALL, images.labels[0].shape, uv, d_voter, points.inverse_depth, visible,
        MIN_NCC, np.float32(settings.ncc_power),
    )  # fmt: skip
    return weights


def _boundary_weight(to_boundary: NDArray[np.float32], uv: FloatArray, boundary_px: float) -> Weights:
    """(N,) 0 to 1: distance to the nearest label boundary in units of boundary_px; 1 px is counted at a boundary itself."""
    height, width = to_boundary.shape
    u = np.clip(np.floor(np.nan_to_num(uv[:, 0]) + 0.5), 0, width - 1).astype(np.intp)
    v = np.clip(np.floor(np.nan_to_num(uv[:, 1]) + 0.5), 0, height - 1).astype(np.intp)
    return np.asarray(np.minimum((to_boundary[v, u] + 1.0) / boundary_px, 1.0), np.float32)
