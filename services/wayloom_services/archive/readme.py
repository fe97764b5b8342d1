"""README of a drive's archive: what each file holds, with frames and units."""

import textwrap
from collections.abc import Mapping
from typing import Any, Final

from wayloom import __version__
from wayloom.config.classes import CLASS_NAMES
from wayloom.geodesy.map_frame import MapFrame

WIDTH: Final = 100
PRIVACY: Final = (
    "There is no camera image in this archive and no point of a person; the ground's pictures show road, sidewalk and terrain "
    "alone. Vehicles are in the cloud; the map leaves out those that move."
)


def readme(drive: Mapping[str, Any], told: Mapping[str, str], frame: MapFrame | None) -> bytes:
    """The text. told : by name what each file holds; frame : of the map, None where the drive has no place on Earth"""
    parts = [
        f"{drive['name']}\n{'=' * len(drive['name'])}",
        _wrapped(
            f"Drive {drive['id']} of a wayloom service, as it had it when this archive was asked for (wayloom {__version__})."
        ),
        "Files\n-----",
        *(f"{name}\n{_wrapped(about, '    ')}" for name, about in told.items()),
        "Frames and units\n----------------",
        _wrapped(_frame_words(frame)),
        _wrapped(
            "Lengths are in metres, times in seconds. A camera's axes are x right, y down, z forward. Heights are above the "
            "ellipsoid of WGS84. Places are those of the map's newest version, which moves drives a little when others join it: "
            "do not mix two archives."
        ),
        "Classes\n-------",
        _wrapped(", ".join(f"{number} {name}" for number, name in enumerate(CLASS_NAMES)) + ", 255 unknown"),
        "Privacy\n-------",
        _wrapped(PRIVACY),
    ]
    return ("\n\n".join(parts) + "\n").encode()


def _frame_words(frame: MapFrame | None) -> str:
    if frame is None:
        return "The drive has no place on Earth: its axes are its own, its first camera's made level, z up."
    return (
        f"The map's frame is the tangent plane at longitude {frame.lon_deg}, latitude {frame.lat_deg}, height {frame.height_m} m "
        "(WGS84): x east, y north, z up."
    )


def _wrapped(text: str, indent: str = "") -> str:
    return textwrap.fill(text, WIDTH, initial_indent=indent, subsequent_indent=indent)
