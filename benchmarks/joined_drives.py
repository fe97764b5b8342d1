"""Drives registered with each other and placed by the city graph, without a service around it."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np

from wayloom.places.files import load_places
from wayloom.stitching.city_graph import optimise_city
from wayloom.stitching.meetings import find_meetings
from wayloom.stitching.placed_drive import PlacedDrive
from wayloom.stitching.types import DrivePlaces
from wayloom.submaps.submap import PlacedSubmap

UNTOLD = np.full((6, 6), np.nan)


def joined(outs: Sequence[Path], drives: Sequence[list[PlacedSubmap]]) -> list[list[PlacedSubmap]]:
    """The submaps of drives of one frame, each placed by its own geo-reference, where all drives together put them.

    outs : of `wayloom process`, for the drives' places
    """
    placed = [
        PlacedDrive(items[0].drive_id, load_places(out / "stages" / "places" / "drive.places"), tuple(items))
        for out, items in zip(outs, drives, strict=True)
    ]
    meetings = [one for pair in combinations(placed, 2) for one in find_meetings(*pair).meetings]
    city = optimise_city([places_of(drive) for drive in placed], meetings).drives
    return [
        [
            replace(item, T_enu_submap=city[item.drive_id].T_map_submap[k], covariance=city[item.drive_id].covariance[k])
            for k, item in enumerate(items)
        ]
        for items in drives
    ]


def places_of(drive: PlacedDrive) -> DrivePlaces:
    """As the city graph takes it."""
    items, steps = drive.submaps, [item.before for item in drive.submaps[1:]]
    return DrivePlaces(
        drive.drive_id,
        np.array([item.T_enu_submap for item in items]),
        np.array([item.covariance for item in items]),
        np.array([max(item.submap.length_m, 1.0) for item in items]),
        np.array([step is None or step.connected for step in steps], np.bool_),
        np.array([UNTOLD if step is None else step.cross for step in steps]).reshape(-1, 6, 6),
    )
