"""Place views: the surroundings of a keyframe, put together from what is stored by keyframe."""

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.places.road import road_m
from wayloom.places.types import PlaceFeatures, Places, PlaceView

FloatArray = NDArray[np.float64]
LOOK_AHEAD_M = 10.0
"""Cameras look forward: what lies around a keyframe was seen, on the mean, from so far behind it."""


def view_at(
    places: Places, anchor: int, reach_m: float = 30.0, T_world_cam: FloatArray | None = None, up_world: FloatArray | None = None
) -> PlaceView:
    """The view of a keyframe: what its segment's keyframes within `reach_m` of road around the one LOOK_AHEAD_M behind it host, so
    that it reaches as far back as forward, and a view from the other direction has the same surroundings.

    T_world_cam : (K, 4, 4) poses of the keyframes; None takes the odometry's
    up_world    : (3,) where up is; None takes the mean upward axis of the cameras within reach
    """
    T = places.T_world_keyframe if T_world_cam is None else T_world_cam
    first, last = within_reach(road_m(T), places.segment, anchor, reach_m)
    up = -T[first:last, :3, 1].mean(axis=0) if up_world is None else up_world
    T_level_cam = level_from_cam(T[anchor], up)
    T_level = T_level_cam @ se3.inverse(T[anchor])
    cloud, features = places.cloud, places.features
    rows = slice(*np.searchsorted(cloud.keyframe, [first, last]).tolist())
    hosts, camera = np.unique(cloud.keyframe[rows], return_inverse=True)
    T_level_host = T_level @ T[hosts]
    p_cam = 0.01 * cloud.p_cam[rows].astype(np.float64)
    xyz = np.einsum("nij,nj->ni", T_level_host[camera, :3, :3], p_cam) + T_level_host[camera, :3, 3]
    seen = slice(*np.searchsorted(features.keyframe, [first, last]).tolist())
    described, row = np.unique(features.keyframe[seen], return_inverse=True)
    near = PlaceFeatures(
        row.astype(np.int32), features.bits[seen], features.uv[seen], features.p_cam[seen], features.sigma_m[seen]
    )  # fmt: skip
    return PlaceView(
        anchor, T_level_cam, xyz.astype(np.float32), cloud.label[rows], 0.01 * cloud.sigma_cm[rows].astype(np.float32),
        camera.astype(np.int32), T_level_host[:, :3, 3], near, T_level @ T[described],
    )  # fmt: skip


def level_from_cam(T_world_cam: FloatArray, up_world: FloatArray) -> FloatArray:
    """T_level_cam (4, 4): z along up_world (3,), y along the level heading of the camera's axis, the origin at the camera."""
    R_cam_world = T_world_cam[:3, :3].T
    up = R_cam_world @ (up_world / np.linalg.norm(up_world))
    forward = np.array([0.0, 0.0, 1.0]) - up[2] * up
    forward /= np.linalg.norm(forward)
    return se3.from_rotation_translation(np.stack([np.cross(forward, up), forward, up]), np.zeros(3))


def within_reach(road: FloatArray, segment: NDArray[np.int32], anchor: int, reach_m: float) -> tuple[int, int]:
    """First keyframe and the one behind the last of the anchor's segment that a view takes; the anchor itself always is between.

    road : (K,) m
    """
    ahead = road - road[anchor] + LOOK_AHEAD_M
    members = np.flatnonzero((segment == segment[anchor]) & (np.abs(ahead) <= reach_m))
    return min([anchor, *members[:1].tolist()]), max([anchor, *members[-1:].tolist()]) + 1
