"""GeoJSON of one drive's track."""

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wayloom.files.atomic import write_atomically
from wayloom.geodesy import wgs84
from wayloom.geodesy.antimeridian import line_geometry
from wayloom.geodesy.map_frame import MapFrame


def export_geojson_track(path: Path, T_enu_cam: NDArray[np.float64], frame: MapFrame, name: str = "") -> None:
    """The camera's track (N, 4, 4) as a WGS84 line with ellipsoidal heights, longitude first (RFC 7946)."""
    lon_lat_height = wgs84.lonlatheight_from_enu(T_enu_cam[:, :3, 3], frame)
    line = [[round(lon, 9), round(lat, 9), round(height, 3)] for lon, lat, height in lon_lat_height.tolist()]
    feature = {"type": "Feature", "properties": {"name": name}, "geometry": line_geometry(line)}
    write_atomically(path, json.dumps({"type": "FeatureCollection", "features": [feature]}).encode())
