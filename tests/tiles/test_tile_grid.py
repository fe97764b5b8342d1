import numpy as np
import pyproj
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wayloom.errors import InputError
from wayloom.tiles import grid
from wayloom.tiles.grid import TileAddress

PLACES = st.tuples(st.floats(-180.0, 179.999), st.floats(-85.0, 85.0))


def tile_of(lon: float, lat: float, zoom: int) -> TileAddress:
    column, row = (grid.pixel_from_lonlat(np.array([[lon, lat]]), zoom)[0] // grid.TILE_PX).tolist()
    return grid.check_tile(zoom, column, row)


@pytest.mark.parametrize(
    ("lon", "lat", "zoom", "x", "y"),
    [
        (0.0, 0.0, 0, 0, 0),
        (0.0, 0.0, 1, 1, 1),
        (13.3777, 52.5163, 16, 35203, 21493),  # Brandenburger Tor, as OpenStreetMap numbers it
        (-0.1246, 51.5007, 17, 65490, 43588),  # Big Ben
        (151.2153, -33.8568, 15, 30147, 19662),  # Sydney Opera House
        (-180.0, 85.0511, 10, 0, 0),
    ],
)
def test_known_places_lie_on_their_known_tiles(lon, lat, zoom, x, y):
    assert tile_of(lon, lat, zoom) == TileAddress(zoom, x, y)


def test_the_unit_square_is_epsg_3857():
    lon_lat = np.random.default_rng(0).uniform([-180, -85], [180, 85], (200, 2))
    x, y = pyproj.Transformer.from_crs(4326, 3857, always_xy=True).transform(*lon_lat.T)
    expected = np.column_stack([x, -y]) / grid.EQUATOR_M + 0.5
    assert np.abs(grid.unit_from_lonlat(lon_lat) - expected).max() < 1e-12


@given(PLACES)
@settings(max_examples=100, deadline=None)
def test_a_place_lies_within_the_bounds_of_its_tile_and_of_its_tiles_parents(place):
    tile = tile_of(*place, 20)
    while tile.z:
        west, south, east, north = grid.tile_bounds(tile)
        assert west - 1e-9 <= place[0] <= east + 1e-9
        assert south - 1e-9 <= place[1] <= north + 1e-9
        tile = TileAddress(tile.z - 1, tile.x >> 1, tile.y >> 1)
        assert tile_of(*place, tile.z) == tile


def test_the_way_to_the_unit_square_and_back_is_exact():
    lon_lat = np.random.default_rng(1).uniform([-180, -85], [180, 85], (200, 2))
    assert np.abs(grid.lonlat_from_unit(grid.unit_from_lonlat(lon_lat)) - lon_lat).max() < 1e-11


@pytest.mark.parametrize("place", [(0.0, 85.06), (0.0, -90.0), (181.0, 0.0), (np.nan, 0.0), (0.0, np.nan)])
def test_the_poles_and_what_is_no_place_are_refused_with_their_numbers(place):
    with pytest.raises(InputError, match=r"lies on no tile; tiles show latitudes to 85\.0511"):
        grid.pixel_from_lonlat(np.array([[8.0, 49.0], place]), 5)


def test_the_antimeridian_is_one_place():
    assert tile_of(180.0, 0.0, 8) == tile_of(-180.0, 0.0, 8) == TileAddress(8, 0, 128)


@pytest.mark.parametrize("address", [(-1, 0, 0), (22, 0, 0), (3, 8, 0), (3, 0, -1)])
def test_tiles_that_do_not_exist_are_refused(address):
    with pytest.raises(InputError, match="does not exist"):
        grid.check_tile(*address)


def test_a_pixel_has_its_known_width_on_the_ground():
    assert grid.metres_per_pixel(0, 0.0) == pytest.approx(156_543.034, abs=1e-3)
    assert grid.metres_per_pixel(18, 60.0) == pytest.approx(0.5972 / 2, abs=1e-4)
