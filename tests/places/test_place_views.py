"""A view of a place holds what the keyframes nearby saw, in a level frame, wherever their poses have moved."""

from dataclasses import replace

import numpy as np

from places.made_places import random_places
from wayloom.geometry import se3
from wayloom.places.types import Places
from wayloom.places.views import LOOK_AHEAD_M, level_from_cam, view_at


def points_world(places: Places) -> np.ndarray:
    T = places.T_world_keyframe[places.cloud.keyframe]
    return np.einsum("nij,nj->ni", T[:, :3, :3], 0.01 * places.cloud.p_cam) + T[:, :3, 3]


def test_points_lie_in_the_anchors_level_frame():
    places = random_places(1)
    view = view_at(places, 25, reach_m=12.0)
    rows = np.abs(places.cloud.keyframe - (25 - LOOK_AHEAD_M)) <= 12
    x, y, z = (points_world(places)[rows] - places.T_world_keyframe[25, :3, 3]).T  # the camera looks along z, y is down
    np.testing.assert_allclose(view.xyz, np.column_stack([x, z, -y]), atol=1e-5)
    np.testing.assert_array_equal(view.label, places.cloud.label[rows])
    np.testing.assert_array_equal(view.camera, places.cloud.keyframe[rows] - 3)
    np.testing.assert_allclose(view.cameras, np.column_stack([np.zeros(25), np.arange(-22.0, 3.0), np.zeros(25)]), atol=1e-9)


def test_a_feature_projects_into_its_keyframe_of_the_view():
    places = random_places(2)
    view = view_at(places, 25, reach_m=12.0)
    f = view.features
    T = view.T_level_keyframe[f.keyframe]
    level = np.einsum("nij,nj->ni", T[:, :3, :3], f.p_cam) + T[:, :3, 3]
    own = places.features.keyframe == 25
    at_anchor = se3.transform(view.T_level_cam, places.features.p_cam[own].astype(float))
    np.testing.assert_allclose(level[f.keyframe == 22], at_anchor, atol=1e-5)


def test_a_view_does_not_change_when_the_whole_drive_is_moved():
    places = random_places(3)
    T = se3.exp(np.array([10.0, -3.0, 2.0, 0.3, -1.2, 0.4]))
    view, moved = view_at(places, 12), view_at(places, 12, T_world_cam=T @ places.T_world_keyframe)
    np.testing.assert_allclose(moved.xyz, view.xyz, atol=1e-4)
    np.testing.assert_allclose(moved.T_level_keyframe, view.T_level_keyframe, atol=1e-9)


def test_a_moved_keyframe_takes_its_points_along():
    places = random_places(4)
    T = places.T_world_keyframe.copy()
    T[14, 0, 3] += 0.5
    shift = view_at(places, 10, T_world_cam=T).xyz - view_at(places, 10).xyz
    hosted = view_at(places, 10).camera == 14
    np.testing.assert_allclose(shift[hosted], np.tile([0.5, 0.0, 0.0], (hosted.sum(), 1)), atol=1e-4)
    np.testing.assert_allclose(shift[~hosted], 0.0, atol=1e-6)


def test_the_anchor_is_in_its_view_however_short_the_reach():
    view = view_at(random_places(5), 20, reach_m=3.0)
    assert len(view.cameras) == 14
    np.testing.assert_allclose(view.cameras[-1], 0.0, atol=1e-9)


def test_keyframes_of_another_segment_are_not_in_the_view():
    places = random_places(5)
    cut = replace(places, segment=(np.arange(len(places)) >= 12).astype(np.int32))
    assert len(np.unique(view_at(cut, 10).camera)) == 12
    assert len(np.unique(view_at(cut, 12).camera)) == len(places) - 12


def test_the_level_frame_follows_the_given_up_and_the_cameras_heading():
    T = se3.exp(np.array([0.0, 0.0, 0.0, 0.1, 0.7, -0.2]))
    up = np.array([0.05, -1.0, 0.02])
    R = level_from_cam(T, up)[:3, :3]
    np.testing.assert_allclose(R @ T[:3, :3].T @ (up / np.linalg.norm(up)), [0.0, 0.0, 1.0], atol=1e-12)
    forward = R @ np.array([0.0, 0.0, 1.0])
    assert forward[1] > 0
    assert abs(forward[0]) < 1e-12
    assert np.isclose(np.linalg.det(R), 1.0)
