"""The WGS84 ellipsoid against its closed form and against PROJ's own tangent planes."""

import numpy as np
import pytest
from pyproj import Transformer

from wayloom.geodesy.map_frame import MapFrame
from wayloom.geodesy.wgs84 import T_ecef_enu, ecef_from_lonlatheight, enu_from_lonlatheight

SEMI_MAJOR_M, FLATTENING = 6_378_137.0, 1.0 / 298.257_223_563
ECCENTRICITY2 = FLATTENING * (2.0 - FLATTENING)


def places() -> np.ndarray:
    rng = np.random.default_rng(0)
    return np.vstack([rng.uniform([-180, -89, -400], [180, 89, 9000], (500, 3)), [[0, 0, 0], [180, 0, 0], [8.4, 49.0, 115.0]]])


def closed_form(lon_lat_height: np.ndarray) -> np.ndarray:
    """(N, 3) degrees, degrees, ellipsoidal m to Earth-centred (N, 3) m."""
    lon, lat, h = np.radians(lon_lat_height[:, 0]), np.radians(lon_lat_height[:, 1]), lon_lat_height[:, 2]
    normal = SEMI_MAJOR_M / np.sqrt(1.0 - ECCENTRICITY2 * np.sin(lat) ** 2)
    x = (normal + h) * np.cos(lat)
    return np.column_stack([x * np.cos(lon), x * np.sin(lon), (normal * (1.0 - ECCENTRICITY2) + h) * np.sin(lat)])


def test_earth_centred_coordinates_are_those_of_the_closed_form() -> None:
    np.testing.assert_allclose(ecef_from_lonlatheight(places()), closed_form(places()), rtol=0, atol=1e-8)


@pytest.mark.parametrize("origin", [(8.4, 49.0, 115.0), (-70.0, -33.0, 500.0), (179.9999, 0.0, 0.0)])
def test_the_tangent_plane_is_that_of_pyproj(origin: tuple[float, float, float]) -> None:
    place = "+lon_0={} +lat_0={} +h_0={}".format(*origin)
    steps = ("+proj=unitconvert +xy_in=deg +xy_out=rad", "+proj=cart +ellps=WGS84", f"+proj=topocentric +ellps=WGS84 {place}")
    pipeline = "+proj=pipeline " + " ".join(f"+step {step}" for step in steps)
    near = np.array(origin) + np.random.default_rng(1).uniform([-0.02, -0.02, -50], [0.02, 0.02, 50], (200, 3))
    expected = np.column_stack(Transformer.from_pipeline(pipeline).transform(*near.T))
    np.testing.assert_allclose(enu_from_lonlatheight(near, MapFrame(*origin)), expected, atol=1e-6)


def test_east_north_up_point_where_their_names_say() -> None:
    origin = np.array([8.4, 49.0, 100.0])
    moved = origin + np.array([[1e-4, 0, 0], [0, 1e-4, 0], [0, 0, 5.0]])
    enu = enu_from_lonlatheight(moved, MapFrame(*origin))
    assert enu.argmax(axis=1).tolist() == [0, 1, 2]
    assert enu[2] == pytest.approx([0, 0, 5.0], abs=1e-6)
    R = T_ecef_enu(MapFrame(8.4, 49.0, 0.0))[:3, :3]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
