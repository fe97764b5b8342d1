"""KITTI-360 writer: images, poses, GNSS/INS packets, label images and LiDAR in the layout that `kitti_360*` reads."""

from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.files.atomic import link_or_copy, write_atomically
from wayloom.files.timestamps import wall_clock_from_ns
from wayloom.geometry import se3
from wayloom.logs.drive_writer import DriveWriter, FloatArray, encoded_map, numbers_text, projection_texts
from wayloom.logs.images.image_files import read_image
from wayloom.logs.kitti.accumulation import Scan, accumulate
from wayloom.logs.kitti.kitti_360 import CAM0_TO_WORLD, POSES, R_UNIT_POSE
from wayloom.logs.kitti.kitti_360_clouds import CAM_TO_POSE, CAM_TO_VELO, PERSPECTIVE, read_scan
from wayloom.logs.kitti.kitti_360_labels import instance_numbers, label_ids
from wayloom.logs.kitti.kitti_360_layout import CAMERAS, SCAN_FOLDER, Sequence
from wayloom.logs.kitti.kitti_raw_writer import R_CAM_VELO

LABEL_KINDS: Final = ("semantic", "instance")
FISHEYES: Final = ("image_02", "image_03")
"""KITTI-360's cameras to both sides: its own tools read no calibration without their places. There are no such images here, so the
lines repeat those of the stereo pair."""
IDENTITY: Final = numbers_text(np.eye(3))


