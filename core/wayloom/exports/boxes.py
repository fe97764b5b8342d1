"""Boxes of degrees that exports are cut to: `W,S,E,N`, across the antimeridian with west over east."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import InputError
from wayloom.files.text_files import quoted
from wayloom.geodesy.antimeridian import Box, box_of, overlap

OPTION: Final = "--bbox"
REMEDY: Final = "give west,south,east,north in degrees, as 8.40,49.00,8.42,49.01"


def parse_box(text: str) -> Box:
    """West, south, east, north; across the antimeridian east is over 180. Raises InputError."""
    try:
        edges = [float(part) for part in text.split(",")]
    except ValueError:
        raise InputError(f"{quoted(text)} is no box", record=OPTION, remedy=REMEDY) from None
    return checked_box(edges, OPTION)


def checked_box(edges: Sequence[float], record: str | None = None) -> Box:
    """West, south, east, north as a box; across the antimeridian east is over 180. Raises InputError that names the record."""
    if len(edges) != 4:
        raise InputError(f"{len(edges)} numbers are no box", record=record, remedy=REMEDY)
    west, south, east, north = edges
    if not (abs(west) <= 180.0 and abs(east) <= 180.0 and -90.0 <= south < north <= 90.0 and west != east):
        raise InputError(f"{','.join(f'{edge:g}' for edge in edges)} is no box on Earth", record=record, remedy=REMEDY)
    return west, south, east if west < east else east + 360.0, north


def nothing_inside(out: Path) -> InputError:
    """The error of an output for which the box, or the map itself, has nothing."""
    return InputError("there is nothing in the box", file=out, remedy="give a box that the drives have seen")


def inside(lon_lat: NDArray[np.float64], box: Box | None) -> NDArray[np.bool_]:
    """(N,) which places (N, 2 or more) in degrees lie in the box; all where it is None."""
    if box is None:
        return np.ones(len(lon_lat), np.bool_)
    west, south, east, north = box
    lon, lat = lon_lat[:, 0], lon_lat[:, 1]
    turned = west + (lon - west) % 360.0
    return np.asarray((turned <= east) & (lat >= south) & (lat <= north))


def touches(coordinates: Sequence[Sequence[float]], box: Box | None) -> bool:
    """Whether the box around places (longitude, latitude, …) touches the box."""
    return box is None or overlap(box_of(np.array([place[:2] for place in coordinates], np.float64)), box)
