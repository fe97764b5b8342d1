"""Frames of a log whose images cannot be used: found, left out, and told."""

from pathlib import Path
from typing import Final

import numpy as np

from wayloom.errors import LogError
from wayloom.files.text_files import utf8_text
from wayloom.logs.types import DriveLog, StoredLog

MOST_DAMAGED: Final = 0.1
"""Share of a log's frames that may be left out. Beyond, it is no fault of single files, and the gaps are no more single frames."""
SHOWN: Final = 5


def without_damage(log: DriveLog) -> DriveLog:
    """The log without the frames that the ends of their image files tell to be damaged. Raises as `without_frames`."""
    if not isinstance(log, StoredLog):
        return log
    return without_frames(log, {damage.frame: damage.error for damage in reversed(log.damaged(decode=False))})


def without_frames(log: DriveLog, damaged: dict[int, LogError]) -> DriveLog:
    """The log without these frames, which `missing` then names with reason and file.

    Raises LogError where they are too many, or -1, which is no frame but the log's file itself.
    """
    if not damaged or not isinstance(log, StoredLog):
        return log
    if -1 in damaged:
        raise damaged[-1]
    if len(damaged) > MOST_DAMAGED * len(log):
        first = damaged[min(damaged)]
        what = f"{len(damaged)} of {len(log)} frames cannot be used, the first: {first}"
        raise LogError(what, remedy="record the drive again", reason=first.reason)
    rows = np.setdiff1d(np.arange(len(log)), sorted(damaged))
    return log.kept(rows, (described(damaged),))


def told_again(problem: str, file: str, reason: str) -> LogError:
    """The error whose whole message, file and reason were kept."""
    error = LogError(problem, reason=reason)
    error.file = file
    return error


def described(damaged: dict[int, LogError]) -> str:
    """In words: which frames were left out, why, and for which file."""
    shown = [
        f"{frame} ({error.reason}, {utf8_text(Path(error.file or '?').name)})" for frame, error in sorted(damaged.items())[:SHOWN]
    ]
    more = f", {len(damaged) - SHOWN} more" if len(damaged) > SHOWN else ""
    return f"frames that were left out: {', '.join(shown)}{more}"