class Kitti360Writer(DriveWriter):
    """KITTI-360's root with one sequence, `<name>_sync` after the folder's name. Images are rectified (R_rect is the identity) and
    the left one is camera 0. Poses are written as they are given: their world is the data's world.

    `write_labels` and the labels of `write_lidar` make data_2d_semantics and data_3d_semantics. gnss.csv, imu.csv and wayloom.json
    lie beside the poses.
    """

    name_digits = 10
    wants_packets = True
    has_labels = True

    @property
    def sequence(self) -> Sequence:
        """The sequence below the folder in which the drive is written."""
        return Sequence(self.folder, f"{self.path.name}_sync")

    def image_folders(self) -> tuple[Path, Path]:
        """The folders of the left and the right images."""
        left, right = (self.sequence.images / camera / "data_rect" for camera in CAMERAS)
        return left, right

    def lidar_file(self, index: int) -> Path:
        """`velodyne_points/data`."""
        return self.sequence.scan(index)

    def oxts_folder(self) -> Path:
        """The folder of the packets, beside the poses."""
        return self.sequence.poses / "oxts"

    def sidecar_folder(self) -> Path:
        """The folder of the sidecars, beside the poses."""
        return self.sequence.poses

    def write_labels(self, index: int, side: int, class_id: NDArray[np.uint8], instances: NDArray[np.integer]) -> None:
        """Write class_id (h, w) train ids and instances (h, w), from 1 on, 0 for none, of the left (0) or right (1) image."""
        ids = label_ids(class_id)
        for kind, image in (("semantic", ids), ("instance", instance_numbers(ids, instances).astype(np.uint16))):
            write_atomically(self.sequence.label_image(kind, index, side), encoded_map(image))

    def repeat(self, index: int, source: int) -> None:
        """As in `DriveWriter`, with the label images and scan labels."""
        super().repeat(index, source)
        for kind in LABEL_KINDS:
            for side in (0, 1):
                old, new = (self.sequence.label_image(kind, frame, side) for frame in (source, index))
                if old.is_file():
                    link_or_copy(old, new)

    def write_lidar(
        self,
        index: int,
        points: NDArray[np.float32],
        class_id: NDArray[np.uint8] | None = None,
        instances: NDArray[np.integer] | None = None,
        moving: NDArray[np.bool_] | None = None,
    ) -> None:
        """As in `DriveWriter`; labels are kept in the spool until the clouds are accumulated."""
        super().write_lidar(index, points)
        if class_id is not None and instances is not None and moving is not None:
            labels = np.column_stack([class_id, instances, moving]).astype("<u4")
            write_atomically(self._labels_of_scan(index), labels.tobytes())

    def write_calibration(self) -> None:
        """perspective.txt, calib_cam_to_pose.txt (where the IMU's place is known, else the camera's own), calib_cam_to_velo.txt."""
        camera = self.rig.camera
        size = f"{camera.width} {camera.height}"
        lines = [
            f"S_rect_{i:02d}: {size}\nR_rect_{i:02d}: {IDENTITY}\nP_rect_{i:02d}: {P}\n"
            for i, P in enumerate(projection_texts(self.rig))
        ]
        self._write(PERSPECTIVE, "".join(lines))
        T_right_left = se3.from_rotation_translation(np.eye(3), np.array(self.rig.t_right_left))
        left = self.T_pose_cam()
        pair = (left, left @ se3.inverse(T_right_left))
        cameras = zip((*CAMERAS, *FISHEYES), (*pair, *pair), strict=True)
        self._write(CAM_TO_POSE, "".join(f"{name}: {numbers_text(T[:3])}\n" for name, T in cameras))
        if self.T_cam_lidar is not None:
            self._write(CAM_TO_VELO, numbers_text(se3.inverse(self.T_cam_lidar)[:3]) + "\n")

    def T_pose_cam(self) -> FloatArray:
        """(4, 4): the left camera in the unit's frame of poses.txt (x forward, y right, z down)."""
        T_cam_unit = se3.from_rotation_translation(R_CAM_VELO, np.zeros(3)) if self.T_cam_imu is None else self.T_cam_imu
        T_cam_pose = T_cam_unit @ se3.from_rotation_translation(R_UNIT_POSE, np.zeros(3))
        return np.asarray(se3.inverse(T_cam_pose))

    def write_times(self) -> None:
        """Write the time stamps of both cameras, and of the scans, as wall clock since 1970."""
        text = "".join(wall_clock_from_ns(t) + "\n" for t in self.times_ns).encode()
        for camera in CAMERAS:
            write_atomically(self.sequence.images / camera / "timestamps.txt", text)
        if self.T_cam_lidar is not None:
            write_atomically(self.sequence.scans / SCAN_FOLDER / "timestamps.txt", text)

    def write_truth(self) -> None:
        """cam0_to_world.txt, poses.txt, and the accumulated clouds where scans have labels."""
        T_cam_pose = se3.inverse(self.T_pose_cam())
        for name, rows, poses in ((CAM0_TO_WORLD, 4, self.truth), (POSES, 3, [T @ T_cam_pose for T in self.truth])):
            lines = (f"{frame} {numbers_text(T[:rows])}\n" for frame, T in enumerate(poses))
            write_atomically(self.sequence.poses / name, "".join(lines).encode())
        if self.T_cam_lidar is not None:
            accumulate(self.sequence, np.array(self.truth), self._scan)

    def _scan(self, index: int) -> Scan | None:
        """A labelled scan and what the left camera saw, None where the frame has none."""
        file = self._labels_of_scan(index)
        if not file.is_file() or self.T_cam_lidar is None:
            return None
        labels = np.frombuffer(file.read_bytes(), "<u4").reshape(-1, 3)
        points = read_scan(self.lidar_file(index))[:, :3].astype(np.float64)
        p_cam = points @ self.T_cam_lidar[:3, :3].T + self.T_cam_lidar[:3, 3]
        ids = label_ids(labels[:, 0].astype(np.uint8))
        image = read_image(self.image_files(index)[0], colour=True)
        colours, visible = coloured(p_cam, image, self.rig.camera.K)
        return Scan(p_cam, colours, visible, ids, instance_numbers(ids, labels[:, 1]), labels[:, 2] > 0)

    def _labels_of_scan(self, index: int) -> Path:
        return self.spool / "scan-labels" / f"{index:010d}.bin"

    def _write(self, name: str, text: str) -> None:
        write_atomically(self.sequence.calibration(name), text.encode())


def coloured(p_cam: FloatArray, image: NDArray[np.uint8], K: FloatArray) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """(N, 3) RGB of the pixels in which points (N, 3) of the camera's frame lie, black outside; (N,) whether they lie inside."""
    inside = p_cam[:, 2] > 0.1
    uv = p_cam[:, :2] / np.where(inside, p_cam[:, 2], 1.0)[:, None] * K[[0, 1], [0, 1]] + K[:2, 2]
    u, v = (np.rint(np.where(inside, uv[:, k], -1.0)).astype(np.int64) for k in (0, 1))
    height, width = image.shape[:2]
    inside &= (u >= 0) & (u < width) & (v >= 0) & (v < height)
    colours = np.zeros((len(p_cam), 3), np.uint8)
    colours[inside] = image[v[inside], u[inside]]
    return colours, inside
