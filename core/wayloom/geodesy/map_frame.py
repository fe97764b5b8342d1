"""Map frame of a place: fixed by the place alone, so that every drive of a city gets the same, whichever came first."""

import math
from dataclasses import dataclass

from wayloom.errors import InputError


@dataclass(frozen=True, slots=True)
class MapFrame:
    """The local tangent plane of a map: east, north, up in metres at a fixed origin. Set for each map, never by its first drive.

    lon_deg, lat_deg  WGS84 degrees; height_m ellipsoidal
    """

    lon_deg: float
    lat_deg: float
    height_m: float


def map_frame_for(lon_deg: float, lat_deg: float) -> MapFrame:
    """The map frame of a place: the centre of its whole-degree cell, height 0. Raises InputError for what is no place."""
    if not (math.isfinite(lon_deg) and math.isfinite(lat_deg) and -180.0 <= lon_deg <= 180.0 and -90.0 <= lat_deg <= 90.0):
        raise InputError(f"longitude {lon_deg}, latitude {lat_deg} is no place on Earth", remedy="give degrees, longitude first")
    west, south = min(math.floor(lon_deg), 179), min(math.floor(lat_deg), 89)
    return MapFrame(west + 0.5, south + 0.5, 0.0)
