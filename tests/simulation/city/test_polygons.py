"""Outlines of roads and sidewalks agree with what is drawn."""

import numpy as np
import pytest

from simulation.polygon import distance, inside
from wayloom.config.classes import CLASS_ID
from wayloom.simulation.city.city import City, build_city
from wayloom.simulation.city.city_settings import CitySettings
from wayloom.simulation.city.objects import Area, TrueArea
from wayloom.simulation.models.catalogue import Models
from wayloom.simulation.rendering.renderer import World
from wayloom.simulation.vehicle.rigs import sized_rig

GROUND = [CLASS_ID["road"], CLASS_ID["sidewalk"], CLASS_ID["terrain"]]
CAMERA = sized_rig("quarter").camera
SEEN_TO_M = 25.0


@pytest.fixture(scope="module")
def default_city() -> City:
    return build_city(CitySettings(), Models())


def class_at(areas: list[TrueArea], xy: np.ndarray) -> np.ndarray:
    """(N,) class of the area in which each point (N, 2) lies, 255 for none."""
    out = np.full(len(xy), 255)
    for area in areas:
        mine = inside(area.ring, xy)
        for hole in area.holes:
            mine &= ~inside(hole, xy)
        out[mine] = area.class_id
    return out


def test_rings_are_closed_and_turn_left_and_holes_right(default_city: City) -> None:
    for area in default_city.areas():
        for ring, way in ((area.ring, 1.0), *((hole, -1.0) for hole in area.holes)):
            np.testing.assert_array_equal(ring[0], ring[-1])
            x, y = ring[:, 0], ring[:, 1]
            assert way * float(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1])) > 0


def test_areas_cover_the_city_once(default_city: City) -> None:
    rng = np.random.default_rng(1)
    xy = rng.uniform((-90, -90), (80, 90), (600, 2))
    areas = default_city.areas()
    count = np.zeros(len(xy), int)
    for area in areas:
        count += inside(area.ring, xy) & ~np.any([inside(hole, xy) for hole in area.holes] or [np.zeros(len(xy), bool)], axis=0)
    near_an_edge = np.min([distance(ring, xy) for area in areas for ring in (area.ring, *area.holes)], axis=0) < 0.02
    assert np.all((count == 1) | near_an_edge)


def test_the_ground_of_each_pixel_lies_in_an_area_of_its_class(world: World, poses: list[np.ndarray]) -> None:
    areas = world.city.areas()
    tested = dict.fromkeys(GROUND, 0)
    for T in poses:
        truth = world.scene(CAMERA, T, 2.0).truth(CAMERA, T)
        v, u = np.nonzero(np.isin(truth.class_id, GROUND) & (truth.instance == 0) & (truth.depth < SEEN_TO_M))
        z = truth.depth[v, u].astype(float)
        p = np.column_stack([(u - CAMERA.cx) / CAMERA.fx * z, (v - CAMERA.cy) / CAMERA.fy * z, z])
        xy = (p @ T[:3, :3].T + T[:3, 3])[:, :2]
        seen, said = truth.class_id[v, u], class_at(areas, xy)
        edge = np.min([distance(ring, xy) for area in areas for ring in (area.ring, *area.holes)], axis=0)
        clear = edge > 0.06  # kerbs are upright and seen in the class of the sidewalk
        np.testing.assert_array_equal(seen[clear], said[clear])
        for c in GROUND:
            tested[c] += int(np.sum(clear & (seen == c)))
    assert min(tested.values()) > 100
    assert tested[CLASS_ID["road"]] > 5000


def test_a_roundabouts_island_is_cut_out_of_its_road(default_city: City) -> None:
    node = default_city.graph.nodes[11]
    angle = np.linspace(0, 2 * np.pi, 7)
    ways = np.column_stack([np.cos(angle), np.sin(angle)])
    areas = default_city.areas(Area(tuple(node - 20), tuple(node + 20)))
    for radius, name in ((4.0, "terrain"), (7.5, "sidewalk"), (11.0, "road")):
        assert set(class_at(areas, node + radius * ways).tolist()) == {CLASS_ID[name]}


def test_areas_are_those_that_touch_the_area_asked_for(default_city: City) -> None:
    few = default_city.areas(Area((0.0, 0.0), (10.0, 10.0)))
    assert 3 < len(few) < 0.5 * len(default_city.areas())


def test_rings_lie_on_the_ground(default_city: City) -> None:
    for area in default_city.areas(Area((0.0, 0.0), (60.0, 60.0))):
        above = area.ring[:, 2] - default_city.ground.height(area.ring[:, 0], area.ring[:, 1])
        assert np.all((above > -1e-9) & (above < 0.6))
