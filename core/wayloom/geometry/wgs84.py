"""WGS84 geodetic coordinates in closed form: to the earth-centred frame (ECEF) and to a local tangent plane (ENU)."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
SEMI_MAJOR_M = 6_378_137.0
FLATTENING = 1.0 / 298.257_223_563
ECCENTRICITY2 = FLATTENING * (2.0 - FLATTENING)


def ecef_from_lonlatheight(lon_lat_height: Array) -> Array:
    """(N, 3) degrees, degrees, ellipsoidal m to earth-centred earth-fixed (N, 3) m."""
    lon, lat, h = np.radians(lon_lat_height[:, 0]), np.radians(lon_lat_height[:, 1]), lon_lat_height[:, 2]
    normal = SEMI_MAJOR_M / np.sqrt(1.0 - ECCENTRICITY2 * np.sin(lat) ** 2)
    x = (normal + h) * np.cos(lat)
    return np.column_stack([x * np.cos(lon), x * np.sin(lon), (normal * (1.0 - ECCENTRICITY2) + h) * np.sin(lat)])


def R_enu_ecef(lon_deg: float, lat_deg: float) -> Array:
    """(3, 3) rotation of the earth's frame into east, north, up at a place."""
    lon, lat = np.radians(lon_deg), np.radians(lat_deg)
    sl, cl, sp, cp = np.sin(lon), np.cos(lon), np.sin(lat), np.cos(lat)
    return np.array([[-sl, cl, 0.0], [-sp * cl, -sp * sl, cp], [cp * cl, cp * sl, sp]])


def enu_from_lonlatheight(lon_lat_height: Array, origin: Array) -> Array:
    """(N, 3) degrees, degrees, m to (N, 3) m east, north, up of the tangent plane at origin (3,), degrees, degrees, m."""
    centre = ecef_from_lonlatheight(origin[None])
    return (ecef_from_lonlatheight(lon_lat_height) - centre) @ R_enu_ecef(float(origin[0]), float(origin[1])).T
