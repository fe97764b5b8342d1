"""KITTI odometry reader: `image_0/image_1` (grey) or `image_2/image_3` (colour), `calib.txt`, `times.txt`.

Where both pairs are complete the colour pair is read: the segmentation wants colour, and the odometry makes its grey from it.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import CalibrationError, LogError
from wayloom.files.timestamps import ns_from_seconds, read_times, times_of_numbers
from wayloom.files.trajectory_files import read_kitti
from wayloom.geometry import se3
from wayloom.logs.images.image_files import first_header, has_files, pair_images
from wayloom.logs.kitti.image_folder_log import ImageFolderLog, LogFiles, StereoSequence, assemble
from wayloom.logs.kitti.kitti_calibration import read_calibration, rig_from_projections, t_cam_reference
from wayloom.logs.kitti.positioning import FrameClock, find_positioning
from wayloom.logs.sidecars.sidecar import read_sidecar

FORMAT = "kitti-odometry"
PAIRS = (("2", "3"), ("0", "1"))
LOOKS_FOR = "image_0/image_1 or image_2/image_3 with calib.txt and times.txt"


def recognise(path: Path) -> bool:
    """Whether a folder looks like this layout: it has one of the image folders, or calib.txt with times.txt."""
    if any((path / f"image_{camera}").is_dir() for pair in PAIRS for camera in pair):
        return True
    return (path / "calib.txt").is_file() and (path / "times.txt").is_file()


def choose_pair(path: Path) -> tuple[str, str]:
    """The cameras to read: the colour pair where both its folders hold files, else the grey one, else what is there in part."""
    complete = [pair for pair in PAIRS if all(has_files(path / f"image_{camera}") for camera in pair)]
    partly = [pair for pair in PAIRS if any((path / f"image_{camera}").is_dir() for camera in pair)]
    return (complete or partly or [("0", "1")])[0]


def open_kitti_odometry(path: Path, gnss: Path | None = None) -> ImageFolderLog:
    """Open without decoding images. Raises LogError or CalibrationError."""
    left, right = choose_pair(path)
    pairs = pair_images(path / f"image_{left}", path / f"image_{right}")
    header = first_header(pairs.left)
    size = (header.width, header.height)
    calibration = read_calibration(path / "calib.txt")
    rig = rig_from_projections(calibration, f"P{left}", f"P{right}", *size)
    if not (0 < rig.camera.cx < size[0] and 0 < rig.camera.cy < size[1]):
        what = f"the optical centre lies outside of the {size[0]}x{size[1]} images"
        raise CalibrationError(what, file=calibration.file, record=f"P{left}", remedy="give the calibration of these images")
    times = path / "times.txt"
    read = read_times(times, ns_from_seconds, remedy="a log needs one time stamp in seconds for each frame")
    t_ns = times_of_numbers(read, pairs.numbers, file=times, what="frames")
    P_left = calibration.numbers(f"P{left}", 3, 4)
    sidecar = read_sidecar(path)
    positioning = find_positioning(path, gnss, FrameClock(pairs.numbers, t_ns), P_left, sidecar)
    truth_file = find_truth(path)
    truth = None if truth_file is None else read_truth(truth_file, pairs.numbers, P_left)
    location = LogFiles(path, path, [calibration.file, times, *([truth_file] if truth_file else [])], sidecars=path)
    sequence = StereoSequence(rig, t_ns, pairs, header, (size, size))
    return assemble(FORMAT, location, sequence, positioning, sidecar, truth, () if truth is not None else ("truth poses",))


def find_truth(path: Path) -> Path | None:
    """`poses.txt` in the folder, or KITTI's `../../poses/NN.txt` where the folder is `sequences/NN`."""
    candidates = [path / "poses.txt"]
    if path.parent.name == "sequences":
        candidates.append(path.parent.parent / "poses" / f"{path.name}.txt")
    return next((file for file in candidates if file.is_file()), None)


def read_truth(file: Path, numbers: tuple[int, ...], P_left: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N, 4, 4) T_world_cam of the left camera that is read, from poses of camera 0. Raises LogError for too few poses."""
    T_world_cam0 = read_kitti(file)
    if len(T_world_cam0) != len(numbers):
        if len(T_world_cam0) <= max(numbers):
            what = f"{len(T_world_cam0)} poses for {len(numbers)} frames"
            raise LogError(what, file=file, remedy="give one pose for each frame, or remove the file")
        T_world_cam0 = T_world_cam0[list(numbers)]
    T_cam_cam0 = se3.from_rotation_translation(np.eye(3), t_cam_reference(P_left))
    return np.asarray(T_world_cam0 @ se3.inverse(T_cam_cam0), dtype=np.float64)
