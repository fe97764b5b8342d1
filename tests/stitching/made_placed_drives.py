"""Made drives through made streets with submaps, and a place in the map or none, for the registration between drives."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from loops.made_drives import made_places
from registration.made_streets import Street
from wayloom.geodesy.map_frame import MapFrame
from wayloom.geometry import se3
from wayloom.places.extraction import make_stations
from wayloom.places.settings import PlaceSettings
from wayloom.stitching.placed_drive import PlacedDrive
from wayloom.stitching.types import Meeting
from wayloom.submaps.submap import PlacedSubmap, Submap

FloatArray = NDArray[np.float64]
FRAME = MapFrame(3.52, 55.49, 45.0)
KEYFRAMES = 30
"""Of a submap."""
RTK = np.diag([0.02**2] * 2 + [0.03**2] + [np.deg2rad(0.1) ** 2] * 3)
GNSS = np.diag([1.0**2] * 2 + [1.5**2] + [np.deg2rad(0.5) ** 2] * 2 + [np.deg2rad(0.5) ** 2])
"""Of the left perturbation about the middle of the drive; without corrections."""


def made_drive(
    drive_id: str,
    street: Street,
    T_street_cam: FloatArray,
    seed: int,
    located: bool = True,
    believed_shift_m: float = 0.0,
    gnss: FloatArray = GNSS,
) -> PlacedDrive:
    """A drive along these cameras (K, 4, 4), placed with the error that its covariance says; the street is the map's frame.

    believed_shift_m : along the street, what its place is wrong by beyond that
    gnss : (6, 6) of the left perturbation about the middle of the drive
    """
    places = made_places(street, T_street_cam, seed)
    places = replace(places, stations=make_stations(places, PlaceSettings()))
    middle = T_street_cam[len(T_street_cam) // 2, :3, 3]
    shift = np.eye(4)
    shift[:3, 3] = middle
    Ad = se3.adjoint(shift)
    covariance = Ad @ gnss @ Ad.T if located else np.full((6, 6), np.nan)
    xi = Ad @ np.random.default_rng([seed, 7]).multivariate_normal(np.zeros(6), gnss)
    believed = se3.exp(xi) @ T_street_cam if located else level_world(T_street_cam) @ places.T_world_keyframe
    believed[:, 1, 3] += believed_shift_m
    stretches = np.split(np.arange(len(places)), range(KEYFRAMES, len(places), KEYFRAMES))
    submaps = [placed_submap(drive_id, places.T_world_keyframe, believed, rows, covariance, located) for rows in stretches]
    return PlacedDrive(drive_id, places, tuple(submaps))


def level_world(T_street_cam: FloatArray) -> FloatArray:
    """T_level_world (4, 4): the first camera's frame turned level, as the geo-reference turns it, with a heading of its own."""
    turn = se3.exp(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.7]))
    turn[:3, :3] = turn[:3, :3] @ T_street_cam[0, :3, :3]
    return turn


def placed_submap(
    drive_id: str, T_world_cam: FloatArray, T_enu_cam: FloatArray, rows: NDArray[np.int64], covariance: FloatArray, located: bool
) -> PlacedSubmap:
    """A submap of these keyframes, without any points."""
    anchor = int(rows[len(rows) // 2])
    none = np.zeros(0)
    submap = Submap(
        none.reshape(0, 3).astype(np.float32), none.astype(np.uint8), none.astype(np.float32), none.astype(np.uint8),
        none.astype(np.int64), none.astype(np.uint32), np.zeros(1, np.uint32), none.astype(np.uint8), none.astype(np.float32),
        rows.astype(np.uint32), rows.astype(np.int64), se3.inverse(T_world_cam[anchor]) @ T_world_cam[rows], 2.0 * len(rows), {},
    )  # fmt: skip
    return PlacedSubmap(submap, T_enu_cam[anchor], covariance, drive_id, FRAME if located else None)


def errors_of(meeting: Meeting, T_street_a: FloatArray, T_street_b: FloatArray) -> tuple[float, float]:
    """Metres between where the meeting and the truth put submap b in a, and chi-square (6 degrees of freedom) of the error."""
    a, b = (
        submap * KEYFRAMES + min(KEYFRAMES, len(T) - submap * KEYFRAMES) // 2
        for submap, T in ((meeting.submap_a, T_street_a), (meeting.submap_b, T_street_b))
    )
    truth = se3.inverse(T_street_a[a]) @ T_street_b[b]
    xi = se3.log(truth @ se3.inverse(meeting.T_a_b))
    return (
        float(np.linalg.norm(truth[:3, 3] - meeting.T_a_b[:3, 3])),
        float(xi @ np.linalg.solve(meeting.covariance, xi)),
    )
