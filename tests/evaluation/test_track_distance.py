"""Distances of tracks on Earth."""

import numpy as np
import pytest

from wayloom.errors import InputError
from wayloom.evaluation import georeference
from wayloom.geodesy.map_frame import MapFrame
from wayloom.geodesy.wgs84 import lonlatheight_from_enu
from wayloom.geometry import se3

KARLSRUHE = MapFrame(8.4229, 49.0112, 112.8)
FAR_ORIGIN = MapFrame(8.5, 49.5, 0.0)


def track(offset=(0.0, 0.0, 0.0)):
    """(50, 3) WGS84: 100 m to the north-east of Karlsruhe, moved by `offset` m east, north, up."""
    s = np.linspace(0, 100, 50)
    return lonlatheight_from_enu(np.column_stack([s * 0.6, s * 0.8, 0 * s]) + offset, KARLSRUHE)


def test_an_offset_is_split_into_horizontal_and_vertical():
    distance = georeference.track_distance(track((0.3, 0.4, -1.2)), track())
    assert distance.horizontal.median_m == pytest.approx(0.5, abs=1e-4)
    assert distance.vertical.max_m == pytest.approx(1.2, abs=1e-4)
    assert distance.positions == 50


def test_a_far_map_origin_does_not_tilt_the_vertical():
    T = np.tile(np.eye(4), (50, 1, 1))
    T[:, :3, 3] = georeference.enu_from_lonlatheight(track((0.0, 0.0, 2.0)), FAR_ORIGIN)
    t_ns = np.arange(50, dtype=np.int64) * 10**8
    distance = georeference.distance_to_ins(T, FAR_ORIGIN, np.zeros(3), t_ns, t_ns, track())
    assert distance.horizontal.max_m < 1e-3
    assert distance.vertical.median_m == pytest.approx(2.0, abs=1e-3)


def test_the_antenna_stands_where_the_lever_arm_puts_it():
    T = se3.exp(np.array([[1.0, 2.0, 3.0, 0.0, 0.0, np.pi / 2]]))
    lever = np.array([1.0, 0.0, -0.5])
    np.testing.assert_allclose(georeference.antenna_enu(T, lever), [se3.transform(T[0], lever[None])[0]], atol=1e-12)


def test_an_ins_of_another_rate_is_taken_between_its_samples():
    frame_t, ins_t = np.arange(50, dtype=np.int64) * 10**8, np.arange(0, 50, 7, dtype=np.int64) * 10**8
    T = np.tile(np.eye(4), (50, 1, 1))
    T[:, :3, 3] = georeference.enu_from_lonlatheight(track(), KARLSRUHE)
    distance = georeference.distance_to_ins(T, KARLSRUHE, np.zeros(3), frame_t, ins_t, track()[::7])
    assert distance.positions == 50
    assert distance.horizontal.max_m < 1e-3


def test_frames_outside_the_ins_are_left_out():
    t_ns = np.arange(50, dtype=np.int64)
    T = np.tile(np.eye(4), (50, 1, 1))
    distance = georeference.distance_to_ins(T, KARLSRUHE, np.zeros(3), t_ns, t_ns[10:20], track()[10:20])
    assert distance.positions == 10


def test_tracks_that_never_meet_are_refused():
    with pytest.raises(InputError, match="no position is known in both"):
        georeference.track_distance(track(), np.full((50, 3), np.nan))


def test_tracks_of_different_lengths_are_refused():
    with pytest.raises(InputError, match="49 positions cannot be compared with 50"):
        georeference.track_distance(track()[1:], track())
