"""A drive is placed to a millimetre wherever it and its map's anchor are."""

import numpy as np
import pytest

from geodesy.closed_form import FAR, ecef_of_enu, lonlatheight_of
from georeference.made_gnss_drives import LEVER, MadeLog, odometry_of, path
from wayloom.geodesy.map_frame import MapFrame
from wayloom.geometry import se3
from wayloom.georeference.alignment import georeference
from wayloom.georeference.types import Wanted
from wayloom.logs.types import FixType, GnssTrack


@pytest.mark.parametrize("name", FAR)
def test_a_perfect_drive_far_from_the_anchor_is_placed_to_a_millimetre(name: str) -> None:
    anchor, place = FAR[name]
    T = path(160, hills=0.0)
    T[:, :3, 3] -= T[80, :3, 3]  # so the drive lies on both sides of its place
    antenna = T[:, :3, :3] @ LEVER + T[:, :3, 3]
    t_ns = np.arange(160, dtype=np.int64) * 100_000_000
    covariance = np.tile(np.eye(3) * 0.01**2, (160, 1, 1))
    fixes = lonlatheight_of(ecef_of_enu(antenna, *place))
    gnss = GnssTrack(t_ns, fixes, covariance, np.full(160, FixType.FIXED, np.uint8))
    geo = georeference(MadeLog(gnss, LEVER), odometry_of(t_ns, se3.inverse(T[0]) @ T), Wanted(MapFrame(*anchor)))  # type: ignore[arg-type]
    error = ecef_of_enu(geo.T_enu_cam[:, :3, 3], *anchor) - ecef_of_enu(T[:, :3, 3], *place)
    assert float(np.abs(error).max()) < 1e-3
    assert geo.fixes.used.all()
    assert len(geo.fixes) == len(gnss)
