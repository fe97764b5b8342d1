"""How the city is laid out and built."""

from itertools import pairwise

import numpy as np
import pytest

from wayloom.config.classes import CLASS_ID
from wayloom.errors import ConfigError
from wayloom.simulation.city.blocks import LandUse, land_use
from wayloom.simulation.city.city import City, build_city
from wayloom.simulation.city.city_settings import CitySettings
from wayloom.simulation.city.instance_ids import FIRST_MOVER, THINGS_PER_BLOCK, UNIQUE_BLOCKS
from wayloom.simulation.city.objects import Area
from wayloom.simulation.city.streets import (
    CORNER_RADIUS_M,
    ISLAND_M,
    ROUNDABOUT_M,
    Control,
    StreetGraph,
    inset,
    roundabout_corner,
    rounded_corner,
)
from wayloom.simulation.models.cars import TAIL_LAMP
from wayloom.simulation.models.catalogue import Models
from wayloom.simulation.rendering.renderer import World, view_planes
from wayloom.simulation.vehicle.rigs import camera_on_ground, sized_rig

SIGNS_AND_POLES = {CLASS_ID["pole"], CLASS_ID["traffic sign"], CLASS_ID["traffic light"]}


@pytest.fixture(scope="module")
def models() -> Models:
    return Models()


def test_a_block_is_the_same_whatever_was_built_before_and_another_in_another_city(world: World, models: Models) -> None:
    settings = world.city.settings
    other_way = build_city(settings, models)
    for block in (8, 3, 4):
        np.testing.assert_array_equal(other_way.tile(block).mesh.corners, world.city.tile(block).mesh.corners)
        np.testing.assert_array_equal(other_way.tile(block).mesh.tint, world.city.tile(block).mesh.tint)
    another = build_city(settings.model_copy(update={"seed": settings.seed + 1}), models)
    assert not np.array_equal(another.graph.nodes, other_way.graph.nodes)


def test_every_triangle_lies_in_the_box_of_its_chunk(world: World) -> None:
    for tile in (world.city.tile(4), world.city.tile(0), world.city.tile(4, coarse=True)):
        assert tile.starts[0] == 0
        assert tile.starts[-1] == len(tile.mesh)
        for c in range(len(tile.low)):
            corners = tile.mesh.corners[tile.starts[c] : tile.starts[c + 1]]
            assert np.all(corners >= tile.low[c])
            assert np.all(corners <= tile.high[c])


def test_what_is_not_built_yet_is_held_by_the_box_that_is_asked_first(world: World) -> None:
    for block in range(world.city.graph.block_count):
        low, high = world.city._box(block)
        corners = world.city.tile(block).mesh.corners
        assert np.all(corners >= low - 1e-3)
        assert np.all(corners <= high + 1e-3)


def test_inner_streets_have_blocks_on_both_sides() -> None:
    graph = StreetGraph(CitySettings(seed=0, columns=4, rows=3))
    inner = {(s.a, s.b) for s in graph.inner_streets()}
    assert (5, 6) in inner
    assert (0, 1) not in inner
    assert len(inner) == 3 + 4  # of 3 rows of 3 and 4 columns of 2 streets


def test_streets_join_neighbours_only() -> None:
    graph = StreetGraph(CitySettings(seed=0, columns=4, rows=3))
    assert graph.neighbours(5) == [6, 9, 4, 1]
    assert graph.neighbours(0) == [1, 4]
    with pytest.raises(ConfigError, match="no street from crossing 3 to 4"):
        graph.street(3, 4)


def test_blocks_are_found_by_place() -> None:
    graph = StreetGraph(CitySettings(seed=0, columns=30, rows=20))
    for block in (0, 300, 550):
        middle = graph.nodes[list(graph.loop(block))].mean(axis=0)
        found = graph.blocks_within(middle - 1.0, middle + 1.0)
        assert block in found
        assert len(found) <= 4


def test_an_inset_square_is_smaller_by_its_offsets() -> None:
    square = np.array([[0.0, 0], [10, 0], [10, 10], [0, 10]])
    np.testing.assert_allclose(inset(square, np.array([1.0, 2, 3, 4])), [[4, 1], [8, 1], [8, 7], [4, 7]])


def test_a_rounded_corner_is_an_arc_that_touches_both_edges() -> None:
    arc = rounded_corner(np.array([10.0, 0]), np.zeros(2), np.array([0.0, 10]), CORNER_RADIUS_M)
    np.testing.assert_allclose(arc[[0, -1]], [[5, 0], [0, 5]], atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(arc - 5.0, axis=1), 5.0)


