"""Submaps of a drive as the city graph takes them, and back."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from wayloom.errors import InputError
from wayloom.geodesy.map_frame import MapFrame
from wayloom.stitching.types import BoolArray, City, DrivePlaces, FloatArray
from wayloom.submaps.submap import PlacedSubmap


def drive_places(
    submaps: Sequence[PlacedSubmap], connected: BoolArray | None = None, cross: FloatArray | None = None
) -> DrivePlaces:
    """The submaps of one drive, in the order of the road, at least one.

    connected : (n - 1,) false where the track was lost between a submap and the next; None: nowhere
    cross     : (n - 1, 6, 6) covariance of neighbours, where the drive's graph tells it
    Raises InputError when they are of several drives or frames.
    """
    first = submaps[0]
    if any(one.drive_id != first.drive_id or one.frame != first.frame for one in submaps):
        raise InputError(f"submaps of drive {first.drive_id} and of another drive or frame", remedy="give those of one drive")
    return DrivePlaces(
        first.drive_id,
        np.array([one.T_enu_submap for one in submaps]),
        np.array([one.covariance for one in submaps]),
        np.array([one.submap.length_m for one in submaps]),
        np.ones(len(submaps) - 1, np.bool_) if connected is None else connected,
        cross,
        first.frame is not None,
    )


def placed_anew(submaps: Sequence[PlacedSubmap], city: City, frame: MapFrame) -> list[PlacedSubmap]:
    """The same submaps where the city graph has them, in its frame; those of drives without a place are left out."""
    out, number = [], dict.fromkeys(city.drives, 0)
    for one in submaps:
        drive, k = city.drives[one.drive_id], number[one.drive_id]
        number[one.drive_id] = k + 1
        if drive.placed:
            out.append(replace(one, T_enu_submap=drive.T_map_submap[k], covariance=drive.covariance[k], frame=frame))
    return out
