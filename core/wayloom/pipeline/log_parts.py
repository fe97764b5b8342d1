"""Digests of a log's parts: what a stage's key holds of the log that the stage reads.

images    every file of the log by name and content, calibration and time stamps as read, and the version of the code that decodes
          them; all files, because a calibration file decides how images are rectified
gnss      the fixes as read, wherever they came from, the antenna's place and what is stated of the receiver
imu       the samples as read, wherever they came from, and the sensor's place
exposure  the exposure times as read
name      what the log is called: results that other programs collect bear it

A part is digested as read where that is cheap: then it counts whatever file it came from, and a reader that is rewritten and reads
the same changes no key.
"""

import hashlib
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import LogError, StageError
from wayloom.logs.damage import told_again
from wayloom.logs.types import DriveLog
from wayloom.pipeline.digests import digest_of_files, sha256_of_json

LOG_FILE: Final = "log.json"
FORMAT_VERSION: Final = 2


def read_log_file(folder: Path) -> dict[str, Any]:
    """What the ingest stage wrote. Raises StageError where it is missing or of another version."""
    try:
        content = json.loads((folder / LOG_FILE).read_text())
    except (OSError, ValueError) as problem:
        raise StageError(f"{folder / LOG_FILE} cannot be read ({problem}); run ingest again") from problem
    if not isinstance(content, dict) or content.get("format_version") != FORMAT_VERSION:
        raise StageError(f"{folder / LOG_FILE} is of another version; run ingest again")
    return content


def rejected_frames(folder: Path) -> dict[int, LogError]:
    """The frames that the ingest stage could not decode, and why; none where it has not run, or has to run again."""
    try:
        rejected = read_log_file(folder).get("rejected", {})
    except StageError:
        return {}
    return {int(frame): told_again(one["problem"], one["file"], one["reason"]) for frame, one in rejected.items()}


def images_digest(log: DriveLog, reader_version: str, known: Mapping[Path, str] = MappingProxyType({})) -> str:
    """One digest of all files of the log, of its calibration and time stamps as read, and of the reader's code.

    known : SHA-256, hexadecimal, of files that were read already
    """
    return sha256_of_json([digest_of_files(log.root, log.files, known), _calibration_digest(log), reader_version])


def gnss_digest(log: DriveLog, reader_version: str = "") -> str:
    """One digest of the fixes as read, of the antenna's place and of what is stated of both."""
    gnss = log.gnss
    fixes = () if gnss is None else (gnss.t_ns, gnss.lon_lat_height, gnss.covariance_enu, gnss.fix_type)
    said = (log.receiver.time_offset_s, log.receiver.time_offset_sigma_s, log.receiver.lever_sigma_m)
    stated = np.array([np.nan if value is None else value for value in said])
    return _digest_of_arrays(*fixes, log.p_cam_gnss, stated)


def imu_digest(log: DriveLog, reader_version: str = "") -> str:
    """One digest of the IMU's samples as read and of its place; the place of an IMU without samples does not count."""
    imu = log.imu
    if imu is None:
        return _digest_of_arrays()
    place = () if log.T_cam_imu is None else (log.T_cam_imu,)
    return _digest_of_arrays(imu.t_ns, imu.specific_force, imu.angular_rate, *place)


def exposure_digest(log: DriveLog, reader_version: str = "") -> str:
    """One digest of the exposure times (N, 2) s as read."""
    exposure_s: NDArray[np.float64] | None = getattr(log, "exposure_s", None)
    return _digest_of_arrays(*(() if exposure_s is None else (exposure_s,)))


def name_digest(log: DriveLog, reader_version: str = "") -> str:
    """One digest of the log's name."""
    return sha256_of_json(log.name)


LOG_PARTS: Final[dict[str, Callable[[DriveLog, str], str]]] = {
    "images": images_digest,
    "gnss": gnss_digest,
    "imu": imu_digest,
    "exposure": exposure_digest,
    "name": name_digest,
}


def fingerprint(log: DriveLog, reader_version: str) -> str:
    """A quick sign that the log is the same: names, sizes, times of change of its files; and all parts that are cheap to digest."""
    stats = [(name, (log.root / name).stat()) for name in log.files]
    files = [[name, stat.st_size, stat.st_mtime_ns] for name, stat in stats]
    parts = [digest(log, reader_version) for part, digest in LOG_PARTS.items() if part != "images"]
    return sha256_of_json([files, _calibration_digest(log), reader_version, parts])


def _calibration_digest(log: DriveLog) -> str:
    camera, rig = log.rig.camera, log.rig
    numbers = [camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height, *rig.t_right_left]
    return _digest_of_arrays(np.array(numbers, np.float64), log.t_ns) + sha256_of_json([log.rig_id, bool(log.colour)])


def _digest_of_arrays(*arrays: NDArray[Any]) -> str:
    content = hashlib.sha256()
    for array in arrays:
        content.update(f"{array.dtype.str}{array.shape}".encode())
        content.update(np.ascontiguousarray(array).tobytes())
    return content.hexdigest()
