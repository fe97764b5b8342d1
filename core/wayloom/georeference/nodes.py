"""Node selection for a drive's graph, and interpolation of its solution back to all frames."""

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.georeference.fixes import interpolate
from wayloom.mapping.drive_types import OdometryChain
from wayloom.odometry.types import Keyframes, Trajectory

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


def travelled(trajectory: Trajectory) -> FloatArray:
    """(N,) m of road from the first frame to each."""
    steps = np.linalg.norm(np.diff(trajectory.T_world_cam[:, :3, 3], axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def choose_nodes(trajectory: Trajectory, keyframes: NDArray[np.int32], spacing_m: float) -> IntArray:
    """(K,) increasing frames: tracked keyframes, the ends of every segment, and others so that none is further apart."""
    road = travelled(trajectory)
    wanted = np.zeros(len(trajectory), bool)
    wanted[keyframes] = True
    wanted[[0, -1]] = True
    change = np.flatnonzero(np.diff(trajectory.segment))
    wanted[change] = wanted[change + 1] = True
    last = 0
    for i in range(1, len(trajectory)):
        if wanted[i] or road[i] - road[last] >= spacing_m:
            wanted[i], last = True, i
    wanted[~trajectory.tracked] = False
    return np.flatnonzero(wanted)


def odometry_chain(
    trajectory: Trajectory, nodes: IntArray, level_every_m: float, keyframes: Keyframes | None = None
) -> OdometryChain:
    """The odometry between the nodes, and one level prior in the middle of each level_every_m (one a segment at least).

    keyframes : by which the links' covariance is known
    """
    road = travelled(trajectory)[nodes]
    segment = trajectory.segment[nodes]
    level: list[int] = []
    for s in np.unique(segment):
        rows = np.flatnonzero(segment == s)
        first, last = road[rows[0]], road[rows[-1]]
        pieces = max(1, round((last - first) / level_every_m))
        middles = first + (np.arange(pieces) + 0.5) * (last - first) / pieces
        level += rows[np.searchsorted(road[rows], middles).clip(0, len(rows) - 1)].tolist()
    connected = segment[1:] == segment[:-1]
    covariance = np.zeros((len(nodes) - 1, 6, 6)) if keyframes is None else link_covariances(keyframes, nodes, segment)
    return OdometryChain(trajectory.T_world_cam[nodes], np.diff(road), connected, np.unique(np.array(level, np.int64)), covariance)


def link_covariances(keyframes: Keyframes, nodes: IntArray, segment: NDArray[np.int32]) -> FloatArray:
    """(K - 1, 6, 6) as `OdometryChain.link_covariance`, of nodes and the segments (K,) that they are in.

    A link has that share of the covariance of the step between keyframes in which it lies that it has of its frames; one after a
    segment's last keyframe goes by the step that led there. 0 where nothing is known.
    """
    out, covariance = np.zeros((len(nodes) - 1, 6, 6)), keyframes.step_covariance
    if len(covariance) < 2:
        return out
    known = np.asarray(np.isfinite(covariance).all(axis=(1, 2)))
    after = np.searchsorted(keyframes.frame, nodes[:-1], side="right")
    filled = np.zeros(len(out), bool)
    for row in (after, after - 1):
        k = np.clip(row, 1, len(known) - 1)
        good = ~filled & (row == k) & known[k] & (keyframes.segment[k] == segment[:-1])
        share = np.diff(nodes)[good] / np.diff(keyframes.frame)[k[good] - 1]
        out[good] = share[:, None, None] * covariance[k[good]]
        filled |= good
    return out


def nearest_node(nodes: IntArray, segment: NDArray[np.int32], frames: IntArray) -> IntArray:
    """(M,) for each frame the row of the nearest node, of its own segment where that has one."""
    before = np.clip(np.searchsorted(nodes, frames, side="right") - 1, 0, len(nodes) - 1)
    both = np.stack([before, np.minimum(before + 1, len(nodes) - 1)])
    distance = np.abs(nodes[both] - frames) + len(segment) * (segment[nodes[both]] != segment[frames])
    return np.asarray(np.where(distance[0] <= distance[1], both[0], both[1]))


def spread_poses(trajectory: Trajectory, nodes: IntArray, T_enu_node: FloatArray) -> FloatArray:
    """(N, 4, 4) every frame in the plane of the nodes: carried by the node before and the node after, blended by its place between.

    So the path between two nodes is the odometry's and has no step at either.
    """
    before, after, share = _between_nodes(len(trajectory), nodes)
    T_enu_world = T_enu_node @ se3.inverse(trajectory.T_world_cam[nodes])
    by_before = T_enu_world[before] @ trajectory.T_world_cam
    by_after = T_enu_world[after] @ trajectory.T_world_cam
    return interpolate(by_before, by_after, share)


def spread_covariances(count: int, nodes: IntArray, covariance: FloatArray) -> FloatArray:
    """(N, 6, 6): between nodes the weighted mean of both. Left perturbations of rigidly joined frames are one and the same."""
    before, after, share = _between_nodes(count, nodes)
    return np.asarray((1.0 - share)[:, None, None] * covariance[before] + share[:, None, None] * covariance[after])


def _between_nodes(count: int, nodes: IntArray) -> tuple[IntArray, IntArray, FloatArray]:
    frames = np.arange(count)
    before = np.clip(np.searchsorted(nodes, frames, side="right") - 1, 0, len(nodes) - 1)
    after = np.minimum(before + 1, len(nodes) - 1)
    step = np.maximum(nodes[after] - nodes[before], 1)
    return before, after, np.clip((frames - nodes[before]) / step, 0.0, 1.0)
