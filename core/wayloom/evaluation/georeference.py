"""Geo-referencing error: distance of a mapped track from a reference track, in the local vertical."""

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import InputError
from wayloom.geodesy.map_frame import MapFrame
from wayloom.geodesy.wgs84 import enu_from_lonlatheight, lonlatheight_from_enu

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Spread:
    """Median, 95th percentile and maximum of distances, m."""

    median_m: float
    p95_m: float
    max_m: float


@dataclass(frozen=True, slots=True)
class TrackDistance:
    """Distances of corresponding positions of two tracks, m, over `positions` of them."""

    positions: int
    horizontal: Spread
    vertical: Spread

    def as_json(self) -> dict[str, object]:
        """Nested dict of numbers."""
        return asdict(self)


def spread(distances: FloatArray) -> Spread:
    """Median, 95th percentile and maximum of distances (N,) m, N >= 1."""
    return Spread(float(np.median(distances)), float(np.percentile(distances, 95)), float(distances.max()))


def antenna_enu(T_enu_cam: FloatArray, p_cam_gnss: FloatArray) -> FloatArray:
    """(N, 3) m: position of the antenna p_cam_gnss (3,) m of a camera at T_enu_cam (N, 4, 4)."""
    positions: FloatArray = T_enu_cam[:, :3, :3] @ p_cam_gnss + T_enu_cam[:, :3, 3]
    return positions


def track_distance(lon_lat_height: FloatArray, reference: FloatArray) -> TrackDistance:
    """Distance of lon_lat_height (N, 3) to reference (N, 3), position by position; both WGS84 degrees, degrees, metres.

    Rows in which either is NaN are left out. Raises InputError where none is left or the lengths differ.
    Horizontal and vertical are those of the tangent plane at the reference's first position: a map's own plane may
    stand half a degree askew there.
    """
    if len(lon_lat_height) != len(reference):
        raise InputError(
            f"{len(lon_lat_height)} positions cannot be compared with {len(reference)}", remedy="give them at the same times"
        )
    known = np.isfinite(lon_lat_height).all(axis=1) & np.isfinite(reference).all(axis=1)
    if not known.any():
        raise InputError("no position is known in both tracks", remedy="give tracks that overlap in time")
    place = MapFrame(*reference[known][0])
    difference = enu_from_lonlatheight(lon_lat_height[known], place) - enu_from_lonlatheight(reference[known], place)
    return TrackDistance(int(known.sum()), spread(np.hypot(difference[:, 0], difference[:, 1])), spread(np.abs(difference[:, 2])))


def distance_to_ins(
    T_enu_cam: FloatArray,
    frame: MapFrame,
    p_cam_gnss: FloatArray,
    t_ns: NDArray[np.int64],
    ins_t_ns: NDArray[np.int64],
    ins: FloatArray,
) -> TrackDistance:
    """Distance of the mapped antenna to an INS track, at the times of the frames.

    T_enu_cam : (N, 4, 4) the map's poses of frames at t_ns (N,)
    ins : (M, 3) WGS84 degrees, degrees, m at ins_t_ns (M,), taken linearly between its samples; frames outside are left out
    """
    mapped = lonlatheight_from_enu(antenna_enu(T_enu_cam, p_cam_gnss), frame)
    reference = np.column_stack([np.interp(t_ns, ins_t_ns, column, left=np.nan, right=np.nan) for column in ins.T])
    return track_distance(mapped, reference)
