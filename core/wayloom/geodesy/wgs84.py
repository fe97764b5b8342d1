"""WGS84: geodetic, Earth-centred and tangent-plane coordinates, and UTM. The only import of pyproj.

lon_lat_height  (N, 3) degrees, degrees, ellipsoidal metres
ecef            (N, 3) Earth-centred, Earth-fixed metres (EPSG:4978)
enu             (N, 3) east, north, up metres in the tangent plane of a `MapFrame`

A tangent plane is Cartesian: enu = R (ecef - ecef_origin), exactly, at any distance. So its third axis leaves the vertical by one
degree every 111 km, and a drive far from the origin must take its own vertical from its own tangent plane (`T_enu_enu`).
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS, Transformer, proj_version_str
from pyproj.database import get_database_metadata

from wayloom.errors import InputError
from wayloom.geodesy.map_frame import MapFrame
from wayloom.geometry import se3

FloatArray = NDArray[np.float64]
WGS84_GEODETIC, WGS84_GEOCENTRIC = 4979, 4978
UTM_LATITUDES_DEG = (-80.0, 84.0)


@lru_cache(maxsize=64)
def _transformer(source_epsg: int, target_epsg: int) -> Transformer:
    return Transformer.from_crs(source_epsg, target_epsg, always_xy=True)


def _apply(source_epsg: int, target_epsg: int, points: FloatArray) -> FloatArray:
    points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    return np.column_stack(_transformer(source_epsg, target_epsg).transform(points[:, 0], points[:, 1], points[:, 2]))


def ecef_from_lonlatheight(lon_lat_height: FloatArray) -> FloatArray:
    """lon_lat_height (N, 3) to ecef (N, 3) m."""
    return _apply(WGS84_GEODETIC, WGS84_GEOCENTRIC, lon_lat_height)


def lonlatheight_from_ecef(ecef: FloatArray) -> FloatArray:
    """ecef (N, 3) m to lon_lat_height (N, 3)."""
    return _apply(WGS84_GEOCENTRIC, WGS84_GEODETIC, ecef)


def T_ecef_enu(frame: MapFrame) -> FloatArray:
    """(4, 4): the columns of its rotation are east, north and up at the frame's origin."""
    lon, lat = np.radians(frame.lon_deg), np.radians(frame.lat_deg)
    east = np.array([-np.sin(lon), np.cos(lon), 0.0])
    up = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    origin = ecef_from_lonlatheight(np.array([[frame.lon_deg, frame.lat_deg, frame.height_m]]))[0]
    return se3.from_rotation_translation(np.column_stack([east, np.cross(up, east), up]), origin)


def T_enu_enu(to: MapFrame, source: MapFrame) -> FloatArray:
    """(4, 4) from one tangent plane to another."""
    return se3.inverse(T_ecef_enu(to)) @ T_ecef_enu(source)


def enu_from_lonlatheight(lon_lat_height: FloatArray, frame: MapFrame) -> FloatArray:
    """lon_lat_height (N, 3) to enu (N, 3) m."""
    T = T_ecef_enu(frame)
    # Subtract before rotating: the difference of two large numbers is then taken once, not three times.
    return (ecef_from_lonlatheight(lon_lat_height) - T[:3, 3]) @ T[:3, :3]


def lonlatheight_from_enu(enu: FloatArray, frame: MapFrame) -> FloatArray:
    """enu (N, 3) m to lon_lat_height (N, 3)."""
    return lonlatheight_from_ecef(se3.transform(T_ecef_enu(frame), np.asarray(enu, dtype=np.float64).reshape(-1, 3)))


def utm_epsg(lon_deg: float, lat_deg: float) -> int:
    """EPSG code of the WGS84 UTM zone of a place, by the plain six-degree rule. Raises InputError outside 80° S to 84° N."""
    low, high = UTM_LATITUDES_DEG
    if not low <= lat_deg <= high:
        raise InputError(f"latitude {lat_deg:.4f}° has no UTM zone", remedy=f"UTM covers {low:.0f}° to {high:.0f}°")
    zone = int(np.floor((lon_deg + 180.0) / 6.0)) % 60 + 1
    return (32600 if lat_deg >= 0 else 32700) + zone


def utm_from_lonlatheight(lon_lat_height: FloatArray, epsg: int) -> FloatArray:
    """lon_lat_height (N, 3) to easting, northing, ellipsoidal height (N, 3) m."""
    points = np.asarray(lon_lat_height, dtype=np.float64).reshape(-1, 3)
    easting, northing = _transformer(4326, epsg).transform(points[:, 0], points[:, 1])
    return np.column_stack([easting, northing, points[:, 2]])


def utm_crs(epsg: int) -> CRS:
    """The coordinate system of `utm_from_lonlatheight`, as pyproj knows it (for LAZ headers)."""
    return CRS.from_epsg(epsg)


def wkt(epsg: int) -> str:
    """A coordinate system as well-known text of version 1, as GeoPackage wants it."""
    return str(CRS.from_epsg(epsg).to_wkt("WKT1_GDAL"))


def proj_versions() -> dict[str, str]:
    """The versions of what pyproj stands on: the library PROJ and its database of coordinate systems."""
    return {"PROJ": proj_version_str, "EPSG": str(get_database_metadata("EPSG.VERSION"))}
