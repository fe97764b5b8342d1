"""WGS84 by closed formulas in extended precision, with nothing of wayloom or PROJ in it, and places far from a map's anchor."""

import numpy as np

A, F = np.longdouble(6_378_137.0), 1 / np.longdouble("298.257223563")
E2 = F * (2 - F)


def ecef_of(lon_lat_height: np.ndarray) -> np.ndarray:
    """(N, 3) degrees, degrees, ellipsoidal m to Earth-centred (N, 3) m."""
    points = np.asarray(lon_lat_height, np.longdouble).reshape(-1, 3)
    lon, lat, h = np.deg2rad(points[:, 0]), np.deg2rad(points[:, 1]), points[:, 2]
    normal = A / np.sqrt(1 - E2 * np.sin(lat) ** 2)
    flat = (normal + h) * np.cos(lat)
    return np.column_stack([flat * np.cos(lon), flat * np.sin(lon), (normal * (1 - E2) + h) * np.sin(lat)])


def lonlatheight_of(ecef: np.ndarray) -> np.ndarray:
    """The inverse, by fixed-point iteration to convergence (Hofmann-Wellenhof, GNSS, 2008, eq. 8.10)."""
    x, y, z = np.asarray(ecef, np.longdouble).reshape(-1, 3).T
    p = np.hypot(x, y)
    lat = np.arctan2(z, p * (1 - E2))
    for _ in range(30):
        normal = A / np.sqrt(1 - E2 * np.sin(lat) ** 2)
        lat = np.arctan2(z + E2 * normal * np.sin(lat), p)
    normal = A / np.sqrt(1 - E2 * np.sin(lat) ** 2)
    height = p * np.cos(lat) + z * np.sin(lat) - A * np.sqrt(1 - E2 * np.sin(lat) ** 2)
    return np.column_stack([np.rad2deg(np.arctan2(y, x)), np.rad2deg(lat), height]).astype(np.float64)


def ecef_of_enu(enu: np.ndarray, lon_deg: float, lat_deg: float, height_m: float) -> np.ndarray:
    """Tangent-plane (N, 3) m at a place to Earth-centred (N, 3) m."""
    lon, lat = np.deg2rad(np.longdouble(lon_deg)), np.deg2rad(np.longdouble(lat_deg))
    east = np.array([-np.sin(lon), np.cos(lon), 0])
    north = np.array([-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)])
    up = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    points = np.asarray(enu, np.longdouble).reshape(-1, 3)
    origin = ecef_of(np.array([[lon_deg, lat_deg, height_m]]))
    return np.asarray(origin + points[:, :1] * east + points[:, 1:2] * north + points[:, 2:] * up)


FAR = {
    "200 km east of the anchor": ((8.5, 49.5, 0.0), (11.25, 49.3, 412.0)),
    "across a border of UTM zones": ((9.5, 47.5, 115.0), (12.0, 47.9, 640.0)),
    "60 degrees north": ((24.5, 60.5, 0.0), (28.05, 60.1, 21.0)),
    "60 degrees south": ((-64.0, -60.5, 0.0), (-60.5, -59.9, 35.0)),
    "on the antimeridian": ((178.5, -17.5, 0.0), (180.0, -16.4, 60.0)),
}
"""Anchor of the map, and the middle of a drive: longitude, latitude, ellipsoidal height."""
