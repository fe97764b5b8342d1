"""Reach of a map from its origin; drives that lie beyond it are told before anything is made of them."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import InputError
from wayloom.geodesy import wgs84
from wayloom.logs.types import GnssTrack
from wayloom.pipeline.settings import WayloomSettings
from wayloom.stitching.grid import KEY_LIMITS

FloatArray = NDArray[np.float64]
MARGIN_M: Final = 500.0
"""Of the submaps' own size: they are judged by the place of their origin, and reach 100 m of road and 60 m of sight from it."""


def reach_of(settings: WayloomSettings) -> FloatArray:
    """(3,) m: how far from the origin along east, north and up a submap may begin, so that the grid of voxels holds it."""
    return np.asarray(KEY_LIMITS * settings.merge.voxel_m - MARGIN_M)


def check_reach(gnss: GnssTrack | None, settings: WayloomSettings) -> None:
    """Raise InputError where the map has an origin of its own and every fix of a drive lies out of its reach. A map whose origin is
    that of its drives' cells moves with them: there the stitch alone can tell."""
    frame = settings.map_frame()
    if gnss is None or frame is None or not len(gnss):
        return
    enu = wgs84.enu_from_lonlatheight(gnss.lon_lat_height, frame)
    if (np.abs(enu) < reach_of(settings)).all(axis=1).any():
        return
    away_km = float(np.linalg.norm(enu, axis=1).min()) / 1e3
    limit_km = float(reach_of(settings)[0]) / 1e3
    raise InputError(
        f"the drive is {away_km:.0f} km from the map's origin, and a map reaches {limit_km:.0f} km",
        record="GNSS",
        remedy="check its fixes; for another place run a service with a map of its own (WAYLOOM_MAP_ID, WAYLOOM_MAP_ORIGIN)",
    )
