"""How the city is laid out, and how things move in it."""

import numpy as np
import pytest

from wayloom.config.classes import CLASS_ID
from wayloom.errors import ConfigError
from wayloom.simulation import terrain
from wayloom.simulation.city import build_city
from wayloom.simulation.models import Models
from wayloom.simulation.paths import LANE_M, lane_path
from wayloom.simulation.renderer import World
from wayloom.simulation.rigs import CAMERA_HEIGHT_M, sized_rig
from wayloom.simulation.routes import drive, speed_along
from wayloom.simulation.streets import CORNER_RADIUS_M, block_shape, grid_graph, inset, rounded_corner
from wayloom.simulation.traffic import FIRST_MOVER, Mover


def test_a_city_is_the_same_from_the_same_seed_and_another_from_another(world: World) -> None:
    again = build_city(11, 4, 4, Models())
    np.testing.assert_array_equal(again.mesh.corners, world.city.mesh.corners)
    np.testing.assert_array_equal(again.mesh.tint, world.city.mesh.tint)
    assert not np.array_equal(build_city(12, 4, 4, Models()).graph.nodes, again.graph.nodes)


def test_every_triangle_lies_in_the_box_of_its_chunk(world: World) -> None:
    city = world.city
    assert city.starts[0] == 0
    assert city.starts[-1] == len(city.mesh)
    for c in range(len(city.low)):
        corners = city.mesh.corners[city.starts[c] : city.starts[c + 1]]
        assert np.all(corners >= city.low[c])
        assert np.all(corners <= city.high[c])


def test_inner_streets_have_blocks_on_both_sides() -> None:
    graph = grid_graph(np.random.default_rng(0), 4, 3)
    inner = {(s.a, s.b) for s in graph.inner_streets()}
    assert (5, 6) in inner
    assert (0, 1) not in inner
    assert len(inner) == 3 + 4  # of 3 rows of 3 and 4 columns of 2 streets


def test_an_inset_square_is_smaller_by_its_offsets() -> None:
    square = np.array([[0.0, 0], [10, 0], [10, 10], [0, 10]])
    np.testing.assert_allclose(inset(square, np.array([1.0, 2, 3, 4])), [[4, 1], [8, 1], [8, 7], [4, 7]])


def test_a_rounded_corner_is_an_arc_that_touches_both_edges() -> None:
    arc = rounded_corner(np.array([10.0, 0]), np.zeros(2), np.array([0.0, 10]), CORNER_RADIUS_M)
    np.testing.assert_allclose(arc[[0, -1]], [[5, 0], [0, 5]], atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(arc - 5.0, axis=1), 5.0)


def test_cars_at_the_kerb_face_the_way_that_traffic_beside_them_goes(world: World) -> None:
    mesh, graph = world.city.mesh, world.city.graph
    shape = block_shape(graph, graph.blocks[4])
    d, inward, length = shape.edge(0)
    cars = mesh.class_id == CLASS_ID["car"]
    facing = []
    for number in np.unique(mesh.instance[cars]):
        mine = cars & (mesh.instance == number)
        middle = mesh.corners[mine][..., :2].reshape(-1, 2).mean(axis=0)
        along, across = (middle - shape.middle[0]) @ d, (middle - shape.middle[0]) @ inward
        if 10 < along < length - 10 and 3 < across < shape.half_m[0]:
            red = mine & (np.abs(mesh.tint - (0.5, 0.03, 0.02)).max(axis=1) < 1e-3)  # tail lamps
            tail = mesh.corners[red][..., :2].reshape(-1, 2).mean(axis=0)
            facing.append((middle - tail) @ d)
    assert len(facing) >= 1
    assert max(facing) < -1.0  # the kerb is on the left of d, and on a driver's right


