import numpy as np
import pytest

from wayloom.simulation.city.city import City, build_city
from wayloom.simulation.city.city_settings import CitySettings
from wayloom.simulation.city.ground import KERB_M
from wayloom.simulation.city.markings import TrueMarking
from wayloom.simulation.models.catalogue import Models
from wayloom.simulation.textures.canvas import Canvas
from wayloom.simulation.textures.materials import Material
from wayloom.simulation.textures.paint_ground import PAINTERS, STREET_TILE_M


@pytest.fixture(scope="module")
def city() -> City:
    return build_city(CitySettings(seed=3), Models())


def area_of(ring: np.ndarray) -> float:
    x, y = ring[:-1, 0], ring[:-1, 1]
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2


def length_of(marking: TrueMarking) -> float:
    return float(np.hypot(*(marking.line[-1] - marking.line[0])[:2]))


def test_outlines_turn_left_and_hold_width_times_length(city: City) -> None:
    for marking in city.markings():
        assert np.array_equal(marking.ring[0], marking.ring[-1])
        if marking.kind != "zebra":
            assert area_of(marking.ring) == pytest.approx(marking.width_m * marking.length_m, rel=1e-6)
        assert area_of(marking.ring) > 0


def test_lines_lie_on_the_terrain(city: City) -> None:
    for marking in city.markings():
        np.testing.assert_allclose(marking.line[:, 2], city.ground.height(*marking.line[:, :2].T), atol=1e-9)


def test_every_street_has_a_crossing_at_both_ends_and_only_avenues_have_solid_lines(city: City) -> None:
    found = city.markings()
    streets = {(min(a, n), max(a, n)) for a in range(len(city.graph.nodes)) for n in city.graph.neighbours(a)}
    assert sum(one.kind == "zebra" for one in found) == 2 * len(streets)
    avenues = [pair for pair in streets if city.graph.street(*pair).is_avenue]
    sides = sum(1 if city.graph.is_outer(*pair) else 2 for pair in avenues)
    assert sum(one.kind == "solid" for one in found) == sides


def test_halves_of_the_middle_line_that_touch_are_one_dash(city: City) -> None:
    middle = [one for one in city.markings() if one.kind == "dash" and one.length_m > 1.01]
    assert all(0.065 - 1e-9 <= one.width_m <= 0.13 + 1e-9 for one in middle)
    assert max(one.length_m for one in middle) > 3.01  # halves that overlap in part
    for one in middle:
        assert length_of(one) == pytest.approx(one.length_m, abs=0.01)


def test_the_texture_is_white_where_a_parking_line_is_said_to_be() -> None:
    painted = PAINTERS[Material.STREET](Canvas(np.random.default_rng(0), 512))[..., 1]
    texel = STREET_TILE_M / 512
    across = int((3.75 + STREET_TILE_M / 2) / texel)
    along = (np.arange(512) + 0.5) * texel
    on, off = painted[along % 2.0 < 0.95, across], painted[(along % 2.0 > 1.05) & (along % 2.0 < 1.95), across]
    assert np.median(on) > 2.5 * np.median(off)


def test_kerbs_run_around_every_block_and_are_as_high_as_built(city: City) -> None:
    kerbs = city.kerbs()
    assert len(kerbs) >= city.graph.block_count
    for kerb in kerbs:
        assert kerb.height_m == KERB_M
        assert np.linalg.norm(np.diff(kerb.line, axis=0), axis=1).max() < 2.6
        np.testing.assert_allclose(kerb.line[:, 2], city.ground.height(*kerb.line[:, :2].T), atol=1e-9)
