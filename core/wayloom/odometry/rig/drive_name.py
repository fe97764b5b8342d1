"""Name of a drive in what it tells of its rig."""

import hashlib

import numpy as np

from wayloom.logs.types import DriveLog


def drive_name(log: DriveLog) -> str:
    """The log's name and eight digits of its time stamps' SHA-256: folders of different drives may have one name."""
    return f"{log.name}#{hashlib.sha256(np.ascontiguousarray(log.t_ns, '<i8').tobytes()).hexdigest()[:8]}"
