"""How vehicles go: smoothly, on their side of the street, at any moment."""

from itertools import pairwise

import numpy as np
import pytest

from wayloom.errors import ConfigError
from wayloom.simulation.city.city import City, build_city
from wayloom.simulation.city.city_settings import CitySettings
from wayloom.simulation.city.paths import LANE_M, lane_path
from wayloom.simulation.city.streets import ISLAND_M, ROUNDABOUT_M
from wayloom.simulation.city.terrain import FLAT, HILLS
from wayloom.simulation.models.catalogue import Models
from wayloom.simulation.traffic import signals
from wayloom.simulation.traffic.drives import RoutePlan, plan_drives
from wayloom.simulation.traffic.lanes import COMFORT_M_S2
from wayloom.simulation.traffic.routes import Route, eased

AROUND = (6, 7, 12, 11)


@pytest.fixture(scope="module")
def still_city() -> City:
    return build_city(CitySettings(seed=3, traffic=0.0, people=0.0), Models())


@pytest.fixture(scope="module")
def around(still_city: City) -> Route:
    return plan_drives(still_city, [RoutePlan(AROUND, 12.0, closed=True)])[0].route


@pytest.fixture(scope="module")
def lap(still_city: City) -> Route:
    return plan_drives(still_city, [RoutePlan(AROUND, 12.0, closed=True, laps=True)])[0].route


def test_a_lane_keeps_its_distance_to_the_right_of_the_streets() -> None:
    path = lane_path(np.array([[0.0, 0], [100, 0], [100, 80]]), LANE_M)
    assert path.at(20.0)[1] == pytest.approx(-LANE_M, abs=1e-6)
    assert path.at(path.length_m - 20)[0] == pytest.approx(100 + LANE_M, abs=1e-6)
    assert path.yaw[-1] - path.yaw[0] == pytest.approx(np.pi / 2, abs=1e-3)


def test_a_closed_path_ends_where_it_begins() -> None:
    path = lane_path(np.array([[0.0, 0], [30, 0], [30, 20], [0, 20]]), 0.0, 2.0, closed=True)
    np.testing.assert_allclose(path.xy[0], path.xy[-1])
    assert 90 < path.length_m < 100


@pytest.mark.parametrize("name", ["around", "lap"])
def test_place_and_attitude_have_continuous_second_derivatives(name: str, request: pytest.FixtureRequest) -> None:
    route: Route = request.getfixturevalue(name)
    t, h = np.arange(route.start_s, route.end_s, 0.005), 2e-3
    before, here, after = (route.pose(t + k * h)[:, :3].reshape(len(t), 12) for k in (-1, 0, 1))
    second = (before - 2 * here + after) / h**2
    fine, coarse = (np.abs(second[k:] - second[:-k]).max(axis=0) for k in (1, 4))
    assert np.all(fine < 0.35 * coarse + 0.02)  # a jump would be as large over a step as over four


def test_poses_are_rigid_and_on_the_ground(still_city: City, around: Route) -> None:
    T = around.pose(np.linspace(around.start_s, around.end_s, 200))
    np.testing.assert_allclose(T[:, :3, :3].transpose(0, 2, 1) @ T[:, :3, :3], np.broadcast_to(np.eye(3), (200, 3, 3)), atol=1e-12)
    ground = still_city.ground.height(T[:, 0, 3], T[:, 1, 3])
    assert np.abs(T[:, 2, 3] - ground).max() < 0.03
    assert T[:, 2, 2].min() > 0.99


def test_speed_changes_gently_and_bends_are_taken_slowly(around: Route) -> None:
    t = np.arange(around.start_s, around.end_s, 0.05)
    speed, change, jerk = (around.travelled(t, k) for k in (1, 2, 3))
    assert speed.min() > -0.01
    assert 9.0 < speed.max() < 12.6
    assert -4.0 < change.min() < -0.8
    assert 0.8 < change.max() < 2.0
    assert np.abs(jerk).max() < 8.0
    assert (speed**2 * np.abs(around.line.curvature(around.travelled(t)))).max() < 1.6 * COMFORT_M_S2


