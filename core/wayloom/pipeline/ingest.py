"""The first stage: every image decoded, every record looked at, and the log's contents named by digests."""

import hashlib
import json
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.config.progress import Progress, silent
from wayloom.errors import LogError, StageError
from wayloom.logs.inspection import inspect_log
from wayloom.logs.types import DriveLog
from wayloom.pipeline.keys import digest_of_files, sha256_of_json

LOG_FILE: Final = "log.json"
FORMAT_VERSION: Final = 1


def ingest(log: DriveLog, out_dir: Path, progress: Progress = silent) -> None:
    """Decode all images and write log.json: digests, and what `inspect_log` finds. Raises LogError for damaged images."""
    report = inspect_log(log, decode=True, progress=lambda share, what: progress(0.9 * share, what))
    if report.damaged:
        what = f"{len(report.damaged)} of {2 * len(log)} images cannot be used; the first: {report.damaged[0].problem}"
        raise LogError(what)
    digests = {"images": images_digest(log), "gnss": gnss_digest(log)}
    said = {"format_version": FORMAT_VERSION, "name": log.name, "digests": digests, "log": report.model_dump(mode="json")}
    (out_dir / LOG_FILE).write_text(json.dumps(said, indent=1) + "\n")
    progress(1.0, f"{len(log)} frames are whole")


def read_log_file(folder: Path) -> dict[str, Any]:
    """What `ingest` wrote. Raises StageError where it is missing or of another version."""
    try:
        said = json.loads((folder / LOG_FILE).read_text())
    except (OSError, ValueError) as problem:
        raise StageError(f"{folder / LOG_FILE} cannot be read ({problem}); run ingest again") from problem
    if not isinstance(said, dict) or said.get("format_version") != FORMAT_VERSION:
        raise StageError(f"{folder / LOG_FILE} is of another version; run ingest again")
    return said


def images_digest(log: DriveLog) -> str:
    """One digest of all files of the log, by name and content."""
    return digest_of_files(log.root, log.files)


def gnss_digest(log: DriveLog) -> str:
    """One digest of the fixes as read, wherever they came from, and of the antenna's place."""
    gnss = log.gnss
    arrays: list[NDArray[Any]] = [] if gnss is None else [gnss.t_ns, gnss.lon_lat_height, gnss.covariance_enu, gnss.fix_type]
    content = hashlib.sha256()
    for array in (*arrays, log.p_cam_gnss):
        content.update(f"{array.dtype.str}{array.shape}".encode())
        content.update(np.ascontiguousarray(array).tobytes())
    return content.hexdigest()


def fingerprint(log: DriveLog) -> str:
    """A quick sign that the log's files are the same: names, sizes, times of change; and the fixes themselves."""
    stats = [(name, (log.root / name).stat()) for name in log.files]
    return sha256_of_json([[[name, stat.st_size, stat.st_mtime_ns] for name, stat in stats], gnss_digest(log)])
