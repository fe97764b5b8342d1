"""Cameras of an EuRoC drive: lens and mounting from `sensor.yaml`, and the rectified pair that they make."""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import CalibrationError
from wayloom.files.text_files import quoted
from wayloom.geometry import se3
from wayloom.geometry.camera import PinholeCamera
from wayloom.geometry.rectification import DistortedCamera, FisheyeCamera, LensCamera
from wayloom.geometry.stereo_rectification import Rectification, is_left, rectify_stereo, stands_beside
from wayloom.logs.euroc.asl_yaml import AslSettings, read_asl_settings
from wayloom.logs.kitti.kitti_calibration import BASELINES_M, LARGEST_DISTORTION

FloatArray = NDArray[np.float64]
RADIAL_TANGENTIAL: Final = ("radial-tangential", "radtan", "plumb_bob")
EQUIDISTANT: Final = ("equidistant",)
CALIBRATE: Final = "give the calibration of these cameras"


@dataclass(frozen=True, slots=True)
class EurocCamera:
    """A camera: its lens, and T_body_cam (4, 4), the file's T_BS."""

    lens: LensCamera
    T_body_cam: FloatArray


@dataclass(frozen=True, slots=True)
class EurocRig:
    """The pair as it is read.

    names          folders of the left and the right camera, such as cam0, cam1
    cameras        left and right
    rectification  what makes them one rectified rig
    """

    names: tuple[str, str]
    cameras: tuple[EurocCamera, EurocCamera]
    rectification: Rectification

    @property
    def T_rect_body(self) -> FloatArray:
        """(4, 4): the body's frame into the rectified left camera's."""
        T_rect_cam = se3.from_rotation_translation(self.rectification.R_left, np.zeros(3))
        return np.asarray(T_rect_cam @ se3.inverse(self.cameras[0].T_body_cam))


def read_camera(file: Path) -> EurocCamera:
    """Raises CalibrationError naming the entry that is missing or impossible."""
    settings = read_asl_settings(file)
    width, height = _counted(settings, "resolution", 2)
    fx, fy, cx, cy = _counted(settings, "intrinsics", 4)
    if not (1 <= width <= 65_535 and 1 <= height <= 65_535):
        raise CalibrationError(f"{width:g}x{height:g} is no image size", file=file, record="resolution", remedy=CALIBRATE)
    if not (1.0 <= fx <= 1e6 and 1.0 <= fy <= 1e6 and 0.0 < cx < width and 0.0 < cy < height):
        what = f"{fx:g}, {fy:g}, {cx:g}, {cy:g} are no intrinsics of {width:g}x{height:g} px"
        raise CalibrationError(what, file=file, record="intrinsics", remedy=CALIBRATE)
    camera = PinholeCamera(float(fx), float(fy), float(cx), float(cy), int(width), int(height))
    return EurocCamera(_lens(settings, camera), settings.motion("T_BS"))


def find_rig(folder: Path) -> EurocRig:
    """The rectified pair of cam0 and cam1, whichever is the left one. Raises CalibrationError."""
    names, files = ("cam0", "cam1"), [folder / name / "sensor.yaml" for name in ("cam0", "cam1")]
    cameras = (read_camera(files[0]), read_camera(files[1]))
    T_first_second = se3.inverse(cameras[0].T_body_cam) @ cameras[1].T_body_cam
    if not is_left(T_first_second):
        names, cameras = ("cam1", "cam0"), (cameras[1], cameras[0])
        T_first_second = se3.inverse(T_first_second)
    baseline_m = float(np.linalg.norm(T_first_second[:3, 3]))
    if not BASELINES_M[0] <= baseline_m <= BASELINES_M[1]:
        what = f"a baseline of {baseline_m:g} m to {files[0].parent.name} is impossible"
        raise CalibrationError(what, file=files[1], record="T_BS", remedy="T_BS are metres, of each camera in the body's frame")
    if not stands_beside(T_first_second):
        x, y, z = T_first_second[:3, 3]
        what = f"{names[1]} stands at {x:.3f}, {y:.3f}, {z:.3f} m of {names[0]}, which is not beside it"
        raise CalibrationError(what, file=files[1], record="T_BS", remedy="a pair that looks the same way, side by side, is read")
    if not np.diag(T_first_second)[:3].min() > np.cos(np.pi / 4):
        what = f"{names[0]} and {names[1]} are turned against each other by more than 45°"
        raise CalibrationError(what, file=files[1], record="T_BS", remedy=CALIBRATE)
    return EurocRig(names, cameras, rectify_stereo(cameras[0].lens, cameras[1].lens, T_first_second, files[1]))


def _lens(settings: AslSettings, camera: PinholeCamera) -> LensCamera:
    model, bend = settings.text("camera_model"), settings.text("distortion_model").lower()
    if model != "pinhole":
        what = f"a camera model {quoted(model)}; known is pinhole"
        raise CalibrationError(what, file=settings.file, record="camera_model", remedy="calibrate the camera as a pinhole")
    if bend in RADIAL_TANGENTIAL:
        k1, k2, p1, p2, k3 = _coefficients(settings, 4, 5)
        return DistortedCamera(camera, (k1, k2, p1, p2, k3))
    if bend in EQUIDISTANT:
        a, b, c, d = _coefficients(settings, 4, 4)
        return FisheyeCamera(camera, (a, b, c, d))
    if bend == "none":
        return DistortedCamera(camera, (0.0,) * 5)
    what = f"a distortion model {quoted(bend)}; known are radial-tangential, equidistant and none"
    raise CalibrationError(what, file=settings.file, record="distortion_model", remedy="calibrate the camera with one of these")


def _coefficients(settings: AslSettings, least: int, most: int) -> list[float]:
    key = "distortion_coefficients"
    values = settings.numbers(key)
    if not least <= len(values) <= most or np.abs(values).max(initial=0.0) > LARGEST_DISTORTION:
        what = f"{len(values)} coefficients, the largest {np.abs(values).max(initial=0.0):g}, are no distortion"
        raise CalibrationError(what, file=settings.file, record=key, remedy=CALIBRATE)
    return [*values.tolist(), *[0.0] * (most - len(values))]


def _counted(settings: AslSettings, key: str, count: int) -> FloatArray:
    values = settings.numbers(key)
    if len(values) != count:
        what = f"{len(values)} numbers where {count} belong"
        raise CalibrationError(what, file=settings.file, record=key, remedy=CALIBRATE)
    return values
