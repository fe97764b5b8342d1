"""Columns of voxels around a place on Earth."""

import numpy as np
from numpy.typing import NDArray

from wayloom.geodesy import wgs84
from wayloom.geodesy.map_frame import MapFrame
from wayloom.geometry import se3
from wayloom.stitching.voxel_map import VoxelMap


def column(voxels: VoxelMap, lon_deg: float, lat_deg: float, radius_m: float) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The rows of the voxels that lie within a radius of a place, whatever their height, and how far from it each lies, m.

    Nearest first, the lower row where two are as near. The voxels are of a map in a frame.
    """
    assert voxels.frame is not None
    T_place_map = wgs84.T_enu_enu(MapFrame(lon_deg, lat_deg, 0.0), voxels.frame)
    distance_m = np.linalg.norm(se3.transform(T_place_map, voxels.points_enu)[:, :2], axis=1)
    near = np.flatnonzero(distance_m <= radius_m)
    order = near[np.argsort(distance_m[near], kind="stable")]
    return order, distance_m[order]
