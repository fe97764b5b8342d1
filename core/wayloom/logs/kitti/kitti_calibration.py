"""KITTI calibration files: `key: numbers` lines, projection matrices, and the chain from the GNSS/IMU unit to a camera."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import CalibrationError
from wayloom.files.text_files import parse_numbers, read_text
from wayloom.geometry import se3
from wayloom.geometry.camera import PinholeCamera, StereoRig
from wayloom.geometry.rectification import DistortedCamera

FloatArray = NDArray[np.float64]
RESTORE = "copy the calibration that KITTI gives for the drive beside the log"
LARGEST_DISTORTION = 100.0
BASELINES_M = (0.005, 20.0)
CAM_TO_CAM, IMU_TO_VELO, VELO_TO_CAM = "calib_cam_to_cam.txt", "calib_imu_to_velo.txt", "calib_velo_to_cam.txt"


@dataclass(frozen=True, slots=True)
class CalibrationFile:
    """A file of `key: numbers` lines, whose numbers are parsed when they are asked for, and the line of each key, from 1."""

    file: Path
    entries: dict[str, str]
    lines: dict[str, int]

    def __contains__(self, key: str) -> bool:
        return key in self.entries

    def numbers(self, key: str, *shape: int) -> FloatArray:
        """The finite numbers of a key in this shape, rows first. Raises CalibrationError naming key and line."""
        if key not in self.entries:
            raise CalibrationError("is missing", file=self.file, record=key, remedy=RESTORE)
        record, count = f"{key}, line {self.lines[key]}", int(np.prod(shape))
        values = parse_numbers(self.entries[key], file=self.file, record=record, count=count, error=CalibrationError)
        return values.reshape(shape)

    def rotation(self, key: str) -> FloatArray:
        """A (3, 3) rotation. Raises CalibrationError where it is none (to 1e-3)."""
        R = self.numbers(key, 3, 3)
        if not (np.allclose(R @ R.T, np.eye(3), atol=1e-3) and np.linalg.det(R) > 0):
            raise CalibrationError("is no rotation", file=self.file, record=key, remedy=RESTORE)
        return R


def read_calibration(file: Path) -> CalibrationFile:
    """Raises CalibrationError where the file is missing or cannot be read."""
    text = read_text(file, remedy=RESTORE, error=CalibrationError)
    entries: dict[str, str] = {}
    lines: dict[str, int] = {}
    for number, line in enumerate(text.split("\n"), start=1):
        key, colon, numbers = line.partition(":")
        if colon:
            entries[key.strip()], lines[key.strip()] = numbers, number
    return CalibrationFile(file, entries, lines)


def check_projection(P: FloatArray, file: Path, key: str) -> None:
    """Raises CalibrationError where P (3, 4) is not that of a rectified camera: K [I | t] without skew."""
    rows = [[P[0, 0], 0, P[0, 2]], [0, P[1, 1], P[1, 2]], [0, 0, 1]]
    if not np.allclose(P[:, :3], rows, atol=1e-6):
        raise CalibrationError("is no projection matrix of a rectified camera", file=file, record=key, remedy=RESTORE)
    if not (1.0 <= P[0, 0] <= 1e6 and 1.0 <= P[1, 1] <= 1e6):
        what = f"focal length {P[0, 0]:g}, {P[1, 1]:g} px is impossible"
        raise CalibrationError(what, file=file, record=key, remedy=RESTORE)


def t_cam_reference(P: FloatArray) -> FloatArray:
    """P (3, 4) = K [I | t] to t (3,) m: p_cam = p_reference + t, the reference being camera 0's rectified frame."""
    return np.asarray(np.linalg.solve(P[:, :3], P[:, 3]), dtype=np.float64)


