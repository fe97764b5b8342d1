"""File of the meetings of two drives, canonical JSON: equal meetings give equal bytes."""

import json
from pathlib import Path
from typing import Any, Final

import numpy as np

from wayloom.errors import StageError
from wayloom.files.atomic import write_atomically
from wayloom.stitching.meetings import DriveMeetings
from wayloom.stitching.types import Meeting

FORMAT: Final = "wayloom-meetings"
VERSION: Final = 1
REMEDY: Final = "register the two drives again"


def encode_meetings(found: DriveMeetings) -> bytes:
    """The file's bytes."""
    rows = [
        {
            "drives": [m.drive_a, m.drive_b],
            "submaps": [m.submap_a, m.submap_b],
            "T_a_b": m.T_a_b.tolist(),
            "covariance": m.covariance.tolist(),
        }
        for m in found.meetings
    ]
    content = {"format": FORMAT, "version": VERSION, "meetings": rows, "report": found.report}
    return json.dumps(content, indent=1, sort_keys=True).encode()


def save_meetings(found: DriveMeetings, path: Path) -> None:
    """Write atomically."""
    write_atomically(path, encode_meetings(found))


def load_meetings(path: Path) -> DriveMeetings:
    """Read what `save_meetings` wrote. Raises StageError where the file is missing, damaged or of another version."""
    try:
        return decode_meetings(path.read_bytes(), str(path))
    except OSError as error:
        raise StageError(f"{path}: no readable file of meetings ({type(error).__name__}); {REMEDY}") from error


def decode_meetings(data: bytes, name: str = "meetings") -> DriveMeetings:
    """The inverse of `encode_meetings`. Raises StageError where the bytes are none, or of another version."""
    try:
        content = json.loads(data)
        if content["format"] != FORMAT or content["version"] != VERSION:
            raise StageError(f"{name}: version {content['version']}, this program reads {VERSION}; {REMEDY}")
        return DriveMeetings(tuple(_meeting(row) for row in content["meetings"]), content["report"])
    except (ValueError, KeyError, TypeError) as error:
        raise StageError(f"{name}: no readable file of meetings ({type(error).__name__}); {REMEDY}") from error


def _meeting(row: dict[str, Any]) -> Meeting:
    (drive_a, drive_b), (submap_a, submap_b) = row["drives"], row["submaps"]
    T, covariance = np.array(row["T_a_b"], np.float64), np.array(row["covariance"], np.float64)
    if T.shape != (4, 4) or covariance.shape != (6, 6):
        raise ValueError("a meeting without pose or covariance")
    return Meeting(str(drive_a), int(submap_a), str(drive_b), int(submap_b), T, covariance)
