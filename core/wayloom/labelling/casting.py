"""The votes that one voter casts on the points of one host."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.labelling.images import Image, Voter
from wayloom.labelling.kernels.visibility import hidden, likeness, patches
from wayloom.labelling.kernels.voting import add_hard_votes, add_soft_votes, project, read_labels
from wayloom.labelling.settings import LabellingSettings
from wayloom.odometry.types import OdometryResult
from wayloom.segmentation.keyframe_labels import SMALL
from wayloom.segmentation.scores import STEPS_PER_NAT

FloatArray = NDArray[np.float64]
Weights = NDArray[np.float32]
Mask = NDArray[np.bool_]

LEAST_LIKENESS: Final = 0.3
"""Where the correlation of looks is less, the point is not seen."""
CELL_PX: Final = 8.0
"""Within a cell of this size, what stands nearer hides what stands behind …"""
MARGIN: Final = 0.15
"""… by more than this share of the depth."""


@dataclass(frozen=True, slots=True)
class HostedPoints:
    """The N points of one host.

    uv (N, 2) px; rays (N, 3), z = 1; inverse_depth and its sigma (N,) 1/m; looks (N, S), None: not looked at
    """

    uv: FloatArray
    rays: FloatArray
    inverse_depth: FloatArray
    sigma: FloatArray
    looks: NDArray[np.float32] | None


@dataclass(frozen=True, slots=True)
class Projections:
    """Which of the host's points a voter may judge.

    is_host      whether the voter is the host itself
    left, right  (N,) whether it may judge them by this image
    seen         (rows, columns) `nearest_seen` of the voter's left image, None: hidden ones are not looked for
    """

    is_host: bool
    left: Mask
    right: Mask
    seen: NDArray[np.float32] | None


def cast(
    votes: FloatArray,
    points: HostedPoints,
    T_voter_host: FloatArray,
    voter: Voter,
    ballot: Projections,
    odometry: OdometryResult,
    settings: LabellingSettings,
) -> NDArray[np.uint8]:
    """Add the voter's votes to votes (2, N, C), left and right image; returns the labels (N,) of the points in its left one, 255 =
    void, where it is their host: elsewhere they are read only where scores do not say all."""
    uv, nearness = _projected(points.inverse_depth, points, T_voter_host, odometry, settings)
    if ballot.is_host:
        uv[0] = points.uv
    said = voter.labels[1] is None and voter.scores[0] is not None
    left_labels: NDArray[np.uint8] = (
        np.zeros(len(uv[0]), np.uint8) if said and not ballot.is_host else read_labels(voter.labels[0], uv[0])
    )
    if not nearness.any():
        return left_labels  # every point lies behind it, or too near
    for side, may in enumerate((ballot.left, ballot.right)):
        weight = nearness[side] if settings.nearness_power == 1 else nearness[side] ** np.float32(settings.nearness_power)
        own = ballot.is_host and side == 0
        if not own:
            weight = weight * _visibility(points, uv[side], nearness[side], side, may, voter, ballot, settings)
        if settings.boundary_px > 0 and voter.to_boundary is not None:
            weight = weight * _sureness(voter.to_boundary[side], uv[side], settings.boundary_px)
        if settings.reprojection_px > 0:
            moved = _projected(points.inverse_depth + points.sigma, points, T_voter_host, odometry, settings)[0][side]
            shift = np.linalg.norm(moved - uv[side], axis=1) if not own else np.zeros(len(uv[side]))
            weight = weight / (1.0 + (shift / settings.reprojection_px) ** 2).astype(np.float32)
        image, scores = voter.labels[side], voter.scores[side]
        labels = left_labels if side == 0 else np.zeros(len(weight), np.uint8) if image is None else read_labels(image, uv[1])
        if scores is None:
            add_hard_votes(votes[side], labels, weight)
        else:
            (best, rest), size = scores, voter.labels[0].shape
            grid = (best.classes, best.steps, rest, STEPS_PER_NAT, best.covered)
            add_soft_votes(votes[side], *grid, size, uv[side], labels, weight)
    return left_labels


def looks_of(image: Image, uv: FloatArray) -> NDArray[np.float32]:
    """(N, S) how points at uv (N, 2) px of the full image look in their host's own small image, at its own pixels' distance."""
    looks: NDArray[np.float32] = patches(image, (uv + 0.5) / SMALL - 0.5, np.ones(len(uv)))
    return looks


def _projected(
    inverse_depth: FloatArray, points: HostedPoints, T_voter_host: FloatArray, odometry: OdometryResult, settings: LabellingSettings
) -> tuple[FloatArray, Weights]:
    """Pixels (2, N, 2) and nearness (2, N) in the voter's images as they are.

    Of the right camera's lens, the columns are moved here: what it does to the rows and its displacement are in the odometry's row
    field and rig.
    """
    camera = odometry.rig.camera
    uv, nearness = project(
        points.rays, inverse_depth, T_voter_host, np.array(odometry.rig.t_right_left),
        np.array([camera.fx, camera.fy, camera.cx, camera.cy]), float(odometry.disparity_bias_px),
        np.asarray(odometry.row_coefficients, np.float64), 1.0 / settings.dist_min_m,
    )  # fmt: skip
    if not odometry.lens.is_ideal:
        uv[1, :, 0] = odometry.lens.real_pixels(camera, odometry.rig.baseline_m, uv[1])[:, 0]
    return uv, nearness


def _visibility(
    points: HostedPoints,
    uv: FloatArray,
    nearness: Weights,
    side: int,
    may: Mask,
    voter: Voter,
    ballot: Projections,
    settings: LabellingSettings,
) -> Weights:
    """(N,) 0 to 1: how surely each point is seen by the voter's image."""
    if ballot.seen is not None and side == 0 and not ballot.is_host:
        may = may & ~hidden(uv, nearness, ballot.seen, CELL_PX, MARGIN)
    if settings.likeness_power == 0 or points.looks is None or voter.small is None:
        return may.astype(np.float32)
    alike: Weights = likeness(
        points.looks, voter.small[side], SMALL, voter.labels[0].shape, uv, nearness, points.inverse_depth, may,
        LEAST_LIKENESS, np.float32(settings.likeness_power),
    )  # fmt: skip
    return alike


def _sureness(to_boundary: NDArray[np.float32], uv: FloatArray, boundary_px: float) -> Weights:
    """(N,) 0 to 1: how far from a label boundary, in units of boundary_px; 1 px is counted at a boundary itself."""
    height, width = to_boundary.shape
    u = np.clip(np.floor(np.nan_to_num(uv[:, 0]) + 0.5), 0, width - 1).astype(np.intp)
    v = np.clip(np.floor(np.nan_to_num(uv[:, 1]) + 0.5), 0, height - 1).astype(np.intp)
    return np.asarray(np.minimum((to_boundary[v, u] + 1.0) / boundary_px, 1.0), np.float32)
