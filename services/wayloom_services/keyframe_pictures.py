"""Pictures of keyframes as WebP. Imported where one is drawn: the readers of logs and numba come with it."""

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from wayloom.errors import NotFoundError
from wayloom.odometry.result.odometry_file import ODOMETRY_FILE, load_odometry
from wayloom.odometry.types import OdometryResult
from wayloom.pipeline.log_source import LogSource
from wayloom.reports.keyframe_view import labelled_image, points_view, webp_bytes
from wayloom.segmentation.keyframe_labels import label_path, read_labels
from wayloom.store.tables.drives import Drive
from wayloom.submaps.submap import Submap


def picture_of_points(submap: Submap, row: int, camera: Mapping[str, Any]) -> bytes:
    """The submap's labelled points as the left camera of the keyframe in this row of its table sees them. camera : facts of
    the log"""
    return webp_bytes(points_view(submap, row, camera)[0])


def picture_of_image(folder: Path, drive: Drive, keys: Mapping[str, str], frame: int, share: float) -> bytes:
    """The left image of a frame with its labels and the points that were tracked in it, persons painted over.

    folder : the drive's; keys : of the outputs of its stages; share : of the labels' colour, 0 to 1
    Raises NotFoundError where its labels are not on this disk.
    """
    stages = {name: folder / "stages" / name / key for name, key in keys.items()}
    seen = read_labels(label_path(stages["segmentation"], "left", frame)) if "segmentation" in stages else None
    if seen is None:
        raise NotFoundError(f"frame {frame} of drive {drive.id[:12]} has no labels on this disk")
    manifest = drive.manifest
    gnss = None if manifest.get("gnss") is None else folder / manifest["gnss"]
    shown = LogSource(folder / manifest.get("log", "log"), gnss).log.frame(frame).left
    uv = np.zeros((0, 2))
    if "odometry" in stages:
        odometry = _odometry(stages["odometry"] / ODOMETRY_FILE)
        here = np.flatnonzero(odometry.keyframes.frame == frame)
        uv = odometry.points.uv_host.astype(np.float64)[np.isin(odometry.points.host, here)]
    return webp_bytes(labelled_image(shown, seen, uv, share))


@lru_cache(maxsize=2)
def _odometry(path: Path) -> OdometryResult:
    return load_odometry(path)
