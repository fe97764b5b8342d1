"""KITTI-360 LiDAR reader: single scans and accumulated labelled clouds."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import CalibrationError, LogError
from wayloom.files.ply import places, read_vertices, vertex_colours
from wayloom.files.text_files import parse_numbers, read_bytes, read_text
from wayloom.geometry import se3
from wayloom.logs.kitti.kitti_360_layout import Sequence
from wayloom.logs.kitti.kitti_calibration import RESTORE, CalibrationFile, check_rigid_rows, read_calibration

FloatArray = NDArray[np.float64]
PERSPECTIVE: Final = "perspective.txt"
CAM_TO_POSE: Final = "calib_cam_to_pose.txt"
CAM_TO_VELO: Final = "calib_cam_to_velo.txt"
KINDS: Final = ("static", "dynamic")
VISIBLE_NAMES: Final = ("visible", "isVisible")
_WINDOW = re.compile(r"(\d+)_(\d+)")


@dataclass(frozen=True, slots=True)
class Window:
    """A file of an accumulated cloud and the frames, first and last, that it was made from."""

    first: int
    last: int
    file: Path


@dataclass(frozen=True, slots=True)
class AccumulatedCloud:
    """Labelled points of a window.

    points      (N, 3) float64 m, in the world of the poses
    colours     (N, 3) uint8 RGB
    semantic    (N,) int32, KITTI-360's ids (see `kitti_360_labels.train_ids`)
    instance    (N,) int32, 1000 * semantic + number
    visible     (N,) bool, whether a camera saw it; all where the file does not say
    confidence  (N,) float64, 1 where the file does not say
    frame       (N,) int32 the frame in which a moving thing was there; -1 for static points
    """

    points: FloatArray
    colours: NDArray[np.uint8]
    semantic: NDArray[np.int32]
    instance: NDArray[np.int32]
    visible: NDArray[np.bool_]
    confidence: FloatArray
    frame: NDArray[np.int32]


def windows(sequence: Sequence, kind: str = "static") -> list[Window]:
    """The windows of a sequence's `static` or `dynamic` clouds in order; none where there are no clouds."""
    files = ((file, _WINDOW.fullmatch(file.stem)) for file in (sequence.clouds / kind).glob("*.ply"))
    found = [Window(int(match[1]), int(match[2]), file) for file, match in files if match]
    return sorted(found, key=lambda window: (window.first, window.last))


def read_cloud(file: Path) -> AccumulatedCloud:
    """An accumulated cloud. Raises LogError where it is none, or has no labels, as those of the test sequences."""
    rows = read_vertices(file)
    if "semantic" not in (rows.dtype.names or ()):
        raise LogError("has no labels (no property semantic)", file=file, remedy="take a sequence of the training set")
    return cloud_of(rows)


def cloud_of(rows: NDArray[np.void]) -> AccumulatedCloud:
    """The cloud of a file's vertices."""
    names = set(rows.dtype.names or ())
    semantic = rows["semantic"].astype(np.int32)
    visible = next((rows[name] != 0 for name in VISIBLE_NAMES if name in names), np.ones(len(rows), bool))
    return AccumulatedCloud(
        points=places(rows),
        colours=vertex_colours(rows),
        semantic=semantic,
        instance=rows["instance"].astype(np.int32) if "instance" in names else semantic * 1000,
        visible=visible,
        confidence=rows["confidence"].astype(np.float64) if "confidence" in names else np.ones(len(rows)),
        frame=rows["timestamp"].astype(np.int32) if "timestamp" in names else np.full(len(rows), -1, np.int32),
    )


def read_scan(file: Path) -> NDArray[np.float32]:
    """(N, 4) x, y, z in m (x forward, y left, z up of the scanner) and reflectance. Raises LogError."""
    data = read_bytes(file, remedy="not every frame has a scan")
    if len(data) % 16:
        raise LogError(f"{len(data)} bytes are no whole number of points", file=file, remedy="the file is cut: copy it again")
    return np.frombuffer(data, "<f4").reshape(-1, 4).astype(np.float32)


def R_rect(calibration: CalibrationFile, camera: int = 0) -> FloatArray:
    """(4, 4) rectifying rotation of a camera: from its own frame to the rectified one; identity where the file has none."""
    key = f"R_rect_{camera:02d}"
    R = calibration.rotation(key) if key in calibration else np.eye(3)
    return se3.from_rotation_translation(R, np.zeros(3))


def T_cam_lidar(sequence: Sequence) -> FloatArray:
    """(4, 4): the scanner's frame into the rectified left camera's. Raises CalibrationError."""
    file = sequence.calibration(CAM_TO_VELO)
    text = read_text(file, remedy=RESTORE, error=CalibrationError)
    T_velo_cam = check_rigid_rows(parse_numbers(text, file=file, record="line 1", count=12, error=CalibrationError), file, "line 1")
    rect = R_rect(read_calibration(sequence.calibration(PERSPECTIVE)))
    return np.asarray(rect @ se3.inverse(T_velo_cam))


def T_cam_pose(sequence: Sequence) -> FloatArray:
    """(4, 4): the GNSS/INS unit's frame of poses.txt (x forward, y right, z down) into the rectified left camera's."""
    file = sequence.calibration(CAM_TO_POSE)
    calibration = read_calibration(file)
    T_pose_cam = check_rigid_rows(calibration.numbers("image_00", 12), file, "image_00")
    rect = R_rect(read_calibration(sequence.calibration(PERSPECTIVE)))
    return np.asarray(rect @ se3.inverse(T_pose_cam))
