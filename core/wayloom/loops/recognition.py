"""Candidates for a loop by the place index: where the odometry has drifted too far to tell, and across a loss of tracking."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayloom.loops.settings import LoopSettings
from wayloom.places.index import PlaceIndex, PlaceQuery, Stretch, held_features
from wayloom.places.road import road_m
from wayloom.places.types import Places

FloatArray = NDArray[np.float64]
DRIVE = "drive"
MORE = 4
"""Candidates that are asked for one that is tried: the odometry denies some, and knows others."""


@dataclass(frozen=True, slots=True)
class Recognition:
    """Index of a drive's own stations; bits : the local features of each."""

    index: PlaceIndex
    bits: list[NDArray[np.uint8]]

    def candidates(self, places: Places, road: FloatArray, station: int, settings: LoopSettings) -> list[int]:
        """Earlier keyframes that look like the station's, the likest first: of other segments any, of its own those that the
        odometry does not deny and is too unsure of to be asked for (`LoopSettings.max_prior_sigma_m`)."""
        j = int(places.stations.keyframe[station])
        query = PlaceQuery(self.bits[station], places.stations.grid[station])
        later = Stretch(DRIVE, float(road[j]) - settings.min_road_m, np.inf)
        found = self.index.candidates(query, MORE * settings.recognised, without=later)
        i = np.array([candidate.anchor for candidate in found], np.int64)
        sigma = settings.drift_share * (road[j] - road[i])
        distance = np.linalg.norm(places.T_world_keyframe[i, :3, 3] - places.T_world_keyframe[j, :3, 3], axis=1)
        possible = distance < settings.near_m + settings.registration.prior_sigmas * sigma
        elsewhere = places.segment[i] != places.segment[j]
        wanted = elsewhere | ((sigma >= settings.max_prior_sigma_m) & possible)
        return [int(k) for k in i[wanted][: settings.recognised]]


def recognition(places: Places, settings: LoopSettings) -> Recognition | None:
    """None where the odometry knows every place of the drive well enough."""
    road = road_m(places.T_world_keyframe)
    if not len(places.stations) or not len(places.features):
        return None
    if not np.ptp(places.segment) and settings.drift_share * road[-1] < settings.max_prior_sigma_m:
        return None
    index = PlaceIndex()
    index.add(DRIVE, places)
    chosen, of = held_features(places)
    return Recognition(index, [places.features.bits[chosen[of == station]] for station in range(len(places.stations))])
