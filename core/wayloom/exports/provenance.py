"""Provenance of an export: what it was made from, and with what."""

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any, Final

from wayloom import __version__
from wayloom.geodesy.antimeridian import Box, rolled
from wayloom.geodesy.map_frame import MapFrame

FORMAT: Final = "wayloom-provenance"
VERSION: Final = 1


def provenance_of(
    origin: str,
    drives: Sequence[Mapping[str, Any]],
    frame: MapFrame | None,
    parameters: Mapping[str, Any],
    code: str,
) -> dict[str, Any]:
    """What every format keeps in its own metadata.

    origin : where it was exported from; drives by id: hashes of what was recorded or uploaded, network, times
    code   : digest of the code that merged the map
    """
    return {
        "format": FORMAT,
        "version": VERSION,
        "software": f"wayloom {__version__}",
        "code": code,
        "origin": origin,
        "drives": [*drives],
        "frame": None if frame is None else {"lon_deg": frame.lon_deg, "lat_deg": frame.lat_deg, "height_m": frame.height_m},
        "parameters": dict(parameters),
    }


def cut_to(provenance: Mapping[str, Any], box: Box | None) -> dict[str, Any]:
    """The same of an export of a box of degrees."""
    if box is None:
        return dict(provenance)
    west, south, east, north = box
    return {**provenance, "bbox": [west, south, rolled(east), north]}


def utc_text(t_ns: int) -> str:
    """RFC 3339, to the second."""
    return datetime.fromtimestamp(t_ns // 1_000_000_000, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
