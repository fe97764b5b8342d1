"""Rows of submaps as their own drive places them, and how far around the next drive is looked for."""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.geodesy import wgs84
from wayloom.geodesy.antimeridian import box_of
from wayloom.geodesy.map_frame import MapFrame
from wayloom.georeference.uncertainty import position_covariance
from wayloom.store.maps import Box
from wayloom.store.tables.drives import SubmapRow
from wayloom.submaps.submap import PlacedSubmap

FloatArray = NDArray[np.float64]
NEAR_M: Final = 30.0
"""Around a drive's own points, twice which others are looked for: how far apart two drives may be placed that see one street."""
SIGMAS: Final = 3.0
FARTHEST_M: Final = 500.0
METRES_A_DEGREE: Final = 110_000.0
"""Of latitude, at least."""


def submap_row(drive_id: str, map_id: str, position: int, placed: PlacedSubmap) -> SubmapRow:
    """The row of a submap; without a place on Earth it has no frame and no box, and its pose is in the drive's own frame."""
    covariance = np.where(np.isfinite(placed.covariance), placed.covariance, 0.0).tolist()
    T, frame = placed.T_enu_submap.tolist(), placed.frame
    return SubmapRow(
        drive_id=drive_id, map_id=map_id, position=position, digest=placed.submap.digest, point_count=len(placed.submap),
        located=frame is not None, T_enu_submap=T, covariance=covariance, own_T_enu_submap=T, own_covariance=covariance,
        step_before=None if placed.before is None else placed.before.content(),
        length_m=placed.submap.length_m, track_t_ns=int(placed.submap.keyframe_t_ns.min(initial=2**62)),
        **({"frame": None, "track": []} if frame is None else _place(placed, frame)),
    )  # fmt: skip


def _place(placed: PlacedSubmap, frame: MapFrame) -> dict[str, Any]:
    """Frame, track and boxes."""
    track = wgs84.lonlatheight_from_enu(placed.track_enu(), frame)[:, :2]
    points = wgs84.lonlatheight_from_enu(placed.points_enu(), frame)[:, :2]
    box = box_of(np.vstack([track, points]))
    sides = ("min_lon", "min_lat", "max_lon", "max_lat")
    near = {f"near_{side}": value for side, value in zip(sides, near_box(box, placed.T_enu_submap, placed.covariance), strict=True)}
    origin = [frame.lon_deg, frame.lat_deg, frame.height_m]
    return {"frame": origin, "track": track.tolist(), **dict(zip(sides, box, strict=True)), **near}


def near_box(box: Box, T_enu_submap: FloatArray, covariance: FloatArray) -> Box:
    """Degrees around a submap's box, as far as its place is uncertain and more; those of two drives that see one street touch.

    T_enu_submap (4, 4), covariance (6, 6) of its left perturbation
    """
    sigma2 = np.linalg.eigvalsh(position_covariance(T_enu_submap[None], np.nan_to_num(covariance)[None])[0])[-1]
    margin_m = min(NEAR_M + SIGMAS * float(np.sqrt(max(sigma2, 0.0))), FARTHEST_M)
    west, south, east, north = box
    lat = margin_m / METRES_A_DEGREE
    lon = lat / max(float(np.cos(np.radians(max(abs(south), abs(north))))), 1e-3)
    return west - lon, south - lat, east + lon, north + lat