def test_a_lane_keeps_its_distance_to_the_right_of_the_streets() -> None:
    path = lane_path(np.array([[0.0, 0], [100, 0], [100, 80]]), LANE_M)
    assert path.at(20.0)[1] == pytest.approx(-LANE_M, abs=1e-6)
    assert path.at(path.length_m - 20)[0] == pytest.approx(100 + LANE_M, abs=1e-6)
    assert path.yaw[-1] - path.yaw[0] == pytest.approx(np.pi / 2, abs=1e-3)
    assert np.abs(np.diff(path.yaw)).max() < 0.03  # no kinks


def test_a_closed_path_ends_where_it_begins() -> None:
    path = lane_path(np.array([[0.0, 0], [30, 0], [30, 20], [0, 20]]), 0.0, 2.0, closed=True)
    np.testing.assert_allclose(path.xy[0], path.xy[-1])
    assert 90 < path.length_m < 100


def test_a_driver_slows_down_before_a_corner_and_never_drives_sideways_harder_than_allowed() -> None:
    path = lane_path(np.array([[0.0, 0], [100, 0], [100, 80]]), LANE_M)
    speed = speed_along(path, 12.0)
    assert speed.min() < 8.0
    assert speed[: len(speed) // 5] == pytest.approx(12.0)
    route = drive(path, 20.0, 5.0, 60, 10.0, 12.0)
    velocity = np.diff(route.T_enu_cam[:, :3, 3], axis=0) * 10
    assert np.abs(np.diff(velocity, axis=0) * 10).max() < 6.0
    assert route.t_s[0] == 5.0


def test_a_camera_stands_above_the_ground_and_looks_along_it() -> None:
    path = lane_path(np.array([[0.0, 0], [100, 30]]), LANE_M)
    for T in drive(path, 10.0, 0.0, 20, 10.0, 12.0).T_enu_cam:
        ground = float(terrain.height(T[0, 3], T[1, 3]))
        assert T[2, 3] - ground == pytest.approx(CAMERA_HEIGHT_M, abs=0.03)
        np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
        assert T[2, 1] < -0.99  # its y axis points down


def test_movers_of_one_lane_never_run_into_each_other(world: World) -> None:
    lanes: dict[int, list[Mover]] = {}
    for mover in world.traffic.movers:
        lanes.setdefault(id(mover.path), []).append(mover)
    for movers in lanes.values():
        assert len({m.speed_m_s for m in movers}) == 1
        for t in (0.0, 17.0, 301.0):
            s = np.sort([(m.start_m + m.speed_m_s * t) % m.path.length_m for m in movers])
            assert len(s) < 2 or np.diff(s).min() > 5.0


def test_the_places_of_all_movers_are_those_of_each_and_near_ones_are_met(world: World) -> None:
    places = world.traffic.places(33.0)
    np.testing.assert_allclose(places, [m.at(33.0)[:2] for m in world.traffic.movers], atol=1e-9)
    x, y = places[7] + (2.0, 0.0)
    met = world.traffic.meeting(np.array([x]), np.array([y]), np.array([33.0]), 2.0)
    assert 7 in met
    assert 7 not in {int(p.mesh.instance[0]) - FIRST_MOVER for p in world.traffic.around(x, y, 33.0, met)}


def test_people_walk_on_the_sidewalk(world: World) -> None:
    graph = world.city.graph
    shapes = [block_shape(graph, loop) for loop in graph.blocks]
    for mover in world.traffic.movers:
        if mover.reach_m > 0.5:
            continue
        x, y, _ = mover.at(40.0)
        inside = [all((np.array([x, y]) - s.kerb[k]) @ s.edge(k)[1] > 0.5 for k in range(len(s.nodes))) for s in shapes]
        assert sum(inside) == 1


def test_sizes_are_pyramid_levels_of_kitti_360s_camera_and_others_are_refused() -> None:
    half = sized_rig("half")
    assert (half.camera.width, half.camera.height) == (704, 188)
    assert half.bf == pytest.approx(0.594 * 552.55 / 2)
    with pytest.raises(ConfigError, match="use one of full, half, quarter"):
        sized_rig("huge")
