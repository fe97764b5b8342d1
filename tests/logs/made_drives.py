"""Small drives with known content, written by the product's own writers."""

from pathlib import Path

import numpy as np

from wayloom.geometry import se3
from wayloom.geometry.camera import PinholeCamera, StereoRig
from wayloom.logs.drive_writer import DriveWriter, ImageEncoding, SensorExtrinsics
from wayloom.logs.euroc.euroc_writer import EurocWriter
from wayloom.logs.kitti.kitti_360_writer import Kitti360Writer
from wayloom.logs.kitti.kitti_odometry_writer import KittiOdometryWriter
from wayloom.logs.kitti.kitti_raw_writer import KittiRawWriter
from wayloom.logs.ros2.mcap_writer import McapWriter
from wayloom.logs.sidecars.exposure_csv import write_exposure_csv
from wayloom.logs.sidecars.gnss_csv import write_gnss_csv
from wayloom.logs.sidecars.imu_csv import write_imu_csv
from wayloom.logs.sidecars.oxts_writer import OxtsPacket
from wayloom.logs.types import FixType, GnssTrack, ImuTrack, StereoFrame

FRAMES = 6
RIG = StereoRig(PinholeCamera(101.5, 102.5, 31.25, 20.75, 64, 40), (-0.5, 0.00275, -0.0015))
T_CAM_IMU = se3.from_rotation_translation(
    np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]), np.array([-0.3, 0.7, -1.1])
)
START_NS = 1_317_042_272_345_808_896
WRITERS: dict[str, tuple[type[DriveWriter], str]] = {
    "kitti-odometry": (KittiOdometryWriter, "07"),
    "euroc": (EurocWriter, "V9_01_made"),
    "kitti-360": (Kitti360Writer, "made_2031"),
    "mcap": (McapWriter, "recording"),
    "kitti-raw": (KittiRawWriter, "2031_01_02_drive_0007_sync"),
}


def made_frames(count: int, colour: bool) -> list[StereoFrame]:
    """Random pictures at about 10 Hz, with a hole of 0.2 s before frame FRAMES - 1."""
    rng = np.random.default_rng(7)
    shape = (40, 64, 3) if colour else (40, 64)
    times = START_NS + 100_000_001 * np.arange(count) + (np.arange(count) >= FRAMES - 1) * 200_000_000
    pictures = rng.integers(0, 256, (count, 2, *shape), dtype=np.uint8)
    return [StereoFrame(i, int(times[i]), pictures[i, 0], pictures[i, 1]) for i in range(count)]


def made_poses(count: int) -> np.ndarray:
    """(count, 4, 4): a metre forward and a little left each frame, the first at the origin."""
    step = se3.exp(np.array([0.0, 0.0, 1.0, 0.0, -0.02, 0.0]))
    poses = [np.eye(4)]
    while len(poses) < count:
        poses.append(poses[-1] @ step)
    return np.array(poses)


def made_packets(count: int) -> list[OxtsPacket]:
    """A fix 4 ms after each frame, of changing quality."""
    fixes = [FixType.FIXED, FixType.FLOAT, FixType.SINGLE, FixType.NONE]
    return [
        OxtsPacket(
            t_ns=frame.t_ns + 4_000_000,
            lon_lat_height=(8.39 + 1.1e-5 * i, 48.98 + 0.3e-5 * i, 116.25 + 0.01 * i),
            sigma_m=(0.02, 0.2, 1.5, 50.0)[i % 4],
            fix=fixes[i % 4],
            roll_pitch_yaw=(0.01, -0.02, 0.3),
            velocity_enu=(8.0, 3.0, 0.1),
        )
        for i, frame in enumerate(made_frames(count, colour=False))
    ]


def write_drive(folder: Path, log_format: str, *, colour: bool = True, count: int = FRAMES, gnss: bool = True) -> Path:
    """A drive of a format below `folder`; returns its own folder."""
    writer, name = WRITERS[log_format]
    with writer(
        folder / name,
        RIG,
        rig_id="rig-7",
        vehicle_id="car-7",
        extrinsics=SensorExtrinsics(T_cam_imu=T_CAM_IMU),
        encoding=ImageEncoding(colour=colour),
    ) as drive:
        for frame, T in zip(made_frames(count, colour), made_poses(count), strict=True):
            drive.add(frame, T)
        for packet in made_packets(count) if gnss else []:
            drive.add_gnss(packet)
    return folder / name


def track_file(file: Path) -> None:
    """A gnss.csv of one fix a frame of a made drive."""
    t_ns = np.array([frame.t_ns for frame in made_frames(FRAMES, colour=False)])
    place = np.tile([8.4, 49.0, 115.0], (FRAMES, 1))
    write_gnss_csv(file, GnssTrack(t_ns, place, np.tile(np.eye(3), (FRAMES, 1, 1)), np.full(FRAMES, 3, np.uint8)))


def made_imu(count: int = 40) -> ImuTrack:
    """Samples of 100 Hz from the first frame on."""
    rng = np.random.default_rng(9)
    return ImuTrack(START_NS + 10_000_000 * np.arange(count), rng.normal(0, 3, (count, 3)), rng.normal(0, 0.3, (count, 3)))


def sample_files(drive: Path) -> None:
    """An imu.csv and an exposure.csv in a made drive."""
    write_imu_csv(drive / "imu.csv", made_imu())
    write_exposure_csv(drive / "exposure.csv", np.random.default_rng(8).uniform(1e-3, 1e-2, (FRAMES, 2)))
