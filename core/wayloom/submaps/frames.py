"""Common frame of submaps of several degree cells, and their places in it."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from wayloom.geodesy import wgs84
from wayloom.geodesy.map_frame import MapFrame
from wayloom.geometry import se3
from wayloom.submaps.submap import PlacedSubmap, StepBefore

FloatArray = NDArray[np.float64]


def common_frame(frames: Iterable[MapFrame]) -> MapFrame:
    """Of the frames of some submaps, one each, that of the most; of equals the most south-western. At least one is given.

    It depends on the set alone, so no order of drives changes a map.
    """
    counted = Counter((frame.lon_deg, frame.lat_deg, frame.height_m) for frame in frames)
    most = max(counted.values())
    return MapFrame(*min(cell for cell, count in counted.items() if count == most))


def in_frame(item: PlacedSubmap, frame: MapFrame) -> PlacedSubmap:
    """The same submap in another frame: both are rigid, so nothing is lost.

    A left perturbation of T_enu_submap becomes Ad(T_frame_enu) times it.
    """
    if item.frame is None or item.frame == frame:
        return item
    T = wgs84.T_enu_enu(frame, item.frame)
    Ad = se3.adjoint(T)
    before = None if item.before is None else StepBefore(Ad @ item.before.cross @ Ad.T, item.before.connected)
    return replace(item, T_enu_submap=T @ item.T_enu_submap, covariance=Ad @ item.covariance @ Ad.T, frame=frame, before=before)
