"""KITTI raw reader: rectified (`…_sync`) and distorted (`…_extract`) drives.

A drive's folder holds `image_00` … `image_03`, each with data and timestamps.txt, and `oxts`; the calibration files lie in it or
beside it. Where both pairs are complete the colour pair (02, 03) is read. Distorted images are rectified on load.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import CalibrationError, LogError
from wayloom.files.timestamps import ns_from_wall_clock, read_times, times_of_numbers
from wayloom.geometry.camera import PinholeCamera
from wayloom.geometry.rectification import rectifying_maps
from wayloom.logs.images.image_files import ImageHeader, ImagePairs, first_header, has_files, pair_images
from wayloom.logs.kitti.image_folder_log import ImageFolderLog, LogFiles, Rectifier, StereoSequence, assemble
from wayloom.logs.kitti.kitti_calibration import (
    CAM_TO_CAM,
    CalibrationFile,
    distorted_camera,
    image_size,
    read_calibration,
    rig_from_projections,
)
from wayloom.logs.kitti.kitti_odometry import find_truth, read_truth
from wayloom.logs.kitti.positioning import FrameClock, find_positioning
from wayloom.logs.sidecars.sidecar import read_sidecar

FORMAT = "kitti-raw"
PAIRS = (("02", "03"), ("00", "01"))
LOOKS_FOR = "image_00/image_01 or image_02/image_03, each with data and timestamps.txt"
DISTORTED_ENDING = "_extract"


def recognise(path: Path) -> bool:
    """Whether a folder looks like this layout: it has one of the image folders, or a name and an oxts folder as KITTI's drives."""
    return has_image_folder(path) or (path.name.endswith(("_sync", DISTORTED_ENDING)) and (path / "oxts").is_dir())


def has_image_folder(path: Path) -> bool:
    """Whether one of the cameras is there: KITTI's drives may be GNSS logs alone."""
    return any((path / f"image_{camera}").is_dir() for pair in PAIRS for camera in pair)


def choose_pair(path: Path) -> tuple[str, str]:
    """The cameras to read: the colour pair where both its folders hold files, else the grey one, else what is there in part."""
    complete = [pair for pair in PAIRS if all(has_files(path / f"image_{camera}" / "data") for camera in pair)]
    partly = [pair for pair in PAIRS if any((path / f"image_{camera}").is_dir() for camera in pair)]
    if not complete and not partly:
        remedy = "a log needs a stereo pair; a GNSS log alone is given with --gnss beside the log of the same drive"
        raise LogError("no image folders, GNSS only", file=path, remedy=remedy)
    return (complete or partly)[0]


def open_kitti_raw(path: Path, gnss: Path | None = None) -> ImageFolderLog:
    """Open without decoding images. Raises LogError or CalibrationError."""
    left, right = choose_pair(path)
    pairs = pair_images(path / f"image_{left}" / "data", path / f"image_{right}" / "data")
    header = first_header(pairs.left)
    calibration = read_calibration(find_calibration(path))
    distorted = is_distorted(path, header, calibration, left)
    width, height = image_size(calibration, f"S_rect_{left}") if distorted else (header.width, header.height)
    rig = rig_from_projections(calibration, f"P_rect_{left}", f"P_rect_{right}", width, height)
    rectifier = make_rectifier(calibration, (left, right), rig.camera) if distorted else None
    right_size = image_size(calibration, f"S_{right}") if distorted else (header.width, header.height)
    stamps, t_ns = frame_times(path, (left, right), pairs)
    sidecar = read_sidecar(path)
    P_left = calibration.numbers(f"P_rect_{left}", 3, 4)
    positioning = find_positioning(path, gnss, FrameClock(pairs.numbers, t_ns), P_left, sidecar)
    lacking = [f"image_{c}/timestamps.txt" for c in (left, right) if not (path / f"image_{c}" / "timestamps.txt").is_file()]
    inside = calibration.file.parent == path
    truth_file = find_truth(path)
    location = LogFiles(
        path,
        root=path if inside else calibration.file.parent,
        files=[calibration.file, *stamps, *([truth_file] if truth_file else [])],
        sidecars=path,
    )
    sequence = StereoSequence(rig, t_ns, pairs, header, ((header.width, header.height), right_size), rectifier)
    truth = None if truth_file is None else read_truth(truth_file, pairs.numbers, P_left)
    return assemble(FORMAT, location, sequence, positioning, sidecar, truth, tuple(lacking))


def find_calibration(path: Path) -> Path:
    """calib_cam_to_cam.txt inside the drive's folder or beside it. Raises CalibrationError."""
    for folder in (path, path.parent):
        if (folder / CAM_TO_CAM).exists():
            return folder / CAM_TO_CAM
    remedy = f"copy KITTI's calibration of that day into {path.parent}"
    raise CalibrationError(f"no such file, nor in {path}", file=path.parent / CAM_TO_CAM, remedy=remedy)


def is_distorted(path: Path, header: ImageHeader, calibration: CalibrationFile, camera: str) -> bool:
    """Whether images are as the lens made them, by their size, and by the folder's name where sizes do not tell.

    Raises CalibrationError where the images have neither the rectified nor the distorted size.
    """
    named = path.name.endswith(DISTORTED_ENDING)
    if f"S_rect_{camera}" not in calibration and not named:
        return False
    size = (header.width, header.height)
    rectified, raw = image_size(calibration, f"S_rect_{camera}"), image_size(calibration, f"S_{camera}")
    if size not in (rectified, raw):
        what = f"images are {size[0]}x{size[1]}, but the calibration is for {rectified[0]}x{rectified[1]} or {raw[0]}x{raw[1]}"
        raise CalibrationError(what, file=calibration.file, remedy="give the calibration of these images")
    return named if rectified == raw else size == raw


def make_rectifier(calibration: CalibrationFile, cameras: tuple[str, str], rectified: PinholeCamera) -> Rectifier:
    """The sampling maps of both cameras from K, D and R_rect. Raises CalibrationError."""
    left, right = (
        rectifying_maps(distorted_camera(calibration, camera), calibration.rotation(f"R_rect_{camera}"), rectified)
        for camera in cameras
    )
    return Rectifier(left, right)


def frame_times(path: Path, cameras: tuple[str, str], pairs: ImagePairs) -> tuple[list[Path], NDArray[np.int64]]:
    """The time stamp files that are there, and the frames' times, (N,) int64 ns: the left camera's, else the right's."""
    files = [path / f"image_{camera}" / "timestamps.txt" for camera in cameras]
    present = [file for file in files if file.exists()] or files[:1]
    read = read_times(present[0], ns_from_wall_clock, remedy="a drive needs the time stamps of at least one of the two cameras")
    return present, times_of_numbers(read, pairs.numbers, file=present[0], what="frames")