def test_the_kerb_around_a_roundabout_is_a_circle_that_flares_into_the_kerbs_of_its_streets() -> None:
    node, kerb = np.zeros(2), np.array([6.0, 6.0])
    line = roundabout_corner(node, kerb, np.array([6.0, 60.0]), np.array([60.0, 6.0]))
    assert line[0, 0] == pytest.approx(6.0)
    assert line[-1, 1] == pytest.approx(6.0)
    assert np.linalg.norm(line, axis=1).min() == pytest.approx(ROUNDABOUT_M, abs=0.1)


def test_the_default_city_has_roundabouts_signals_avenues_parks_and_a_square(models: Models) -> None:
    settings = CitySettings()
    city = build_city(settings, models)
    graph = city.graph
    controls = [graph.control(node) for node in range(len(graph.nodes))]
    assert controls.count(Control.ROUNDABOUT) == 1
    assert Control.SIGNALS in controls
    kinds = [land_use(settings, block) for block in range(graph.block_count)]
    assert kinds.count(LandUse.SQUARE) == 1
    assert kinds.count(LandUse.PARK) == 2
    assert any(street.is_avenue for street in graph.inner_streets())


def test_an_island_stands_in_the_roundabout(models: Models) -> None:
    city = build_city(CitySettings(), models)
    node = city.graph.nodes[11]
    mesh = city.tile(city.graph.blocks_at(11)[0]).mesh
    low = np.hypot(*(mesh.corners[..., :2].mean(axis=1) - node).T) < ISLAND_M - 1.5
    assert set(mesh.class_id[low].tolist()) >= {CLASS_ID["road"], CLASS_ID["terrain"], CLASS_ID["building"]}
    ground = city.ground.height(node[0], node[1])
    assert mesh.corners[low & (mesh.class_id == CLASS_ID["terrain"])][..., 2].max() > ground + 0.4


def test_streets_climb(models: Models) -> None:
    city = build_city(CitySettings(), models)
    x, y = city.graph.nodes.T
    assert np.hypot(*city.ground.gradient(x, y)).max() > 0.03
    assert np.ptp(city.ground.height(x, y)) > 5.0


def test_cars_at_the_kerb_face_the_way_that_traffic_beside_them_goes(world: World) -> None:
    mesh, shape = world.city.tile(4).mesh, world.city.graph.shape(4)
    cars = mesh.class_id == CLASS_ID["car"]
    facing = []
    for number in np.unique(mesh.instance[cars]):
        mine = cars & (mesh.instance == number)
        middle = mesh.corners[mine][..., :2].reshape(-1, 2).mean(axis=0)
        for k in range(4):
            d, inward, length = shape.edge(k)
            along, across = (middle - shape.middle[k]) @ d, (middle - shape.middle[k]) @ inward
            if 10 < along < length - 10 and 3 < across < shape.half_m[k]:
                red = mine & (np.abs(mesh.tint - TAIL_LAMP).max(axis=1) < 1e-3)
                tail = mesh.corners[red][..., :2].reshape(-1, 2).mean(axis=0)
                facing.append((middle - tail) @ d)
    assert len(facing) >= 3
    assert max(facing) < -1.0  # the kerb is on the left of d, and on a driver's right


def test_things_have_numbers_of_their_own_that_repeat_far_away_only(models: Models) -> None:
    settings = CitySettings(columns=2 * UNIQUE_BLOCKS + 2, rows=UNIQUE_BLOCKS + 3)
    city = build_city(settings, models)
    seen: dict[int, list[np.ndarray]] = {}
    blocks = (0, 1, UNIQUE_BLOCKS, 2 * UNIQUE_BLOCKS, UNIQUE_BLOCKS * (settings.columns - 1))
    for block in blocks:
        mesh = city.tile(block).mesh
        numbers = np.unique(mesh.instance[mesh.instance > 0])
        assert len(numbers) < THINGS_PER_BLOCK
        assert numbers.max() < FIRST_MOVER <= np.iinfo(np.uint16).max
        for number in numbers:
            seen.setdefault(int(number), []).append(mesh.corners[mesh.instance == number].reshape(-1, 3)[0, :2])
    shared = [places for places in seen.values() if len(places) > 1]
    assert shared
    assert min(np.hypot(*(a - b)) for places in shared for a, b in pairwise(places)) > 800.0


