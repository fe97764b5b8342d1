"""KITTI raw writer (`…_sync`), in the layout that `wayloom.logs.kitti.kitti_raw` reads."""

from pathlib import Path

import numpy as np

from wayloom.files.atomic import write_atomically
from wayloom.files.timestamps import wall_clock_from_ns
from wayloom.geometry import se3
from wayloom.logs.drive_writer import DriveWriter, FloatArray, numbers_text, projection_texts
from wayloom.logs.kitti.kitti_calibration import CAM_TO_CAM, IMU_TO_VELO, VELO_TO_CAM
from wayloom.logs.kitti.kitti_raw import DISTORTED_ENDING

R_CAM_VELO = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
"""x forward, y left, z up into x right, y down, z forward."""
IDENTITY = numbers_text(np.eye(3))


class KittiRawWriter(DriveWriter):
    """`image_02/image_03` (colour) or `image_00/image_01` (grey) with data and timestamps.txt, the calibration files, oxts,
    wayloom.json, and poses.txt, which KITTI raw itself has not. Images are rectified; the left camera is the reference."""

    name_digits = 10
    wants_packets = True
    holds_raw_images = True

    @classmethod
    def folder_name(cls, name: str, distorted: bool) -> str:
        """The name with an ending by which the reader tells distorted images from rectified ones of the same size."""
        return name + DISTORTED_ENDING if distorted else name

    def image_folders(self) -> tuple[Path, Path]:
        """The folders of the left and the right images."""
        left, right = ("image_02", "image_03") if self.colour else ("image_00", "image_01")
        return self.folder / left / "data", self.folder / right / "data"

    def lidar_file(self, index: int) -> Path:
        """`velodyne_points/data`."""
        return self.folder / "velodyne_points" / "data" / f"{index:010d}.bin"

    def write_calibration(self) -> None:
        """calib_cam_to_cam.txt; calib_velo_to_cam.txt and calib_imu_to_velo.txt where the LiDAR or the IMU is known."""
        camera = self.rig.camera
        size, lens = f"{camera.width} {camera.height}", numbers_text(camera.K)
        lens_bend = numbers_text(np.array(self.distortion or (0.0,) * 5))
        lines = []
        for i, P in enumerate(projection_texts(self.rig) * 2):
            t = (0.0, 0.0, 0.0) if i % 2 == 0 else self.rig.t_right_left
            lines += [f"S_{i:02d}: {size}", f"K_{i:02d}: {lens}", f"D_{i:02d}: {lens_bend}", f"R_{i:02d}: {IDENTITY}"]
            lines += [f"T_{i:02d}: {numbers_text(np.array(t))}", f"S_rect_{i:02d}: {size}"]
            lines += [f"R_rect_{i:02d}: {IDENTITY}", f"P_rect_{i:02d}: {P}"]
        self._write(CAM_TO_CAM, "\n".join(lines) + "\n")
        T_cam_velo = se3.from_rotation_translation(R_CAM_VELO, np.zeros(3)) if self.T_cam_lidar is None else self.T_cam_lidar
        if self.T_cam_lidar is not None or self.T_cam_imu is not None:
            self._write(VELO_TO_CAM, rigid_text(T_cam_velo))
        if self.T_cam_imu is not None:
            self._write(IMU_TO_VELO, rigid_text(se3.inverse(T_cam_velo) @ self.T_cam_imu))

    def write_times(self) -> None:
        """Write the time stamps of both cameras, and of the scans, as wall clock since 1970."""
        text = "".join(wall_clock_from_ns(t) + "\n" for t in self.times_ns)
        folders = [folder.parent for folder in self.image_folders()]
        for folder in (*folders, *([self.folder / "velodyne_points"] if self.T_cam_lidar is not None else [])):
            write_atomically(folder / "timestamps.txt", text.encode())

    def _write(self, name: str, text: str) -> None:
        write_atomically(self.folder / name, text.encode())


def rigid_text(T: FloatArray) -> str:
    """A motion (4, 4) as KITTI's R and T lines."""
    return f"R: {numbers_text(T[:3, :3])}\nT: {numbers_text(T[:3, 3])}\n"
