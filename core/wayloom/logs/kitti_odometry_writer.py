"""Writing a drive in the KITTI odometry layout: what `wayloom.logs.kitti_odometry` reads."""

from pathlib import Path

from wayloom.logs.drive_writer import DriveWriter, projection_texts
from wayloom.logs.timestamps import seconds_from_ns


class KittiOdometryWriter(DriveWriter):
    """`image_2/image_3` (colour) or `image_0/image_1` (grey), calib.txt, times.txt, poses.txt, oxts, wayloom.json.

    The left camera is KITTI's reference camera, so that poses.txt are its own poses.
    """

    name_digits = 6

    def image_folders(self) -> tuple[Path, Path]:
        """Left and right."""
        left, right = ("image_2", "image_3") if self.colour else ("image_0", "image_1")
        return self.folder / left, self.folder / right

    def write_calibration(self) -> None:
        """All four projection matrices: cameras 0 and 2 are the left one, 1 and 3 the right."""
        left, right = projection_texts(self.rig)
        text = "".join(f"P{camera}: {P}\n" for camera, P in enumerate((left, right, left, right)))
        (self.folder / "calib.txt").write_text(text, encoding="ascii")

    def write_times(self) -> None:
        """Seconds with nine decimals, exact."""
        (self.folder / "times.txt").write_text("".join(seconds_from_ns(t) + "\n" for t in self.times_ns), encoding="ascii")
