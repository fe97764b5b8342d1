"""EuRoC/ASL writer, in the layout that `wayloom.logs.euroc.euroc_log` reads."""

import os
from pathlib import Path
from typing import Final

import numpy as np

from wayloom.files.atomic import write_atomically
from wayloom.geometry import se3
from wayloom.geometry.rectification import DistortedCamera, FisheyeCamera
from wayloom.logs.drive_writer import DriveWriter, FloatArray
from wayloom.logs.euroc.euroc_calibration import EurocCamera
from wayloom.logs.euroc.euroc_log import BODY
from wayloom.logs.euroc.euroc_tables import IMU_COLUMNS, POSE_COLUMNS

CAMERAS: Final = ("cam0", "cam1")
IMU, TRUTH = "imu0", "state_groundtruth_estimate0"
UNITS: Final = {"w": "[rad s^-1]", "a": "[m s^-2]", "p": "[m]", "q": "[]"}


class EurocWriter(DriveWriter):
    """`mav0` with cam0 (left), cam1 (right), imu0, state_groundtruth_estimate0; gnss.csv and wayloom.json beside it.

    The body's frame is the left camera's, so that nothing is rounded on the way, unless `cameras` says where the cameras sit in
    another and which lenses they have; the frames that are added are then as these lenses made them.
    """

    name_digits = 10
    holds_raw_images = True
    holds_partial_truth = True
    cameras: tuple[EurocCamera, EurocCamera] | None = None

    def image_folders(self) -> tuple[Path, Path]:
        """The folders of the left and the right images."""
        left, right = (self.folder / BODY / name / "data" for name in CAMERAS)
        return left, right

    def lidar_file(self, index: int) -> Path:
        """`mav0/lidar0`, which the format does not know."""
        return self.folder / BODY / "lidar0" / "data" / f"{index:010d}.bin"

    def write_calibration(self) -> None:
        """sensor.yaml of both cameras, and of the IMU where it is known."""
        for name, camera in zip(CAMERAS, self._cameras(), strict=True):
            self._write(name, "sensor.yaml", camera_text(camera))
        if self.imu is not None and self.T_cam_imu is not None:
            self._write(IMU, "sensor.yaml", motion_text("imu", self._cameras()[0].T_body_cam @ self.T_cam_imu))

    def write_times(self) -> None:
        """data.csv of both cameras. Images are named by their time stamps only now, for these come after the images."""
        for name, folder in zip(CAMERAS, self.image_folders(), strict=True):
            suffix = ".png" if self.jpeg_quality is None else ".jpg"
            rows = []
            for index, t_ns in enumerate(self.times_ns):
                stamped = folder / f"{t_ns}{suffix}"
                if not stamped.exists():  # else a run that was stopped here has done it
                    os.replace(folder / f"{index:0{self.name_digits}d}{suffix}", stamped)
                rows.append(f"{t_ns},{stamped.name}\n")
            self._write(name, "data.csv", "#timestamp [ns],filename\n" + "".join(rows))

    def write_truth(self) -> None:
        """Poses of the body at the frames' time stamps."""
        T_cam_body = se3.inverse(self._cameras()[0].T_body_cam)
        rows = [header_text(POSE_COLUMNS)]
        for t_ns, T_world_cam in zip(self.times_ns, self.truth, strict=True):
            T = T_world_cam @ T_cam_body
            if np.isfinite(T).all():
                rows.append(row_text(t_ns, np.concatenate([T[:3, 3], se3.quaternion_wxyz(T[None])[0]])))
        self._write(TRUTH, "data.csv", "".join(rows))
        self._write(TRUTH, "sensor.yaml", motion_text("visual-inertial", np.eye(4)))

    def write_positioning(self) -> None:
        """imu0; fixes into gnss.csv or oxts beside `mav0`, for which the format has no place."""
        imu, self.imu = self.imu, None
        super().write_positioning()
        self.imu = imu
        if imu is not None:
            samples = np.column_stack([imu.angular_rate, imu.specific_force])
            rows = [row_text(t_ns, values) for t_ns, values in zip(imu.t_ns.tolist(), samples, strict=True)]
            self._write(IMU, "data.csv", header_text(IMU_COLUMNS) + "".join(rows))

    def write_sidecar(self) -> None:
        """wayloom.json; of cameras that are yet to be rectified, imu0 alone says where the IMU is."""
        if self.cameras is not None:
            self.sidecar = self.sidecar.model_copy(update={"T_cam_imu": None})
        super().write_sidecar()

    def _cameras(self) -> tuple[EurocCamera, EurocCamera]:
        if self.cameras is not None:
            return self.cameras
        lens = DistortedCamera(self.rig.camera, self.distortion or (0.0,) * 5)
        T_left_right = se3.from_rotation_translation(np.eye(3), -np.array(self.rig.t_right_left))
        return EurocCamera(lens, np.eye(4)), EurocCamera(lens, T_left_right)

    def _write(self, folder: str, name: str, text: str) -> None:
        write_atomically(self.folder / BODY / folder / name, text.encode())


def camera_text(camera: EurocCamera) -> str:
    """A camera's sensor.yaml."""
    c, lens = camera.lens.camera, camera.lens
    is_fisheye = isinstance(lens, FisheyeCamera)
    bend: tuple[float, ...] = lens.distortion
    bend = bend[:4] if not any(bend[4:]) else bend  # k3 is rare, and other readers expect four
    return motion_text("camera", camera.T_body_cam) + (
        f"resolution: [{c.width}, {c.height}]\n"
        "camera_model: pinhole\n"
        f"intrinsics: {list_text(np.array([c.fx, c.fy, c.cx, c.cy]))}\n"
        f"distortion_model: {'equidistant' if is_fisheye else 'radial-tangential'}\n"
        f"distortion_coefficients: {list_text(np.array(bend))}\n"
    )


def motion_text(sensor_type: str, T_body_sensor: FloatArray) -> str:
    """What every sensor.yaml begins with."""
    data = list_text(T_body_sensor.ravel())
    return f"sensor_type: {sensor_type}\ncomment: written by wayloom\nT_BS:\n  cols: 4\n  rows: 4\n  data: {data}\n"


def list_text(values: FloatArray) -> str:
    """Numbers that are read back exactly."""
    return f"[{', '.join(repr(float(value)) for value in values)}]"


def header_text(columns: tuple[str, ...]) -> str:
    """The first line of a table."""
    return f"#timestamp [ns],{','.join(f'{name} {UNITS[name[0]]}' for name in columns)}\n"


def row_text(t_ns: int, values: FloatArray) -> str:
    """A line of a table, read back exactly."""
    return f"{t_ns},{','.join(repr(float(value)) for value in values)}\n"