def test_a_vehicle_stops_at_a_red_light_and_goes_on_green(still_city: City) -> None:
    graph = still_city.graph
    shown = [(t, signals.lit(graph, 12, 7, t)) for t in np.arange(0.0, 60.0, 0.5)]
    red = next(t for (_, before), (t, now) in pairwise(shown) if before != now == (signals.RED,))
    way = RoutePlan((7, 12, 17, 22), float(red), reference=1, before_m=42.0, duration_s=22.0)
    route = plan_drives(still_city, [way])[0].route
    t = np.arange(route.start_s, route.end_s, 0.1)
    standing = t[route.travelled(t, 1) < 0.05]
    assert len(standing) > 5
    assert all(signals.GREEN not in signals.lit(graph, 12, 7, float(s)) for s in standing[:-20])
    place = route.places(standing[:1])[0]
    assert 15.0 < np.hypot(*(place - graph.nodes[12])) < 25.0
    assert route.travelled([route.end_s], 1)[0] > 5.0
    assert np.hypot(*(route.places([route.end_s])[0] - graph.nodes[12])) > 5.0


def test_a_way_around_a_roundabout_keeps_off_its_island(around: Route, still_city: City) -> None:
    t = np.arange(around.start_s, around.end_s, 0.1)
    gap = np.linalg.norm(around.places(t) - still_city.graph.nodes[11], axis=1)
    assert ISLAND_M + 1.5 < gap.min() < ROUNDABOUT_M - 1.5


def test_once_around_ends_where_it_began(around: Route) -> None:
    ends = around.places([around.start_s, around.end_s])
    assert np.hypot(*(ends[1] - ends[0])) < 1.5
    assert 280 < around.length_m < 420


def test_laps_repeat_exactly_and_last_a_whole_number_of_tenths(lap: Route) -> None:
    assert lap.lap_s is not None
    assert lap.lap_s * 10 == pytest.approx(round(lap.lap_s * 10), abs=1e-9)
    t = np.linspace(lap.start_s, lap.end_s, 57, endpoint=False)
    np.testing.assert_allclose(lap.pose(t + 3 * lap.lap_s), lap.pose(t), atol=1e-9)
    far = lap.travelled([lap.start_s, lap.start_s + 3 * lap.lap_s])
    assert far[1] - far[0] == pytest.approx(3 * lap.line.length_m, abs=1e-6)


def test_a_motion_has_derivatives_at_its_very_ends(around: Route) -> None:
    for t in (around.start_s, around.end_s):
        before, after = around.travelled([t - 1e-3, t + 1e-3], 1)
        assert before == pytest.approx(after, abs=0.02)
        assert after == pytest.approx(float(around.travelled([t], 1)[0]), abs=0.02)


def test_smoothing_keeps_even_motion_and_bounds_jerk() -> None:
    np.testing.assert_allclose(eased(2.0 * np.arange(30)), 2.0 * np.arange(30), atol=1e-12)
    stopped = eased(np.minimum(np.arange(60.0), 30.0))
    assert np.abs(np.diff(stopped, 3)).max() < 0.1


def test_a_way_begins_at_its_place_before_the_crossing(still_city: City) -> None:
    route = plan_drives(still_city, [RoutePlan((5, 6, 7, 12), 0.0, reference=2, before_m=58.0, duration_s=2.0)])[0].route
    place = route.places([0.0])[0]
    assert 50.0 < np.hypot(*(place - still_city.graph.nodes[7])) < 62.0


def test_ways_that_cannot_be_driven_are_refused(still_city: City) -> None:
    with pytest.raises(ConfigError, match="no street"):
        plan_drives(still_city, [RoutePlan((5, 12), duration_s=3.0)])
    with pytest.raises(ConfigError, match="drives off its end"):
        plan_drives(still_city, [RoutePlan((5, 6), duration_s=60.0)])
    with pytest.raises(ConfigError, match="make no way"):
        plan_drives(still_city, [RoutePlan((5,), duration_s=3.0)])


def test_slopes_are_the_gradient_of_heights_and_a_flat_ground_has_none() -> None:
    x, y, h = np.linspace(-300, 300, 40), np.linspace(200, -500, 40), 1e-4
    east = (HILLS.height(x + h, y) - HILLS.height(x - h, y)) / (2 * h)
    north = (HILLS.height(x, y + h) - HILLS.height(x, y - h)) / (2 * h)
    np.testing.assert_allclose(HILLS.gradient(x, y), (east, north), atol=1e-7)
    assert not np.any(FLAT.height(x, y))
