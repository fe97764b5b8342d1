"""Consistency of labels without truth: flips between the observers of a point, disagreement of points at one place."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from wayloom.config.classes import VOID
from wayloom.geometry import se3
from wayloom.labelling.images import LabelImages
from wayloom.labelling.kernels.voting import read_labels
from wayloom.odometry.types import OdometryResult

Labels = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Consistency:
    """flips: share of steps from one observer of a point to the next (left images, in time order) at which its label changes;
    disagreement: of two points of different keyframes at the same place, how often their labels differ, by name of the labels;
    steps, pairs: of how many."""

    steps: int
    flips: float
    pairs: int
    disagreement: dict[str, float]


def consistency(
    odometry: OdometryResult, images: LabelImages, labels: dict[str, Labels], radius_share: float = 0.01
) -> Consistency:
    """Measure a labelled drive.

    images : by keyframe row
    labels : name to labels (P,) of its points
    radius_share : two points are at the same place when they are closer than this share of their distance from their host
    """
    steps, flips = _flips(odometry, images)
    pairs = _neighbours(odometry, radius_share)
    differ = {}
    for name, of_points in labels.items():
        one, other = of_points[pairs[:, 0]], of_points[pairs[:, 1]]
        known = (one != VOID) & (other != VOID)
        differ[name] = float((one != other)[known].mean()) if known.any() else float("nan")
    return Consistency(steps, flips / steps if steps else float("nan"), len(pairs), differ)


def _flips(odometry: OdometryResult, images: LabelImages) -> tuple[int, int]:
    """How many steps there are between the observers of all points, the host among them, and at how many the label changes."""
    points, camera = odometry.points, odometry.rig.camera
    of_point = np.repeat(np.arange(len(points)), np.diff(points.obs_start))
    point = np.concatenate([np.arange(len(points)), of_point])
    keyframe = np.concatenate([points.host, points.obs_keyframe])
    world, seen = odometry.points_world(), np.full(len(point), VOID, np.uint8)
    for j in range(len(odometry.keyframes)):
        rows = np.flatnonzero(keyframe == j)
        p_cam = se3.transform(se3.inverse(odometry.keyframes.T_world_cam[j]), world[point[rows]])
        seen[rows] = read_labels(images.left(j), camera.project(p_cam))
    order = np.lexsort((keyframe, point))
    order = order[seen[order] != VOID]
    same_point = np.diff(point[order]) == 0
    return int(same_point.sum()), int((same_point & (np.diff(seen[order].astype(np.int64)) != 0)).sum())


def _neighbours(odometry: OdometryResult, radius_share: float) -> NDArray[np.int64]:
    """(N, 2) each point and the nearest one of another keyframe, where that lies at the same place."""
    points, world = odometry.points, odometry.points_world()
    if len(points) < 2:
        return np.zeros((0, 2), np.int64)
    radius = radius_share / np.maximum(points.inverse_depth.astype(np.float64), 1e-9)
    distance, nearest = cKDTree(world).query(world, k=min(8, len(points)))
    other = (points.host[np.minimum(nearest, len(points) - 1)] != points.host[:, None]) & (distance <= radius[:, None])
    first = other.argmax(axis=1)
    rows = np.flatnonzero(other.any(axis=1))
    return np.column_stack([rows, nearest[rows, first[rows]]])
