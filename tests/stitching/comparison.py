"""Comparison of maps bit by bit."""

import dataclasses

import numpy as np

from wayloom.stitching.voxel_map import VoxelMap


def assert_identical(one: VoxelMap, other: VoxelMap) -> None:
    for field in dataclasses.fields(VoxelMap):
        a, b = getattr(one, field.name), getattr(other, field.name)
        if isinstance(a, np.ndarray):
            assert a.dtype == b.dtype
            assert a.tobytes() == b.tobytes(), field.name
        else:
            assert a == b, field.name
