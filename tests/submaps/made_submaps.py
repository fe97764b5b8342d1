"""Small made drives and submaps."""

import numpy as np

from wayloom.geodesy.map_frame import MapFrame
from wayloom.geometry import se3
from wayloom.geometry.camera import PinholeCamera, StereoRig
from wayloom.georeference.types import GeoReference
from wayloom.labelling.types import PointLabels
from wayloom.odometry.types import Keyframes, OdometryResult, Points, Trajectory
from wayloom.submaps.submap import PlacedSubmap, Submap

FRAME = MapFrame(8.5, 48.5, 0.0)
RIG = StereoRig(PinholeCamera(500.0, 500.0, 320.0, 120.0, 640, 240), (-0.5, 0.0, 0.0))


class NamedLog:
    """All that the submaps read of a log."""

    name = "made"


def made_odometry(road_m: float = 200.0, points_a_keyframe: int = 30, seed: int = 0, segments: int = 1) -> OdometryResult:
    """A straight road along z, a frame a metre, a keyframe every second frame, points in front of each."""
    rng = np.random.default_rng(seed)
    n = int(road_m) + 1
    T = np.tile(np.eye(4), (n, 1, 1))
    T[:, 2, 3] = np.arange(n)
    segment = (np.arange(n) * segments // n).astype(np.int32)
    t_ns = 5_000_000_000 + np.arange(n, dtype=np.int64) * 100_000_000
    frame = np.arange(0, n, 2, dtype=np.int32)
    k = len(frame)
    keyframes = Keyframes(frame, T[frame], np.zeros((k, 4)), segment[frame])
    p = k * points_a_keyframe
    points = Points(
        host=np.repeat(np.arange(k, dtype=np.int32), points_a_keyframe),
        uv_host=(rng.random((p, 2)) * [639, 239]).astype(np.float32),
        inverse_depth=rng.uniform(0.02, 0.5, p).astype(np.float32),
        variance=rng.uniform(1e-8, 5e-7, p).astype(np.float32),
        grey=rng.integers(0, 256, p).astype(np.uint8),
        obs_start=np.zeros(p + 1, np.int64),
        obs_keyframe=np.zeros(0, np.int32),
        obs_right=np.zeros(0, bool),
        host_right=np.ones(p, bool),
    )
    return OdometryResult(RIG, Trajectory(t_ns, T, np.ones(n, bool), segment), keyframes, points, 0.0, np.zeros(3))


def made_labels(count: int, seed: int = 0) -> PointLabels:
    """Every point votes for its label and one class more, or, one in ten, for nothing."""
    rng = np.random.default_rng(seed)
    label = rng.choice(np.array([0, 1, 2, 8, 10, 13, 255], np.uint8), count)
    silent = rng.random(count) < 0.1
    start, classes, weights = [0], [], []
    for own, quiet in zip(label.tolist(), silent.tolist(), strict=True):
        if own != 255 and not quiet:
            pair = sorted({own, int(rng.integers(0, 19))})
            classes += pair
            weights += [2.0 if c == own else 0.5 for c in pair]
        start.append(len(classes))
    return PointLabels(label, label, label, np.array(start, np.int64), np.array(classes, np.uint8), np.array(weights, np.float32))


def made_geo(odometry: OdometryResult, frame: MapFrame | None = FRAME) -> GeoReference:
    """The drive's world turned level and moved somewhere in the map."""
    T_enu_world = np.eye(4)
    T_enu_world[:3, :3] = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]
    T_enu_world[:3, 3] = [-8000.0, 55_000.0, -130.0]
    n = len(odometry.trajectory)
    covariance = np.tile(np.eye(6) * 1e-4, (n, 1, 1)) if frame else np.full((n, 6, 6), np.nan)
    return GeoReference(frame, T_enu_world @ odometry.trajectory.T_world_cam, covariance)


def random_submap(seed: int, points: int = 200, drive: str | None = None, spread_m: float = 3.0) -> PlacedSubmap:
    """Random points in a few metres, so that submaps of several seeds share many voxels."""
    rng = np.random.default_rng(seed)
    label = rng.choice(np.array([0, 1, 2, 8, 10, 13, 255], np.uint8), points)
    length = rng.integers(0, 4, points)
    start = np.concatenate([[0], np.cumsum(length)])
    classes = np.concatenate([np.sort(rng.choice(19, n, replace=False)) for n in length]).astype(np.uint8)
    submap = Submap(
        xyz=rng.uniform(-spread_m, spread_m, (points, 3)).astype(np.float32),
        label=label,
        variance=rng.uniform(1e-4, 0.3, points).astype(np.float32),
        grey=rng.integers(0, 256, points).astype(np.uint8),
        seen_ns=rng.integers(10**18, 2 * 10**18, points),
        keyframe=rng.integers(0, 3, points).astype(np.uint32),
        vote_start=start.astype(np.uint32),
        vote_class=classes,
        vote_weight=rng.uniform(0.02, 3.0, len(classes)).astype(np.float32),
        keyframe_frame=np.arange(3, dtype=np.uint32),
        keyframe_t_ns=np.arange(3, dtype=np.int64) * 10**8,
        T_submap_cam=se3.exp(np.array([[0, 0, i - 1.0, 0, 0, 0] for i in range(3)])),
        length_m=2.0,
        points_left_out={},
    )
    T = se3.exp(np.array([*rng.uniform(-0.2, 0.2, 3), *rng.uniform(-0.1, 0.1, 3)]))
    T[:3, 3] += [-8000.0, 55_000.0, -130.0]
    return PlacedSubmap(submap, T, np.eye(6) * 1e-4, drive or f"drive-{seed % 3}", FRAME)
