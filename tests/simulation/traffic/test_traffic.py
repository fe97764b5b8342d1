"""What moves keeps its distance, stops at red lights, and is a function of the time."""

import cv2
import numpy as np
import pytest

from wayloom.config.classes import CLASS_ID
from wayloom.simulation.city.city import City, build_city
from wayloom.simulation.city.city_settings import CitySettings
from wayloom.simulation.city.instance_ids import FIRST_MOVER, vehicle_number
from wayloom.simulation.city.streets import Control
from wayloom.simulation.models.catalogue import Models
from wayloom.simulation.rendering.renderer import World
from wayloom.simulation.traffic import signals
from wayloom.simulation.traffic.drives import Drive, RoutePlan, plan_drives
from wayloom.simulation.traffic.lanes import ALONG, Lane, LaneGraph
from wayloom.simulation.traffic.pedestrians import People, places
from wayloom.simulation.traffic.traffic import Vehicle

WIDTHS = {"bicycle": 0.5, "rider": 0.5, "motorcycle": 0.6, "car": 1.75}
WAYS = (
    RoutePlan((6, 7, 12, 11), 30.0, closed=True),
    RoutePlan((12, 7, 6, 11, 16), 33.0, reference=1, before_m=45.0, duration_s=40.0),
)


@pytest.fixture(scope="module")
def busy_city() -> City:
    return build_city(CitySettings(seed=5, traffic=2.0), Models())


@pytest.fixture(scope="module")
def drives(busy_city: City) -> list[Drive]:
    return plan_drives(busy_city, WAYS)


def outline(vehicle: Vehicle, t_s: float) -> np.ndarray:
    """(4, 2) m of a vehicle's body, without mirrors, a little smaller than it is."""
    x, y, yaw = vehicle.at(t_s)
    names = {i: name for name, i in CLASS_ID.items()}
    width = WIDTHS.get(names[int(vehicle.mesh.class_id[0])], 2.45)
    half, side = 0.5 * vehicle.length_m - 0.08, 0.5 * width - 0.03
    c, s = np.cos(yaw), np.sin(yaw)
    corners = np.array([(half, side), (-half, side), (-half, -side), (half, -side)])
    return corners @ np.array([[c, s], [-s, c]]) + (x, y)


def front(vehicle: Vehicle, t_s: float) -> np.ndarray:
    """(2,) m of the middle of its front bumper."""
    s = vehicle.middle_m(t_s) + 0.5 * vehicle.length_m
    return np.array([np.interp(s, vehicle.s, vehicle.xy[:, k]) for k in (0, 1)])


def overlaps(vehicles: list[Vehicle], t_s: float) -> list[tuple[int, int, float]]:
    """Pairs of vehicles that share more than a few square centimetres of ground."""
    outlines = [outline(v, t_s) for v in vehicles]
    middles = np.array([o.mean(axis=0) for o in outlines])
    out = []
    for i in range(len(outlines)):
        for j in range(i):
            if np.hypot(*(middles[i] - middles[j])) < 20.0:
                a, b = (np.float32(outlines[k] - middles[i]) for k in (i, j))
                shared = cv2.intersectConvexConvex(a, b)[0]
                if shared > 0.03:
                    out.append((vehicles[i].order, vehicles[j].order, shared))
    return out


def test_nobody_drives_through_anybody_and_the_recording_vehicles_are_among_them(drives: list[Drive]) -> None:
    traffic = drives[0].traffic
    assert drives[1].traffic is traffic
    for t in np.arange(30.0, 75.0, 0.5):
        vehicles = list(traffic.vehicles(float(t)))
        assert len(vehicles) > 40
        assert overlaps(vehicles, float(t)) == []
    own = {number for drive in drives for number in drive.left_out}
    assert own <= {vehicle_number(v.order) for v in traffic.vehicles(40.0)}


def test_a_recording_vehicle_is_where_its_route_says(drives: list[Drive]) -> None:
    for drive in drives:
        for t in (35.0, 41.0, 55.5):
            (mine,) = (v for v in drive.traffic.vehicles(t) if vehicle_number(v.order) in drive.left_out)
            assert np.hypot(*(np.array(mine.at(t)[:2]) - drive.route.places([t])[0])) < 1.5


def test_a_vehicle_does_not_see_itself_and_others_do(drives: list[Drive]) -> None:
    drive = drives[0]
    x, y = drive.route.places([40.0])[0]
    numbers = {int(p.mesh.instance[0]) for p in drive.traffic.around(x, y, 40.0)}
    assert drive.left_out <= numbers
    assert not drive.left_out & {int(p.mesh.instance[0]) for p in drive.traffic.around(x, y, 40.0, drive.left_out)}


