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


def save_meetings(found: DriveMeetings, path: Path) -> None:
    """Write atomically."""
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
    write_atomically(path, json.dumps(content, indent=1, sort_keys=True).encode())


def load_meetings(path: Path) -> DriveMeetings:
    """Read what `save_meetings` wrote. Raises StageError where the file is missing, damaged or of another version."""
    remedy = "register the two drives again"
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if content["format"] != FORMAT or content["version"] != VERSION:
            raise StageError(f"{path}: version {content['version']}, this program reads {VERSION}; {remedy}")
        return DriveMeetings(tuple(_meeting(row) for row in content["meetings"]), content["report"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise StageError(f"{path}: no readable file of meetings ({type(error).__name__}); {remedy}") from error


def _meeting(row: dict[str, Any]) -> Meeting:
    (drive_a, drive_b), (submap_a, submap_b) = row["drives"], row["submaps"]
    T, covariance = np.array(row["T_a_b"], np.float64), np.array(row["covariance"], np.float64)
    if T.shape != (4, 4) or covariance.shape != (6, 6):
        raise ValueError("a meeting without pose or covariance")
    return Meeting(str(drive_a), int(submap_a), str(drive_b), int(submap_b), T, covariance)
