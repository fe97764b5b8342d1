"""Candidates by appearance, for drives whose place is not known: the place index names views that may see the same."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from wayloom.geometry import se3
from wayloom.places.index import PlaceIndex, query_at
from wayloom.places.types import Places
from wayloom.places.views import LOOK_AHEAD_M
from wayloom.registration.register import Prior
from wayloom.registration.scene import Scene
from wayloom.registration.search import level_pose
from wayloom.stitching.meeting_settings import MeetingSettings
from wayloom.stitching.placed_drive import PlacedDrive

GUESS: Final = np.diag([8.0**2] * 2 + [2.0**2] + [np.deg2rad(3.0) ** 2] * 2 + [np.deg2rad(10.0) ** 2])
"""Covariance of where a candidate's view lies about its middle, by what the index says; no evidence for a pose."""

LIKE_STATIONS: Final = 10
"""Stations of a drive by which it is told how alike two drives are: about 100 m of road."""


@dataclass(frozen=True, slots=True)
class Appearance:
    """An index of one drive, and the stations of another that ask it."""

    index: PlaceIndex
    asking: Places
    count: int

    def candidates(self, j: int) -> list[tuple[int, float]]:
        """Keyframes of the indexed drive that may see what the view at keyframe j sees, the likeliest first, with the heading of
        j's view in theirs: 0 or pi."""
        stations = self.asking.stations.keyframe
        if not len(stations):
            return []
        station = int(abs(stations.astype(int) - j).argmin())
        return [(found.anchor, found.yaw_rad) for found in self.index.candidates(query_at(self.asking, station), self.count)]


def by_appearance(a: PlacedDrive, b: PlacedDrive, settings: MeetingSettings) -> Appearance:
    """What b asks of a."""
    index = PlaceIndex()
    index.add(a.drive_id, a.places)
    return Appearance(index, b.places, settings.candidates)


def guess(one: Scene, other: Scene, yaw_rad: float) -> Prior:
    """T_one_other of the cameras as the index has it: the middles of both views at one place, with this heading."""
    to_middle = level_pose(0.0, LOOK_AHEAD_M, 0.0, 0.0)
    T_one_middle = se3.inverse(one.view.T_level_cam) @ to_middle
    T_middle_other = level_pose(0.0, 0.0, 0.0, yaw_rad) @ se3.inverse(to_middle) @ other.view.T_level_cam
    Ad = se3.adjoint(T_one_middle)
    return Prior(T_one_middle @ T_middle_other, Ad @ GUESS @ Ad.T)


def likeness(held: Places, asking: Places) -> float:
    """How much some of a drive's road looks like a drive that is held: the mean of `PlaceIndex.likest` over its best stations.

    Depends on the two drives alone. It ranks drives, and is no evidence of a place.
    """
    index = PlaceIndex()
    index.add("", held)
    found = [index.likest(query_at(asking, station)) for station in range(len(asking.stations))]
    return round(sum(sorted(found, reverse=True)[:LIKE_STATIONS]) / LIKE_STATIONS, 6)
