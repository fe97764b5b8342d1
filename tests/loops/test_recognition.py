"""Loops where the odometry does not know the place: after a loss of tracking, and after much drift."""

from dataclasses import replace

import numpy as np
import pytest

from loops.made_drives import made_places, there, with_features
from registration.made_streets import made_street
from wayloom.geometry import se3
from wayloom.loops.recognition import recognition
from wayloom.loops.search import find_loops
from wayloom.loops.settings import LoopSettings
from wayloom.places.types import Places

ELSEWHERE = se3.exp(np.array([25.0, 3.0, -40.0, 0.0, 1.2, 0.0]))
BENT = se3.exp(np.array([20.0, 0.0, 12.0, 0.0, 0.05, 0.0]))
UNSURE = LoopSettings(drift_share=0.1, drift_deg_per_sqrt_m=1.0)
"""Odometry that knows the place of the second pass to 18 m: 180 m of road lie between, with the way back."""


@pytest.fixture(scope="module")
def way() -> np.ndarray:
    """Along a street, and 40 m of it again."""
    return np.concatenate([there(40.0, 150.0), there(60.0, 100.0)])


@pytest.fixture(scope="module")
def places(way: np.ndarray) -> Places:
    return with_features(made_places(made_street(4), way, 1), way, 2)


def again(places: Places) -> np.ndarray:
    return np.arange(len(places)) >= 55


def moved(places: Places, T: np.ndarray) -> Places:
    """The second pass elsewhere."""
    T_world = places.T_world_keyframe.copy()
    T_world[again(places)] = T @ T_world[again(places)]
    return replace(places, T_world_keyframe=T_world)


def furthest_m(loops, way: np.ndarray) -> float:  # type: ignore[no-untyped-def]
    truth = se3.inverse(way[loops.first]) @ way[loops.second]
    return float(np.linalg.norm(loops.T_first_second[:, :3, 3] - truth[:, :3, 3], axis=1).max())


def test_a_place_is_closed_across_a_loss_of_tracking(places: Places, way: np.ndarray) -> None:
    loops = find_loops(replace(moved(places, ELSEWHERE), segment=again(places).astype(np.int32)))
    assert len(loops) >= 5
    assert furthest_m(loops, way) < 0.3


def test_a_place_is_closed_where_the_odometry_has_drifted_far(places: Places, way: np.ndarray) -> None:
    loops = find_loops(moved(places, BENT), UNSURE)
    assert len(loops) >= 5
    assert furthest_m(loops, way) < 0.3


def test_other_streets_after_a_loss_are_not_closed(places: Places, way: np.ndarray) -> None:
    other = with_features(made_places(made_street(9), way, 3), way, 4)
    second = again(places)
    cloud, features = other.cloud, other.features
    first_cloud, first_features = places.cloud, places.features
    both = replace(
        places,
        segment=second.astype(np.int32),
        cloud=type(cloud)(*(joined(one, two, first_cloud.keyframe, cloud.keyframe) for one, two in columns(first_cloud, cloud))),
        features=type(features)(
            *(joined(one, two, first_features.keyframe, features.keyframe) for one, two in columns(first_features, features))
        ),
    )
    assert len(find_loops(both)) == 0


def columns(one, two):  # type: ignore[no-untyped-def]
    return [(getattr(one, name), getattr(two, name)) for name in one.__slots__]


def joined(one: np.ndarray, two: np.ndarray, of_one: np.ndarray, of_two: np.ndarray) -> np.ndarray:
    """Rows of the one's first pass and of the other's second."""
    return np.concatenate([one[of_one < 55], two[of_two >= 55]])


def test_an_odometry_that_knows_every_place_asks_no_index(places: Places) -> None:
    assert recognition(places, LoopSettings()) is None
    assert recognition(places, UNSURE) is not None


def test_the_index_proposes_what_the_odometry_neither_knows_nor_denies(places: Places) -> None:
    known = recognition(places, UNSURE)
    assert known is not None
    road = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(places.T_world_keyframe[:, :3, 3], axis=0), axis=1))])
    station = int(np.argmax(places.stations.keyframe >= 60))
    j = int(places.stations.keyframe[station])
    found = known.candidates(places, road, station, UNSURE)
    assert found
    assert abs(found[0] - (j - 55 + 10)) <= 3
    denied = moved(places, se3.exp(np.array([400.0, 0.0, 0.0, 0.0, 0.0, 0.0])))
    assert known.candidates(denied, road, station, UNSURE) == []
