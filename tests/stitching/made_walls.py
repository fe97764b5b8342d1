"""Made submaps of a street with exact truth: a wall, a road, a hedge and a parked car, seen in passing."""

import numpy as np

from submaps.made_submaps import FRAME
from wayloom.geometry import se3
from wayloom.submaps.submap import PlacedSubmap, Submap

WALL_M = 10.0
"""East of the camera's way; the road lies 1.5 m under it."""
BUILDING, ROAD, HEDGE, CAR, PERSON = 2, 0, 8, 13, 11
PLACE = np.array([-8000.0, 55_000.0, -130.0])


def street_submap(
    seed: int, points: int = 600, drive: str | None = None, length_m: float = 20.0, sigma_m: tuple[float, float] = (0.03, 0.6)
) -> PlacedSubmap:
    """Points of `length_m` of street, each off along its ray by its own sigma, drawn from log-uniform `sigma_m`."""
    rng = np.random.default_rng(seed)
    cameras = np.column_stack([np.zeros(8), np.linspace(-3.0, length_m - 6.0, 8), np.zeros(8)])
    kind = rng.choice([BUILDING, ROAD, HEDGE, CAR, PERSON], points, p=[0.5, 0.25, 0.1, 0.1, 0.05])
    north = rng.uniform(0.0, length_m, points)
    true = np.column_stack([np.full(points, WALL_M), north, rng.uniform(-1.0, 5.0, points)])
    road, hedge, car = kind == ROAD, kind == HEDGE, np.isin(kind, (CAR, PERSON))
    true[road] = np.column_stack([rng.uniform(-3.0, 6.0, road.sum()), north[road], np.full(road.sum(), -1.5)])
    true[hedge] = rng.uniform([7.0, 0.0, -1.5], [8.5, length_m, 0.0], (hedge.sum(), 3))
    true[car] = rng.uniform([4.0, 5.0, -1.5], [5.8, 9.5, 0.0], (car.sum(), 3))
    host = rng.integers(0, len(cameras), points)
    ray = true - cameras[host]
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    sigma = np.exp(rng.uniform(*np.log(sigma_m), points))
    xyz = true + ray * (rng.normal(size=points) * sigma)[:, None]
    length = rng.integers(0, 3, points)
    start = np.concatenate([[0], np.cumsum(length)])
    T = np.tile(np.eye(4), (len(cameras), 1, 1))
    T[:, :3, 3] = cameras
    t_ns = 10**18 + seed * 10**12 + np.arange(len(cameras)) * 500_000_000
    submap = Submap(
        xyz=xyz.astype(np.float32),
        label=kind.astype(np.uint8),
        variance=(sigma**2 + 0.02**2).astype(np.float32),
        grey=np.zeros(points, np.uint8),
        seen_ns=t_ns[host],
        keyframe=host.astype(np.uint32),
        vote_start=start.astype(np.uint32),
        vote_class=np.concatenate([np.sort(rng.choice([0, 1, 2, 8], n, replace=False)) for n in length]).astype(np.uint8),
        vote_weight=rng.uniform(0.02, 0.5, start[-1]).astype(np.float32),
        keyframe_frame=np.arange(len(cameras), dtype=np.uint32),
        keyframe_t_ns=t_ns,
        T_submap_cam=T,
        length_m=length_m,
        points_left_out={},
    )
    T_enu_submap = np.eye(4)
    T_enu_submap[:3, 3] = PLACE + np.array([0.0, 0.7 * length_m * (seed % 3), 0.0])
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = np.eye(3) * 0.02**2
    return PlacedSubmap(submap, T_enu_submap, covariance, drive or f"drive-{seed % 4}", FRAME)


def true_east(item: PlacedSubmap) -> float:
    """Of the wall in the map's frame, m."""
    return float(item.T_enu_submap[0, 3] + WALL_M)


def turned(item: PlacedSubmap, yaw_rad: float) -> PlacedSubmap:
    """The same submap turned about its own origin."""
    T = item.T_enu_submap.copy()
    T[:3, :3] = se3.exp(np.array([0, 0, 0, 0, 0, yaw_rad]))[:3, :3]
    return PlacedSubmap(item.submap, T, item.covariance, item.drive_id, item.frame)
