"""Ground truth of a simulated drive, below `truth` in the drive's folder.

poses_enu.txt                   T_enu_cam of the left camera, first three rows a line, in the city's tangent plane
depth_{left,right}/%06d.png     16 bit, 1/256 m along the true camera's z; 0 for sky and beyond 256 m
class_{left,right}/%06d.png     Cityscapes train ids
instance_{left,right}/%06d.png  16 bit; a number a thing, the same in all drives of a city; 0 ground and sky, from 53249 on movers
lidar/%06d.label                uint32 for each point of a scan: class in the lower 16 bits, instance in the upper
frames.csv                      per frame: exposure and gain of left and right, and the IMU's biases
fixes.csv                       per fix: its true time, the antenna's true place (ENU), its error, true sigma, whether multipath
vehicle.json                    the rig as given and as it is, clock, places of the sensors, all settings of the vehicle
surface.ply                     what the left camera saw of all that stands still, ENU, with class and instance
objects.geojson, areas.geojson  poles, signs, lights; roads and sidewalks; with their coordinates in ENU too
markings.geojson                road markings and kerbs, likewise
"""

import csv
import io
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.errors import LogError
from wayloom.files.ply import places, read_vertices
from wayloom.files.text_files import parse_numbers, read_bytes, read_lines, read_text
from wayloom.geometry import se3
from wayloom.logs.kitti.kitti_360_clouds import read_scan
from wayloom.logs.kitti.kitti_360_layout import find_sequence, is_root

FloatArray = NDArray[np.float64]
FOLDER: Final = "truth"
DEPTH_PER_M: Final = 256
CAMERAS: Final = ("left", "right")
IMAGE_KINDS: Final = ("depth", "class", "instance")
POSES_NAME, FRAMES_NAME, VEHICLE_NAME, SURFACE_NAME = "poses_enu.txt", "frames.csv", "vehicle.json", "surface.ply"
FIXES_NAME: Final = "fixes.csv"
FIX_COLUMNS: Final = ("t_ns", "east_m", "north_m", "up_m", "error_e_m", "error_n_m", "error_u_m", "sigma_m", "multipath")
OBJECTS_NAME, AREAS_NAME, MARKINGS_NAME = "objects.geojson", "areas.geojson", "markings.geojson"
EXPOSURE_COLUMNS: Final = ("left_exposure_s", "left_gain", "right_exposure_s", "right_gain")
BIAS_COLUMNS: Final = ("fx_bias_m_s2", "fy_bias_m_s2", "fz_bias_m_s2", "wx_bias_rad_s", "wy_bias_rad_s", "wz_bias_rad_s")
SURFACE_POINT: Final = np.dtype(
    [("x", "<f8"), ("y", "<f8"), ("z", "<f8"), ("red", "u1"), ("green", "u1"), ("blue", "u1"), ("label", "u1"), ("instance", "<u2")]
)
FIRST_MOVER: Final = 53_249
"""Instances from here on move."""
REMEDY: Final = "simulate the drive with --truth"


@dataclass(frozen=True, slots=True)
class Surface:
    """points_enu (N, 3) m, labels (N,) uint8 train ids, instances (N,) uint16."""

    points_enu: FloatArray
    labels: NDArray[np.uint8]
    instances: NDArray[np.uint16]


@dataclass(frozen=True, slots=True)
class ObjectTruth:
    """A pole, sign or light: class_id, its name, instance, foot_enu (3,) m, and its ends above the foot, m."""

    class_id: int
    class_name: str
    instance: int
    foot_enu: FloatArray
    bottom_m: float
    height_m: float


@dataclass(frozen=True, slots=True)
class AreaTruth:
    """A road or sidewalk: class_id, its name, outer ring_enu (N, 3) m, the last point the first again, and its holes' rings."""

    class_id: int
    class_name: str
    ring_enu: FloatArray
    holes_enu: tuple[FloatArray, ...]


@dataclass(frozen=True, slots=True)
class FrameTruth:
    """Per frame: t_ns (N,), exposure_s and gain (N, 2) of left and right, imu_bias (N, 6) of force and rate, None without IMU."""

    t_ns: NDArray[np.int64]
    exposure_s: FloatArray
    gain: FloatArray
    imu_bias: FloatArray | None


@dataclass(frozen=True, slots=True)
class TrueScan:
    """A turn of the LiDAR: points_cam (N, 3) m in the left camera's frame, labels (N,) uint8 train ids, instances (N,) uint16."""

    points_cam: FloatArray
    labels: NDArray[np.uint8]
    instances: NDArray[np.uint16]

    @property
    def moving(self) -> NDArray[np.bool_]:
        """(N,) whether the thing moves."""
        return np.asarray(self.instances >= FIRST_MOVER)


