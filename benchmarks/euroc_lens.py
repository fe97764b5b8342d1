"""A rectified drive seen through the EuRoC vehicle's lenses, tracked beside the drive itself.

    python benchmarks/euroc_lens.py LOG --out FOLDER [--frames N]

Each image is bent as two different lenses would have recorded it, by cameras that are turned against each other in a body frame
that looks elsewhere, and written as an EuRoC folder; the reader has to undo all of it. Both logs are tracked, and the error of
each against the truth is printed.
"""

import argparse
import time
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.geometry.camera import PinholeCamera
from wayloom.geometry.rectification import DistortedCamera, distorted_rays
from wayloom.logs.conversion import convert_log
from wayloom.logs.drive_writer import ImageEncoding, SensorExtrinsics
from wayloom.logs.euroc.euroc_calibration import EurocCamera
from wayloom.logs.euroc.euroc_writer import EurocWriter
from wayloom.logs.registry import open_log
from wayloom.logs.types import DriveLog
from wayloom.odometry.odometry import track
from wayloom.odometry.settings import OdometrySettings

FloatArray = NDArray[np.float64]
BENDS = ((-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05, 0.0), (-0.28368365, 0.07451284, -0.00010473, -3.5559e-05, 0.0))
TURNS_RAD = ((0.004, -0.011, 0.015), (-0.006, 0.009, -0.012))
T_BODY_CAM = se3.exp(np.array([-0.0216, -0.0647, 0.0098, 0.3, -0.4, 1.5]))
NARROWER = np.linspace(1.0, 2.0, 101)


def main() -> None:
    """Bend, write, read, track, compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("log", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--frames", type=int, default=120)
    arguments = parser.parse_args()
    log = open_log(arguments.log)
    bent = arguments.out / "bent"
    if not bent.exists():
        write_bent(log, bent, min(arguments.frames, len(log)))
    straight = arguments.out / "straight"
    if not straight.exists():
        convert_log(First(log, min(arguments.frames, len(log))), straight, "kitti")
    for name in (straight, bent):
        report(open_log(name))


class First:
    """The first frames of a log."""

    def __init__(self, log: DriveLog, count: int) -> None:
        self._log, self._count = log, count
        self.t_ns = log.t_ns[:count]
        self.truth = None if log.truth is None else log.truth[:count]

    def __getattr__(self, name: str) -> object:
        return getattr(self._log, name)

    def __len__(self) -> int:
        return self._count

    def frames(self, start: int = 0, stop: int | None = None) -> object:
        """The pairs in order."""
        return self._log.frames(start, self._count if stop is None else min(stop, self._count))


def write_bent(log: DriveLog, out: Path, count: int) -> None:
    """The log's first frames as an EuRoC folder of bent images."""
    cameras = bent_cameras(log)
    t_left_cam_m = [np.zeros(3), -np.array(log.rig.t_right_left)]
    maps = []
    for lens, R in cameras:
        u, v = source_pixels(log.rig.camera, lens, R)
        maps.append((u.astype(np.float32), v.astype(np.float32)))
    sensors = SensorExtrinsics(T_cam_imu=None if log.T_cam_imu is None else turn(cameras[0][1].T) @ log.T_cam_imu)
    with EurocWriter(out, log.rig, rig_id=log.rig_id, extrinsics=sensors, encoding=ImageEncoding(colour=log.colour)) as writer:
        left, right = (
            EurocCamera(lens, T_BODY_CAM @ se3.from_rotation_translation(R, t))
            for (lens, R), t in zip(cameras, t_left_cam_m, strict=True)
        )
        writer.cameras = left, right
        for frame in log.frames(0, count):
            sides = [
                cv2.remap(image, *pair, cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REPLICATE)
                for image, pair in zip((frame.left, frame.right), maps, strict=True)
            ]
            writer.write_images(frame.index, *sides)
            writer.count(frame.t_ns, None if log.truth is None else log.truth[frame.index] @ turn(cameras[0][1]))
        if log.imu is not None:
            writer.set_imu(log.imu)


def bent_cameras(log: DriveLog) -> list[tuple[DistortedCamera, FloatArray]]:
    """Lens and R_rect_cam (3, 3) of both cameras: as wide as the log's images allow."""
    c = log.rig.camera
    out = []
    for bend, angles in zip(BENDS, TURNS_RAD, strict=True):
        R = se3.exp(np.array([0.0, 0.0, 0.0, *angles]))[:3, :3]
        for factor in NARROWER:
            lens = DistortedCamera(
                PinholeCamera(factor * c.fx, 0.997 * factor * c.fy, c.cx - 2.0, c.cy + 1.5, c.width, c.height), bend
            )
            u, v = source_pixels(c, lens, R)
            if np.isfinite(u).all() and u.min() >= 0 and v.min() >= 0 and u.max() <= c.width - 1 and v.max() <= c.height - 1:
                break
        out.append((lens, R))
    return out


def source_pixels(rectified: PinholeCamera, lens: DistortedCamera, R: FloatArray) -> tuple[FloatArray, FloatArray]:
    """u and v (h, w) in the rectified image of what each pixel of the lens's image sees."""
    v, u = np.mgrid[0 : lens.camera.height, 0 : lens.camera.width].astype(np.float64)
    rays = distorted_rays(np.column_stack([u.ravel(), v.ravel()]), lens) @ R.T
    uv = rectified.project(rays).reshape(*u.shape, 2)
    return uv[..., 0], uv[..., 1]


def turn(R: FloatArray) -> FloatArray:
    """A rotation (3, 3) as a motion."""
    return np.asarray(se3.from_rotation_translation(R, np.zeros(3)))


def report(log: DriveLog) -> None:
    """Track a log and print its error against its truth."""
    began = time.process_time()
    trajectory = track(log, OdometrySettings()).trajectory
    cpu_s = time.process_time() - began
    assert log.truth is not None
    T, truth = (se3.inverse(poses[0]) @ poses for poses in (trajectory.T_world_cam, log.truth))
    road_m = float(np.linalg.norm(np.diff(truth[:, :3, 3], axis=0), axis=1).sum())
    off = np.linalg.norm(T[:, :3, 3] - truth[:, :3, 3], axis=1)
    angle = [np.linalg.norm(se3.log(se3.inverse(a) @ b)[3:]) for a, b in zip(T, truth, strict=True)]
    print(
        f"{log.format:16s} fx {log.rig.camera.fx:6.1f}  tracked {int(trajectory.tracked.sum())} of {len(log)}  road {road_m:6.1f} m"
        f"  off at the end {off[-1]:.3f} m ({100 * off[-1] / road_m:.2f} %), worst {off.max():.3f} m"
        f"  turned {np.degrees(angle[-1]):.3f}°, worst {np.degrees(max(angle)):.3f}°  {cpu_s:.0f} CPU s"
    )


if __name__ == "__main__":
    main()
