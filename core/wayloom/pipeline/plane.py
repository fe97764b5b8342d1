"""Tangent plane in which people look at a drive: up is up at the drive's own place, the first camera is at (0, 0, 0)."""

import numpy as np
from numpy.typing import NDArray

from wayloom.geodesy.map_frame import MapFrame
from wayloom.geodesy.wgs84 import T_enu_enu, lonlatheight_from_enu
from wayloom.geometry import se3
from wayloom.georeference.types import GeoReference

FloatArray = NDArray[np.float64]


def T_plane_enu(geo: GeoReference) -> FloatArray:
    """(4, 4) from the frame of geo (the map's, which may stand askew far from its origin, or the drive's own) to the drive's plane.

    With GNSS the plane is the tangent plane at the drive's start: east, north, up. Without, the drive's own: right, ahead, up.
    """
    start = geo.T_enu_cam[0]
    if geo.frame is None:
        return se3.from_rotation_translation(np.eye(3), -start[:3, 3])
    place = MapFrame(*lonlatheight_from_enu(start[None, :3, 3], geo.frame)[0].tolist())
    return T_enu_enu(place, geo.frame)


def axis_labels(geo: GeoReference) -> tuple[str, str]:
    """Names of the plane's first two axes."""
    return ("right of the start", "ahead of the start") if geo.frame is None else ("east", "north")
