"""Initial GNSS alignment of each track segment, robust against outliers."""

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.georeference.rigid import align_rigid, align_robust, align_yaw, horizontal_spread, ransac_yaw
from wayloom.georeference.settings import GeoReferenceSettings
from wayloom.mapping.drive_types import AntennaFixes

FloatArray = NDArray[np.float64]
DRIFT_SHARE = 0.01  # of the road travelled: what a rigid alignment must forgive the odometry
MIN_SPREAD_M = 2.0  # under this a heading from two fixes says nothing
MIN_WIDTH_M = 10.0  # a track this wide in both directions fixes its own tilt
MAX_TILT_RAD = 0.2


def guess_nodes(
    T_world_node: FloatArray, segment: NDArray[np.int32], fixes: AntennaFixes, road_m: FloatArray, settings: GeoReferenceSettings
) -> FloatArray:
    """T_enu_node (K, 4, 4). A segment without fixes follows its neighbour by the odometry's guess over the loss.

    T_world_node : (K, 4, 4), segment : (K,), road_m : (K,) m of road to each node
    """
    guesses: dict[int, FloatArray] = {}
    for s in np.unique(segment).tolist():
        rows = np.flatnonzero(segment[fixes.node] == s)
        if len(rows):
            guesses[s] = align_segment(T_world_node, segment == s, fixes.take(rows), road_m, settings)
    known = np.array(sorted(guesses))
    nearest = {s: guesses[int(known[np.argmin(np.abs(known - s))])] for s in np.unique(segment).tolist()}
    return np.array([nearest[int(s)] for s in segment]) @ T_world_node


def align_segment(
    T_world_node: FloatArray, members: NDArray[np.bool_], fixes: AntennaFixes, road_m: FloatArray, settings: GeoReferenceSettings
) -> FloatArray:
    """T_enu_world (4, 4) of one segment: levelled by its cameras, turned and moved by its fixes; a wide track tilts too."""
    T_level_world = level_world(T_world_node[members])
    T = T_world_node[fixes.node]
    antenna = se3.transform(T_level_world, np.einsum("nij,nj->ni", T[:, :3, :3], fixes.p_node_gnss) + T[:, :3, 3])
    road = np.ptp(road_m[fixes.node])
    sigma = np.sqrt(np.trace(fixes.covariance, axis1=1, axis2=2) + settings.gate_floor_m**2 + (DRIFT_SHARE * road) ** 2)
    if len(fixes) < 2 or horizontal_spread(antenna)[0] < MIN_SPREAD_M:
        shift = np.median(fixes.position_enu - antenna, axis=0)
        return se3.from_rotation_translation(np.eye(3), shift) @ T_level_world
    inlier = ransac_yaw(antenna, fixes.position_enu, sigma, settings.ransac_threshold_sigma, settings.ransac_rounds)
    T_enu_level, _ = align_robust(antenna[inlier], fixes.position_enu[inlier], sigma[inlier], align_yaw)
    if inlier.sum() >= 4 and horizontal_spread(antenna[inlier])[1] > MIN_WIDTH_M:
        tilted, _ = align_robust(antenna[inlier], fixes.position_enu[inlier], sigma[inlier], align_rigid)
        if np.arccos(np.clip(tilted[2, 2], -1.0, 1.0)) < MAX_TILT_RAD:
            T_enu_level = tilted
    return T_enu_level @ T_level_world


def level_world(T_world_cam: FloatArray) -> FloatArray:
    """T_level_world (4, 4): its up axis is the mean upward axis of the cameras (N, 4, 4), the first looks along its second axis."""
    up = -T_world_cam[:, :3, 1].mean(axis=0)
    up /= np.linalg.norm(up)
    forward = T_world_cam[0, :3, 2] - (T_world_cam[0, :3, 2] @ up) * up
    forward /= np.linalg.norm(forward)
    return se3.from_rotation_translation(np.stack([np.cross(forward, up), forward, up]), np.zeros(3))
