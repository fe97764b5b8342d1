"""Grey values of merged voxels."""

import numpy as np

from submaps.made_submaps import random_submap
from wayloom.stitching.merge import merge
from wayloom.stitching.settings import MergeSettings
from wayloom.stitching.voxels import _mean_grey


def test_a_voxels_grey_is_the_mean_of_its_points_weighed_as_their_positions():
    grey, weight, voxel = np.array([10, 250, 7], np.uint8), np.array([3, 1, 160_000]), np.array([0, 0, 1])
    assert _mean_grey(grey, weight, voxel, np.array([4, 160_000])).tolist() == [70, 7]


def test_sums_of_the_heaviest_points_lose_nothing():
    n = 100_000
    grey, weight, voxel = np.full(n, 255, np.uint8), np.full(n, 160_000), np.zeros(n, np.int64)
    grey[0] = 254
    weight[0] = 1
    assert _mean_grey(grey, weight, voxel, np.array([weight.sum()])).tolist() == [255]


def test_a_lone_points_grey_is_its_voxels():
    item = random_submap(0, 300, "a")
    whole = merge([item], MergeSettings())
    assert len(whole) > 10
    alone = whole.count == 1
    assert set(whole.grey[alone].tolist()) <= set(item.submap.grey.tolist())
