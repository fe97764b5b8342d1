"""KITTI odometry writer, in the layout that `wayloom.logs.kitti.kitti_odometry` reads."""

from pathlib import Path

from wayloom.files.atomic import write_atomically
from wayloom.files.timestamps import seconds_from_ns
from wayloom.logs.drive_writer import DriveWriter, numbers_text, projection_texts


class KittiOdometryWriter(DriveWriter):
    """`image_2/image_3` (colour) or `image_0/image_1` (grey), calib.txt, times.txt, poses.txt, oxts, wayloom.json.

    The left camera is KITTI's reference camera, so that poses.txt are its own poses.
    """

    name_digits = 6

    def image_folders(self) -> tuple[Path, Path]:
        """The folders of the left and the right images."""
        left, right = ("image_2", "image_3") if self.colour else ("image_0", "image_1")
        return self.folder / left, self.folder / right

    def lidar_file(self, index: int) -> Path:
        """`velodyne`, as SemanticKITTI has it."""
        return self.folder / "velodyne" / f"{index:06d}.bin"

    def write_calibration(self) -> None:
        """Write all four projection matrices (cameras 0 and 2 are the left one, 1 and 3 the right) and Tr, LiDAR to camera 0."""
        left, right = projection_texts(self.rig)
        text = "".join(f"P{camera}: {P}\n" for camera, P in enumerate((left, right, left, right)))
        if self.T_cam_lidar is not None:
            text += f"Tr: {numbers_text(self.T_cam_lidar[:3])}\n"
        write_atomically(self.folder / "calib.txt", text.encode())

    def write_times(self) -> None:
        """Write seconds with nine decimals, exact."""
        write_atomically(self.folder / "times.txt", "".join(seconds_from_ns(t) + "\n" for t in self.times_ns).encode())