def rig_from_projections(calibration: CalibrationFile, left: str, right: str, width: int, height: int) -> StereoRig:
    """The rectified rig of two projection matrices, all three numbers of the translation. Raises CalibrationError."""
    P = [calibration.numbers(key, 3, 4) for key in (left, right)]
    for key, matrix in zip((left, right), P, strict=True):
        check_projection(matrix, calibration.file, key)
    if not np.allclose(P[0][:, :3], P[1][:, :3], rtol=1e-6, atol=1e-3):
        what = f"{left} and {right} have different focal lengths or centres: the pair is not rectified"
        raise CalibrationError(what, file=calibration.file, remedy=RESTORE)
    t = t_cam_reference(P[1]) - t_cam_reference(P[0])
    if t[0] >= 0:
        what = f"baseline {-t[0]:.4f} m is not positive: left and right may be exchanged"
        raise CalibrationError(what, file=calibration.file, record=right, remedy=RESTORE)
    if not BASELINES_M[0] <= -t[0] <= BASELINES_M[1]:
        what = f"a baseline of {-t[0]:g} m is impossible"
        remedy = "the fourth number of P is minus focal length in px times baseline in m: correct its unit"
        raise CalibrationError(what, file=calibration.file, record=right, remedy=remedy)
    K = P[0]
    camera = PinholeCamera(float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]), width, height)
    return StereoRig(camera, (float(t[0]), float(t[1]), float(t[2])))


def distorted_camera(calibration: CalibrationFile, camera: str) -> DistortedCamera:
    """The lens of an unrectified camera such as "02" from its S, K and D. Raises CalibrationError."""
    K, D = calibration.numbers(f"K_{camera}", 3, 3), calibration.numbers(f"D_{camera}", 5)
    width, height = image_size(calibration, f"S_{camera}")
    if not (1.0 <= K[0, 0] <= 1e6 and 1.0 <= K[1, 1] <= 1e6) or np.abs(K[:2, 2]).max() > 1e6:
        raise CalibrationError("is no calibration matrix", file=calibration.file, record=f"K_{camera}", remedy=RESTORE)
    if np.abs(D).max() > LARGEST_DISTORTION:
        what = f"a distortion of {np.abs(D).max():g} is impossible"
        raise CalibrationError(what, file=calibration.file, record=f"D_{camera}", remedy=RESTORE)
    pinhole = PinholeCamera(float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]), width, height)
    return DistortedCamera(pinhole, (float(D[0]), float(D[1]), float(D[2]), float(D[3]), float(D[4])))


def image_size(calibration: CalibrationFile, key: str) -> tuple[int, int]:
    """The (width, height) that a size entry names. Raises CalibrationError where it is impossible."""
    width, height = calibration.numbers(key, 2)
    if not (1 <= width <= 65_535 and 1 <= height <= 65_535):
        raise CalibrationError(f"{width:g}x{height:g} is no image size", file=calibration.file, record=key, remedy=RESTORE)
    return int(width), int(height)


def check_rigid_rows(values: FloatArray, file: Path, record: str) -> FloatArray:
    """Twelve numbers, the first three rows of a motion, to (4, 4). Raises CalibrationError where it is no motion (to 1e-3)."""
    T = np.vstack([values.reshape(3, 4), (0.0, 0.0, 0.0, 1.0)])
    if not (np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-3) and np.linalg.det(T[:3, :3]) > 0):
        raise CalibrationError("is no rigid motion", file=file, record=record, remedy=RESTORE)
    return T


def rigid_from(calibration: CalibrationFile) -> FloatArray:
    """The (4, 4) motion of a file with R and T."""
    return se3.from_rotation_translation(calibration.rotation("R"), calibration.numbers("T", 3))


def T_cam_imu_from_files(imu_to_velo: Path, velo_to_cam: Path, cam_to_cam: Path | None, P_left: FloatArray) -> FloatArray:
    """The GNSS/IMU unit's frame into the rectified left camera's, (4, 4):

    T_cam_imu = [I | K^-1 P[:, 3]] R_rect_00 T_velo_to_cam T_imu_to_velo. Without `cam_to_cam` R_rect_00 is taken as identity
    (it turns by under a degree: about 1 cm of lever arm). Raises CalibrationError.
    """
    T_cam0_imu = rigid_from(read_calibration(velo_to_cam)) @ rigid_from(read_calibration(imu_to_velo))
    R_rect = np.eye(3) if cam_to_cam is None else read_calibration(cam_to_cam).rotation("R_rect_00")
    T_rect_cam0 = se3.from_rotation_translation(R_rect, t_cam_reference(P_left))
    return np.asarray(T_rect_cam0 @ T_cam0_imu, dtype=np.float64)