def test_memory_is_bounded_and_far_blocks_are_coarse(models: Models, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("wayloom.simulation.city.city.FINE_KEPT", 3)
    city = City(CitySettings(columns=40, rows=40), models)
    for block in range(8):
        city.tile(block)
    assert len(city._kept[False]) == 3
    assert len(city.tile(100, coarse=True).mesh) < 0.5 * len(city.tile(100).mesh)


def test_a_city_of_kilometres_is_built_only_where_it_is_seen(models: Models) -> None:
    city = build_city(CitySettings(columns=120, rows=120), models)
    node = city.graph.nodes[60 * 120 + 60]
    T = camera_on_ground(float(node[0]), float(node[1]), 0.2, 0.0)
    planes, reach = view_planes(sized_rig("quarter").camera, T)
    assert len(city.visible(planes, reach, T[:3, 3])) > 30
    assert len(city._kept[False]) + len(city._kept[True]) < 60
    assert np.ptp(city.graph.nodes, axis=0).min() > 8000


def test_blocks_of_a_hard_city_are_all_alike_but_for_their_place(models: Models) -> None:
    city = build_city(CitySettings(seed=3, columns=6, rows=6, hard=True), models)
    one, other = city.tile(7), city.tile(13)
    shift = city.graph.nodes[city.graph.loop(13)[0]] - city.graph.nodes[city.graph.loop(7)[0]]
    assert len(one.mesh) == len(other.mesh)
    order = [np.lexsort(np.round(t.mesh.corners.mean(axis=1) - (*move, 0.0), 2).T) for t, move in ((one, (0, 0)), (other, shift))]
    moved = other.mesh.corners[order[1]] - np.array([*shift, 0.0], np.float32)
    assert np.quantile(np.abs(moved - one.mesh.corners[order[0]]), 0.95) < 1e-3
    np.testing.assert_array_equal(np.bincount(one.mesh.material), np.bincount(other.mesh.material))


def test_a_changed_city_differs_in_some_signs_poles_cars_and_a_facade_and_says_where(models: Models) -> None:
    settings = CitySettings(seed=3)
    before, after = (build_city(settings.model_copy(update={"changed": changed}), models) for changed in (False, True))
    changes = after.changes()
    assert before.changes() == []
    kinds = {(change.what, change.class_id) for change in changes}
    assert kinds >= {("removed", CLASS_ID["traffic sign"]), ("removed", CLASS_ID["pole"]), ("removed", CLASS_ID["car"])}
    assert kinds >= {("added", CLASS_ID["traffic sign"]), ("added", CLASS_ID["car"]), ("altered", CLASS_ID["building"])}
    places = {(o.class_id, o.instance): o.foot for o in before.objects()}
    later = {(o.class_id, o.instance): o.foot for o in after.objects()}
    told = {(c.class_id, c.instance) for c in changes if c.class_id in SIGNS_AND_POLES}
    gone = {key for key in places if key not in later or not np.array_equal(places[key], later[key])}
    assert gone == told
    assert 0.03 < len(gone) / len(places) < 0.3
    number = next(c.instance for c in changes if c.class_id == CLASS_ID["building"])
    fronts = []
    for city in (before, after):
        mesh = city.whole()
        mine = mesh.instance == number
        fronts.append(mesh.tint[mine].mean(axis=0))
    assert not np.allclose(fronts[0], fronts[1])


def test_true_objects_are_where_their_triangles_are(world: World) -> None:
    city = world.city
    mesh = city.whole()
    objects = city.objects()
    assert {o.class_id for o in objects} == SIGNS_AND_POLES
    for thing in objects[::9]:
        corners = mesh.corners[(mesh.instance == thing.instance) & (mesh.class_id == thing.class_id)].reshape(-1, 3)
        top = thing.foot[2] + thing.height_m
        assert corners[:, 2].max() == pytest.approx(top, abs=0.35)
        assert corners[:, 2].min() == pytest.approx(thing.foot[2] + thing.bottom_m, abs=0.35)
        upright = corners[corners[:, 2] < thing.foot[2] + thing.bottom_m + 0.6]
        assert np.hypot(*(upright[:, :2].mean(axis=0) - thing.foot[:2])) < 0.3


def test_objects_are_those_of_the_area_asked_for(world: World) -> None:
    area = Area((-60.0, -60.0), (10.0, 40.0))
    found = world.city.objects(area)
    assert 5 < len(found) < len(world.city.objects())
    assert all(area.holds(*o.foot[:2]) for o in found)


def test_sizes_are_pyramid_levels_of_kitti_360s_camera_and_others_are_refused() -> None:
    half = sized_rig("half")
    assert (half.camera.width, half.camera.height) == (704, 188)
    assert half.bf == pytest.approx(0.594 * 552.55 / 2)
    with pytest.raises(ConfigError, match="use one of full, half, quarter"):
        sized_rig("huge")
