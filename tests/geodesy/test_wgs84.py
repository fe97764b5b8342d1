import numpy as np
import pyproj
import pytest

from wayloom.errors import InputError
from wayloom.geodesy import wgs84
from wayloom.geodesy.map_frame import MapFrame, map_frame_for
from wayloom.geometry import se3

PLACES = np.array([[8.39, 48.98, 116.0], [-73.9, 40.7, -5.0], [151.2, -33.9, 20.0], [179.999, 0.0, 0.0], [0.0, 78.2, 300.0]])


def test_a_place_survives_the_way_to_its_tangent_plane_and_back():
    for place in PLACES:
        frame = map_frame_for(place[0], place[1])
        enu = wgs84.enu_from_lonlatheight(place[None], frame)
        back = wgs84.lonlatheight_from_enu(enu, frame)[0]
        assert np.abs(back - place)[:2].max() < 1e-11
        assert abs(back[2] - place[2]) < 1e-7


def test_east_north_and_up_point_where_they_say():
    frame = MapFrame(8.39, 48.98, 116.0)
    metre_north = wgs84.lonlatheight_from_enu(np.array([[0.0, 1.0, 0.0]]), frame)[0]
    metre_east = wgs84.lonlatheight_from_enu(np.array([[1.0, 0.0, 0.0]]), frame)[0]
    metre_up = wgs84.lonlatheight_from_enu(np.array([[0.0, 0.0, 1.0]]), frame)[0]
    geod = pyproj.Geod(ellps="WGS84")
    azimuth, _, distance = geod.inv(8.39, 48.98, metre_north[0], metre_north[1])
    assert abs(azimuth) < 1e-6
    assert abs(distance - 116.0 / 6.4e6 - 1.0) < 1e-4
    assert abs(geod.inv(8.39, 48.98, metre_east[0], metre_east[1])[0] - 90.0) < 1e-4
    assert np.allclose(metre_up, [8.39, 48.98, 117.0], atol=1e-8)


def test_a_point_has_one_place_whatever_frame_it_is_seen_from():
    one, other = MapFrame(8.5, 48.5, 0.0), MapFrame(9.5, 49.5, 100.0)
    in_one = wgs84.enu_from_lonlatheight(PLACES[:1], one)
    in_other = wgs84.enu_from_lonlatheight(PLACES[:1], other)
    assert np.allclose(se3.transform(wgs84.T_enu_enu(other, one), in_one), in_other, atol=1e-7)


def test_the_map_frame_depends_on_the_degree_cell_alone():
    assert map_frame_for(8.01, 48.99) == map_frame_for(8.99, 48.01) == MapFrame(8.5, 48.5, 0.0)
    assert map_frame_for(-0.2, -0.2) == MapFrame(-0.5, -0.5, 0.0)
    assert map_frame_for(180.0, 90.0) == MapFrame(179.5, 89.5, 0.0)


@pytest.mark.parametrize("place", [(np.nan, 0.0), (181.0, 0.0), (0.0, -91.0)])
def test_what_is_no_place_has_no_map_frame(place):
    with pytest.raises(InputError, match="no place on Earth"):
        map_frame_for(*place)


def test_utm_zones_and_coordinates_are_the_published_ones():
    assert wgs84.utm_epsg(8.39, 48.98) == 32632
    assert wgs84.utm_epsg(151.2, -33.9) == 32756
    assert wgs84.utm_epsg(-180.0, 10.0) == 32601
    # On a zone's central meridian the easting is 500 km, on the equator the northing is 0.
    assert np.allclose(wgs84.utm_from_lonlatheight(np.array([[9.0, 0.0, 7.0]]), 32632)[0], [500_000.0, 0.0, 7.0], atol=1e-6)
    with pytest.raises(InputError, match="no UTM zone"):
        wgs84.utm_epsg(0.0, 85.0)
