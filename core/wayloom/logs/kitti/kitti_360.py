"""KITTI-360 reader: the rectified perspective pair of one sequence, with its poses and its GNSS/INS unit.

Opened by the folder of a sequence (`data_2d_raw/<sequence>`) or by a root that holds one. Poses lie in a world of their own, at
coordinates of kilometres; frames without a pose (the vehicle stood) have NaN.
"""

from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import CalibrationError, LogError
from wayloom.files.text_files import parse_numbers, quoted, read_lines
from wayloom.files.timestamps import ns_from_wall_clock, read_times, times_of_numbers
from wayloom.geometry import se3
from wayloom.logs.images.image_files import ImageHeader, first_header, pair_images
from wayloom.logs.kitti.image_folder_log import ImageFolderLog, LogFiles, StereoSequence, assemble
from wayloom.logs.kitti.kitti_360_clouds import CAM_TO_POSE, PERSPECTIVE, T_cam_pose
from wayloom.logs.kitti.kitti_360_layout import CAMERAS, Sequence, find_sequence, is_root, is_sequence
from wayloom.logs.kitti.kitti_calibration import CalibrationFile, image_size, read_calibration, rig_from_projections
from wayloom.logs.kitti.positioning import FrameClock, Unit, find_positioning
from wayloom.logs.sidecars.sidecar import read_sidecar

FloatArray = NDArray[np.float64]
FORMAT: Final = "kitti-360"
LOOKS_FOR: Final = "data_2d_raw/<sequence> with image_00/data_rect and image_01/data_rect, or such a sequence's folder"
POSES, CAM0_TO_WORLD = "poses.txt", "cam0_to_world.txt"
R_UNIT_POSE: Final = np.diag([1.0, -1.0, -1.0])
"""x forward, y right, z down of poses.txt into x forward, y left, z up of the packets."""


def recognise(path: Path) -> bool:
    """Whether a folder looks like this layout: KITTI-360's root, or the folder of a sequence."""
    return is_root(path) or is_sequence(path)


def open_kitti_360(path: Path, gnss: Path | None = None) -> ImageFolderLog:
    """Open without decoding images. Raises LogError, CalibrationError or UnknownFormatError."""
    sequence = find_sequence(path)
    folders = [sequence.images / camera for camera in CAMERAS]
    pairs = pair_images(*(folder / "data_rect" for folder in folders))
    header = first_header(pairs.left)
    size = (header.width, header.height)
    calibration = read_calibration(sequence.calibration(PERSPECTIVE))
    check_size(calibration, header)
    rig = rig_from_projections(calibration, "P_rect_00", "P_rect_01", *size)
    stamps, t_ns = frame_times(folders, pairs.numbers)
    sidecar = read_sidecar(sequence.poses)
    has_unit = sequence.calibration(CAM_TO_POSE).is_file()
    unit = Unit(T_cam_pose(sequence) @ se3.from_rotation_translation(R_UNIT_POSE, np.zeros(3)), ()) if has_unit else None
    clock = FrameClock(pairs.numbers, t_ns)
    positioning = find_positioning(sequence.poses, gnss, clock, calibration.numbers("P_rect_00", 3, 4), sidecar, unit)
    truth, truth_file = read_truth(sequence, pairs.numbers, calibration)
    lacking = [f"{camera}/timestamps.txt" for camera in CAMERAS if not (sequence.images / camera / "timestamps.txt").is_file()]
    files = [calibration.file, *stamps]
    files += [file for file in (sequence.calibration(CAM_TO_POSE) if has_unit else None, truth_file) if file is not None]
    location = LogFiles(sequence.images, sequence.root, files, sidecars=sequence.poses)
    frames = StereoSequence(rig, t_ns, pairs, header, (size, size))
    return assemble(FORMAT, location, frames, positioning, sidecar, truth, (*lacking, *missing_poses(truth)))


def check_size(calibration: CalibrationFile, header: ImageHeader) -> None:
    """Raises CalibrationError where the images are not of the size that the calibration is for."""
    if "S_rect_00" in calibration and image_size(calibration, "S_rect_00") != (header.width, header.height):
        width, height = image_size(calibration, "S_rect_00")
        what = f"images are {header.width}x{header.height}, but the calibration is for {width}x{height}"
        raise CalibrationError(what, file=calibration.file, record="S_rect_00", remedy="give the calibration of these images")


def frame_times(folders: list[Path], numbers: tuple[int, ...]) -> tuple[list[Path], NDArray[np.int64]]:
    """The files of time stamps that are there, and the frames' times, (N,) int64 ns: the left camera's, else the right's."""
    files = [folder / "timestamps.txt" for folder in folders]
    present = [file for file in files if file.is_file()] or files[:1]
    read = read_times(present[0], ns_from_wall_clock, remedy="get KITTI-360's time stamps of the perspective images too")
    return present, times_of_numbers(read, numbers, file=present[0], what="frames")


def read_truth(sequence: Sequence, numbers: tuple[int, ...], calibration: CalibrationFile) -> tuple[FloatArray | None, Path | None]:
    """(N, 4, 4) T_world_cam of the rectified left camera, NaN where a frame has no pose, and the file; None without poses.

    cam0_to_world.txt says it; poses.txt needs calib_cam_to_pose.txt, without which it is not used. Raises LogError.
    """
    direct, of_unit = sequence.poses / CAM0_TO_WORLD, sequence.poses / POSES
    if direct.is_file():
        poses, file = read_numbered_poses(direct, 16), direct
    elif of_unit.is_file() and sequence.calibration(CAM_TO_POSE).is_file():
        T_pose_cam = se3.inverse(T_cam_pose(sequence))
        poses, file = {frame: T @ T_pose_cam for frame, T in read_numbered_poses(of_unit, 12).items()}, of_unit
    else:
        return None, None
    nowhere = np.full((4, 4), np.nan)
    truth = np.array([poses.get(number, nowhere) for number in numbers])
    return (truth, file) if np.isfinite(truth).any() else (None, None)


def read_numbered_poses(file: Path, count: int) -> dict[int, FloatArray]:
    """Frame number to pose (4, 4) from lines of a number and `count` (12 or 16) numbers, rows first.

    Raises LogError naming the line that is cut, no motion (to 1e-2), or a second one of its frame.
    """
    poses: dict[int, FloatArray] = {}
    for number, line in enumerate(read_lines(file, remedy="give KITTI-360's poses"), start=1):
        record = f"line {number}"
        frame, _, rest = line.partition(" ")
        if not frame.isdecimal() or len(frame) > 10:
            raise LogError(f"{quoted(frame)} is no frame number", file=file, record=record, remedy="correct the line")
        T = parse_numbers(rest, file=file, record=record, count=count).reshape(-1, 4)
        T = T if count == 16 else np.vstack([T, (0.0, 0.0, 0.0, 1.0)])
        if not np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-2) or not np.allclose(T[3], (0, 0, 0, 1)):
            raise LogError("is no rigid motion", file=file, record=record, remedy="copy the file again")
        if int(frame) in poses:
            raise LogError(f"a second pose of frame {int(frame)}", file=file, record=record, remedy="remove one of them")
        poses[int(frame)] = T
    return poses


def missing_poses(truth: FloatArray | None) -> tuple[str, ...]:
    """Entries of `DriveLog.missing` about the poses."""
    if truth is None:
        return ("truth poses",)
    without = int((~np.isfinite(truth).all(axis=(1, 2))).sum())
    return (f"truth poses of {without} of {len(truth)} frames",) if without else ()
