"""Made voxel maps that span several tiles."""

import numpy as np

from wayloom.geodesy import wgs84
from wayloom.geodesy.map_frame import map_frame_for
from wayloom.stitching.regions import STATIC_CLASSES
from wayloom.stitching.voxel_map import VoxelMap
from wayloom.tiles.pyramid import Track


def made_map(voxels: int = 3000, lon: float = 8.39, lat: float = 48.98, extent_m: float = 150.0, seed: int = 0) -> VoxelMap:
    rng = np.random.default_rng(seed)
    frame = map_frame_for(lon, lat)
    centre = wgs84.enu_from_lonlatheight(np.array([[lon, lat, 115.0]]), frame)[0]
    points = centre + rng.uniform([-extent_m, -extent_m, -2.0], [extent_m, extent_m, 12.0], (voxels, 3))
    keys = np.floor(points / 0.1).astype(np.int32)
    _, rows = np.unique(keys, axis=0, return_index=True)
    n = len(rows)
    label = rng.choice(STATIC_CLASSES, n).astype(np.uint8)
    votes = rng.uniform(0.0, 1.0, (n, 19)).astype(np.float32)
    votes[np.arange(n), label] = 2.0
    count, drives, seen_ns = rng.integers(1, 50, n).astype(np.uint32), rng.integers(1, 400, n), rng.integers(10**18, 2 * 10**18, n)
    start = np.concatenate([[0], np.cumsum(drives)])
    drive = (np.arange(start[-1]) - np.repeat(start[:-1], drives)).astype(np.int32)
    names = tuple(f"drive-{i:03d}" for i in range(400))
    sigma, grey = np.full(n, 0.05, np.float32), rng.integers(0, 256, n).astype(np.uint8)
    return VoxelMap(
        frame, 0.1, keys[rows], points[rows], grey, sigma, votes, label, count, start, drive, seen_ns - 10**9, seen_ns, names
    )


def made_tracks(voxel_map: VoxelMap) -> list[Track]:
    middle = voxel_map.points_enu.mean(axis=0)
    along = np.linspace(-180.0, 180.0, 100)
    one = np.column_stack([middle[0] + along, middle[1] + 0.3 * along, np.full(100, middle[2])])
    other = np.column_stack([middle[0] + 0 * along, middle[1] + along, np.full(100, middle[2])])
    return [Track("drive-a", one), Track("drive-b", other)]