@dataclass(frozen=True, slots=True)
class SimulatedTruth:
    """The ground truth of one drive. `folder` holds the files, T_enu_cam (N, 4, 4) are the left camera's poses."""

    folder: Path
    T_enu_cam: FloatArray

    def __len__(self) -> int:
        return len(self.T_enu_cam)

    def depth_m(self, index: int, camera: str = "left") -> NDArray[np.float32]:
        """(h, w) m along z; 0 for sky and beyond 256 m. Raises LogError."""
        return (read_image(self.folder, "depth", camera, index) / np.float32(DEPTH_PER_M)).astype(np.float32)

    def class_id(self, index: int, camera: str = "left") -> NDArray[np.uint8]:
        """(h, w) train ids. Raises LogError."""
        return read_image(self.folder, "class", camera, index).astype(np.uint8)

    def instance(self, index: int, camera: str = "left") -> NDArray[np.uint16]:
        """(h, w) instance ids, 0 for none. Raises LogError."""
        return read_image(self.folder, "instance", camera, index).astype(np.uint16)

    def scan_labels(self, index: int) -> tuple[NDArray[np.uint8], NDArray[np.uint16]]:
        """Train id (N,) and instance (N,) of each point of a scan. Raises LogError where the frame has none."""
        data = read_bytes(scan_label_file(self.folder, index), remedy="not every drive and frame has a scan")
        both = np.frombuffer(data, "<u4")
        return (both & 0xFFFF).astype(np.uint8), (both >> 16).astype(np.uint16)

    def scan(self, index: int) -> TrueScan | None:
        """The scan of a frame with its labels; None where the frame has none, or its drive's layout keeps scans in no files.

        Raises LogError where scan and labels do not fit.
        """
        file = scan_file(self.folder.parent, index)
        if not file.is_file() or not scan_label_file(self.folder, index).is_file():
            return None
        points, (labels, instances) = read_scan(file)[:, :3].astype(np.float64), self.scan_labels(index)
        if len(points) != len(labels):
            raise LogError(
                f"has {len(points)} points, their labels are {len(labels)}", file=file, remedy="simulate the drive again"
            )
        return TrueScan(se3.transform(np.array(self.vehicle()["T_cam_lidar"]), points), labels, instances)

    def surface(self) -> Surface:
        """The static surface points that the left camera saw. Raises LogError."""
        rows = read_vertices(self.folder / SURFACE_NAME)
        return Surface(places(rows), rows["label"].copy(), rows["instance"].copy())

    def objects(self) -> list[ObjectTruth]:
        """Poles, signs and lights around the trajectory. Raises LogError."""
        return [
            ObjectTruth(p["class_id"], p["class"], p["instance"], np.array(p["foot_enu_m"]), p["bottom_m"], p["height_m"])
            for p in _properties(self.folder / OBJECTS_NAME)
        ]

    def areas(self) -> list[AreaTruth]:
        """Roads and sidewalks around the trajectory. Raises LogError."""
        out = []
        for p in _properties(self.folder / AREAS_NAME):
            ring, *holes = (np.array(ring) for ring in p["rings_enu_m"])
            out.append(AreaTruth(p["class_id"], p["class"], ring, tuple(holes)))
        return out

    def vehicle(self) -> dict[str, Any]:
        """The rig as calibrated and as it is, and all settings of the vehicle. Raises LogError."""
        return dict(_json(self.folder / VEHICLE_NAME))

    def frames(self) -> FrameTruth:
        """Values of each frame: exposure, gain, IMU biases. Raises LogError."""
        rows = list(csv.DictReader(io.StringIO(read_text(self.folder / FRAMES_NAME, remedy=REMEDY))))

        def columns(*names: str) -> FloatArray:
            return np.array([[float(row[name]) for name in names] for row in rows])

        return FrameTruth(
            np.array([int(row["t_ns"]) for row in rows], np.int64),
            columns("left_exposure_s", "right_exposure_s"),
            columns("left_gain", "right_gain"),
            columns(*BIAS_COLUMNS) if rows and BIAS_COLUMNS[0] in rows[0] else None,
        )


def open_truth(drive: Path) -> SimulatedTruth:
    """The truth below a drive's folder. Raises LogError where it has none."""
    folder = drive / FOLDER
    file = folder / POSES_NAME
    rows = [
        parse_numbers(line, file=file, record=f"line {number}", count=12)
        for number, line in enumerate(read_lines(file, remedy=REMEDY), start=1)
    ]
    T = np.tile(np.eye(4), (len(rows), 1, 1))
    T[:, :3] = np.array(rows).reshape(-1, 3, 4)
    return SimulatedTruth(folder, T)


def has_truth(drive: Path) -> bool:
    """Whether a drive's folder holds the simulator's truth."""
    return (drive / FOLDER / POSES_NAME).is_file()


def image_file(folder: Path, kind: str, camera: str, index: int) -> Path:
    """Path of a ground-truth image."""
    return folder / f"{kind}_{camera}" / f"{index:06d}.png"


def scan_label_file(folder: Path, index: int) -> Path:
    """Path of the labels of a scan."""
    return folder / "lidar" / f"{index:06d}.label"


def scan_file(drive: Path, index: int) -> Path:
    """Path of the scan of a frame in layouts with one file a scan; it need not exist."""
    if is_root(drive):
        return find_sequence(drive).scan(index)
    raw = drive / "velodyne_points" / "data" / f"{index:010d}.bin"
    return raw if raw.parent.is_dir() else drive / "velodyne" / f"{index:06d}.bin"


def frame_files(folder: Path, index: int) -> Iterator[Path]:
    """Paths of all files of one frame, whether they exist or not."""
    yield from (image_file(folder, kind, camera, index) for kind in IMAGE_KINDS for camera in CAMERAS)
    yield scan_label_file(folder, index)


def read_image(folder: Path, kind: str, camera: str, index: int) -> NDArray[np.integer]:
    """(h, w) a ground-truth image as it is stored. Raises LogError."""
    file = image_file(folder, kind, camera, index)
    data = read_bytes(file, remedy=REMEDY)
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) if data else None
    except cv2.error:
        image = None
    if image is None or image.ndim != 2:
        raise LogError("is no truth image", file=file, remedy="simulate the drive again")
    return np.asarray(image)


def _json(file: Path) -> dict[str, Any]:
    try:
        content = json.loads(read_text(file, remedy=REMEDY))
    except ValueError as problem:
        raise LogError(f"is no JSON ({problem})", file=file, remedy="simulate the drive again") from None
    return dict(content)


def _properties(file: Path) -> list[dict[str, Any]]:
    return [feature["properties"] for feature in _json(file)["features"]]