def test_nobody_enters_a_crossing_on_red(busy_city: City, drives: list[Drive]) -> None:
    graph = busy_city.graph
    lanes = LaneGraph(graph)
    lines = [
        (node, origin, lanes.along(Lane.CAR, origin, node).xy[-1])
        for node in (7, 12, 13)
        for origin in graph.neighbours(node)
        if graph.control(node) is Control.SIGNALS
    ]
    seen = 0
    for t in np.arange(30.0, 75.0, 0.2):
        before, after = ({v.order: v for v in drives[0].traffic.vehicles(float(s))} for s in (t, t + 0.2))
        for order in before.keys() & after.keys():
            vehicle = before[order]
            if int(vehicle.mesh.class_id[0]) != CLASS_ID["car"]:
                continue
            fronts = [front(vehicle, float(s)) for s in (t, t + 0.2)]
            for node, origin, stop in lines:
                d = stop - lanes.along(Lane.CAR, origin, node).xy[0]
                d = d / np.hypot(*d)
                along = [(p - stop) @ d for p in fronts]
                aside = abs((fronts[0] - stop) @ np.array([-d[1], d[0]]))
                if along[0] < 0.0 <= along[1] and aside < 0.5:
                    seen += 1
                    recently = (signals.lit(graph, node, origin, float(s)) for s in np.arange(t - 3.5, t + 0.3, 0.1))
                    assert any({signals.GREEN, signals.AMBER} & set(lamps) for lamps in recently)
    assert seen > 5


def test_signals_let_one_street_go_at_a_time_and_change_with_time(busy_city: City) -> None:
    graph, shown = busy_city.graph, set()
    for t in np.arange(0.0, 60.0, 0.5):
        east, north = signals.lit(graph, 12, 11, float(t)), signals.lit(graph, 12, 7, float(t))
        assert signals.lit(graph, 12, 13, float(t)) == east
        assert not ({signals.GREEN, signals.AMBER} & set(east) and signals.GREEN in north)
        shown |= {east, north}
    assert shown == {(signals.GREEN,), (signals.AMBER,), (signals.RED,), (signals.RED, signals.AMBER)}


def test_lit_lamps_are_drawn_in_their_colour_with_the_lights_number(world: World) -> None:
    face = next(f for f in world.city.faces(0.0, 0.0, 120.0))
    for t in (0.0, 15.0):
        rendered = [p.mesh for p in world.traffic.around(float(face.at[0]), float(face.at[1]), t)]
        lamps = [m for m in rendered if int(m.class_id[0]) == CLASS_ID["traffic light"]]
        mine = lamps[0].rows(np.nonzero(lamps[0].instance == face.number)[0])
        expected = signals.lit(world.city.graph, face.node, face.origin, t)
        assert len(mine) == 6 * len(expected)
        strongest = set(np.argmax(mine.tint, axis=1).tolist())
        assert strongest == {1 if lamp == signals.GREEN else 0 for lamp in expected}


def test_equal_cities_have_equal_traffic_and_the_time_may_go_backwards(busy_city: City, drives: list[Drive]) -> None:
    again = plan_drives(build_city(busy_city.settings, busy_city.models), WAYS)
    for t in (60.0, 31.0):
        ours, theirs = ([v.at(t) for v in d[0].traffic.vehicles(t)] for d in (drives, again))
        np.testing.assert_array_equal(ours, theirs)


def test_more_traffic_is_asked_for_and_none(busy_city: City) -> None:
    counts = []
    for traffic in (0.0, 1.0, 4.0):
        city = build_city(busy_city.settings.model_copy(update={"traffic": traffic}), busy_city.models)
        drive = plan_drives(city, [RoutePlan((6, 7, 12), 30.0, reference=1, before_m=45.0, duration_s=2.0)])[0]
        counts.append(len(drive.traffic.vehicles(31.0)))
    assert counts[0] == 1
    assert counts[1] > 15
    assert counts[2] > 2 * counts[1]


def test_ways_across_a_crossing_join_the_lanes_smoothly(busy_city: City) -> None:
    lanes = LaneGraph(busy_city.graph)
    for lane, a, b in ((Lane.CAR, 6, 7), (Lane.CAR, 12, 11), (Lane.CYCLE, 12, 11), (Lane.TRAM, 8, 13)):
        for c in lanes.exits(lane, a, b):
            before, across, after = lanes.along(lane, a, b), lanes.across(lane, a, b, c), lanes.along(lane, b, c)
            assert before.key[3] == ALONG
            np.testing.assert_allclose(across.xy[0], before.xy[-1], atol=0.02)
            np.testing.assert_allclose(across.xy[-1], after.xy[0], atol=0.02)
            heading = np.unwrap(np.arctan2(*np.diff(across.xy, axis=0).T[::-1]))
            assert np.abs(np.diff(heading)).max() < 0.2


def test_ways_that_cross_are_in_conflict_and_opposite_ones_are_not(busy_city: City) -> None:
    lanes = LaneGraph(busy_city.graph)
    straight, opposite, crossing = (Lane.CAR, 11, 12, 13), (Lane.CAR, 13, 12, 11), (Lane.CAR, 7, 12, 17)
    assert lanes.conflict(straight, opposite) is None
    from_m, to_m = lanes.conflict(straight, crossing) or (0.0, 0.0)
    assert 3.0 < to_m - from_m < 12.0


def test_people_walk_on_the_sidewalk_and_keep_off_each_other(world: World) -> None:
    graph, people = world.city.graph, People(world.city)
    for block in range(graph.block_count):
        walkers, shape = people.of_block(block), graph.shape(block)
        assert walkers
        assert len({w.number for w in walkers}) == len(walkers)
        assert min(w.number for w in walkers) >= FIRST_MOVER
        for t in (40.0, 311.0):
            xy = places(walkers, t)
            behind_kerb = [np.linalg.norm(shape.kerb_line() - p, axis=1).min() > 1.0 for p in xy]
            assert all(behind_kerb)
            gap = np.linalg.norm(xy[:, None] - xy, axis=2) + 10.0 * np.eye(len(xy))
            assert gap.min() > 0.6
