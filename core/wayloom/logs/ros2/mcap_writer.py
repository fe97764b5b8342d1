"""MCAP writer: a drive as a ROS 2 recording, with the topics and message types that robots record.

/camera/{left,right}/image_rect_color/compressed   sensor_msgs/CompressedImage (image_raw/compressed where images are distorted,
                                                   image_rect where they are grey)
/camera/{left,right}/camera_info                   sensor_msgs/CameraInfo, one an image
/camera/{left,right}/exposure                      wayloom_msgs/Exposure, where exposure times are known
/gnss/fix, /imu/data, /lidar/points                sensor_msgs/NavSatFix, Imu, PointCloud2
/tf_static                                         where antenna, IMU and LiDAR sit in the left camera's frame
/truth/left_camera                                 geometry_msgs/PoseStamped in the frame "world"
"""

import heapq
import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final

import numpy as np
from mcap.writer import CompressionType, Writer

from wayloom.files.atomic import UMASK, UNFINISHED, write_atomically
from wayloom.geometry import se3
from wayloom.logs.drive_writer import SIDES, DriveWriter, FloatArray
from wayloom.logs.kitti.kitti_360_clouds import read_scan
from wayloom.logs.ros2 import ros_messages as ros
from wayloom.logs.ros2.ros_messages import CameraInfo, Fix, Header, Transform
from wayloom.logs.sidecars.oxts import UP_FACTOR
from wayloom.logs.sidecars.oxts_writer import OxtsPacket
from wayloom.logs.types import FixType, GnssTrack

ENDING: Final = ".mcap"
METADATA, METADATA_VERSION = "metadata.yaml", 5
CHUNK_BYTES: Final = 4 << 20
LEFT_FRAME, RIGHT_FRAME, IMU_FRAME, GNSS_FRAME, LIDAR_FRAME, WORLD_FRAME = (
    "left_camera",
    "right_camera",
    "imu",
    "gnss",
    "lidar",
    "world",
)
STATUS_OF_FIX: Final = {
    FixType.NONE: ros.NO_FIX, FixType.SINGLE: ros.PLAIN_FIX, FixType.FLOAT: ros.GROUND_AUGMENTED_FIX,
    FixType.FIXED: ros.GROUND_AUGMENTED_FIX,
}  # fmt: skip
Message = tuple[int, int, str, str, bytes]
"""Time ns, rank among messages of one time, topic, type, bytes."""


def metadata(file: str, first_ns: int, last_ns: int, counts: Mapping[tuple[str, str], int]) -> bytes:
    """rosbag2's metadata.yaml of a recording of one file, by which its tools open the folder; JSON is YAML, too.

    counts : messages of each topic and type
    """
    about = {"starting_time": {"nanoseconds_since_epoch": first_ns}, "duration": {"nanoseconds": last_ns - first_ns}}
    topics = [
        {
            "topic_metadata": {"name": topic, "type": kind, "serialization_format": "cdr", "offered_qos_profiles": ""},
            "message_count": count,
        }
        for (topic, kind), count in sorted(counts.items())
    ]
    whole = {"version": METADATA_VERSION, "storage_identifier": "mcap", **about, "message_count": sum(counts.values())}
    whole |= {"topics_with_message_count": topics, "compression_format": "", "compression_mode": "", "relative_file_paths": [file]}
    whole["files"] = [{"path": file, **about, "message_count": sum(counts.values())}]
    return (json.dumps({"rosbag2_bagfile_information": whole}, indent=1) + "\n").encode()


class McapWriter(DriveWriter):
    """A folder with `<name>.mcap`, rosbag2's metadata.yaml and wayloom.json.

    Images stay in the spool until all messages are written in order of time.
    """

    name_digits = 10
    holds_raw_images = True
    holds_partial_truth = True

    def image_folders(self) -> tuple[Path, Path]:
        """The folders of the left and the right images, in the spool."""
        return self.spool / "left", self.spool / "right"

    def lidar_file(self, index: int) -> Path:
        """Path of the scan of a frame, in the spool."""
        return self.spool / "lidar" / f"{index:010d}.bin"

    def write_calibration(self) -> None:
        """Nothing: calibration is in the messages."""
        return

    def write_times(self) -> None:
        """Nothing: time stamps are in the messages."""
        return

    def write_truth(self) -> None:
        """Nothing: true poses are in the messages."""
        return

    def write_positioning(self) -> None:
        """Write the recording, whose messages are complete by now."""
        file = self.folder / f"{self.path.name}{ENDING}"
        unfinished = file.with_name(UNFINISHED + file.name)
        try:
            with unfinished.open("wb") as stream:
                writer = Writer(
                    stream, chunk_size=CHUNK_BYTES, compression=CompressionType.NONE, enable_data_crcs=False, use_statistics=True
                )
                writer.start(profile="ros2", library="wayloom")
                channels: dict[str, int] = {}
                counts: dict[tuple[str, str], int] = {}
                first_ns = last_ns = self.times_ns[0]
                for sequence, (t_ns, _, topic, kind, data) in enumerate(heapq.merge(*self._streams())):
                    if topic not in channels:
                        schema = writer.register_schema(kind, "ros2msg", ros.schema(kind).encode())
                        channels[topic] = writer.register_channel(topic, "cdr", schema)
                    writer.add_message(channels[topic], t_ns, data, t_ns, sequence)
                    counts[topic, kind] = counts.get((topic, kind), 0) + 1
                    first_ns, last_ns = min(first_ns, t_ns), max(last_ns, t_ns)
                writer.finish()
            unfinished.chmod(0o666 & ~UMASK)
            os.replace(unfinished, file)
            write_atomically(self.folder / METADATA, metadata(file.name, first_ns, last_ns, counts))
        except OSError as problem:
            unfinished.unlink(missing_ok=True)
            raise OSError(problem.errno, problem.strerror, str(file)) from problem

    def _streams(self) -> Iterator[Iterator[Message]]:
        """Messages of each kind in the order of time."""
        yield iter([(self.times_ns[0], 0, "/tf_static", ros.TRANSFORMS, ros.transforms(self.times_ns[0], self._transforms()))])
        yield self._frames()
        track = self.gnss if self.gnss is not None else track_of(self.packets)
        if track is not None:
            yield self._fixes(track)
        if self.imu is not None:
            samples = zip(self.imu.t_ns.tolist(), self.imu.specific_force, self.imu.angular_rate, strict=True)
            yield ((t, 7, "/imu/data", ros.IMU, ros.imu_sample(Header(t, IMU_FRAME), force, rate)) for t, force, rate in samples)

    def _transforms(self) -> list[Transform]:
        """Antenna, IMU and LiDAR in the left camera's frame, as far as they are known."""
        out = []
        if self.sidecar.p_cam_gnss_m is not None:
            T = se3.from_rotation_translation(np.eye(3), np.array(self.sidecar.p_cam_gnss_m))
            out.append(Transform(LEFT_FRAME, GNSS_FRAME, T))
        for name, known in ((IMU_FRAME, self.T_cam_imu), (LIDAR_FRAME, self.T_cam_lidar)):
            if known is not None:
                out.append(Transform(LEFT_FRAME, name, known))
        return out

    def _frames(self) -> Iterator[Message]:
        kind = "jpeg" if self.jpeg_quality is not None else "png"
        image_topic = "image_raw" if self.distortion is not None else "image_rect_color" if self.colour else "image_rect"
        for index, t_ns in enumerate(self.times_ns):
            for side, file in enumerate(self.image_files(index)):
                header, base = Header(t_ns, (LEFT_FRAME, RIGHT_FRAME)[side]), f"/camera/{SIDES[side]}"
                yield t_ns, 1, f"{base}/camera_info", ros.CAMERA_INFO, ros.camera_info(self._info(header, side))
                image = ros.compressed_image(header, kind, file.read_bytes())
                yield t_ns, 2, f"{base}/{image_topic}/compressed", ros.COMPRESSED, image
                if self.exposure_s is not None:
                    exposed = ros.exposure(header, float(self.exposure_s[index, side]))
                    yield t_ns, 3, f"{base}/exposure", ros.EXPOSURE, exposed
            if self.truth and np.isfinite(self.truth[index]).all():
                yield t_ns, 4, "/truth/left_camera", ros.POSE, ros.pose_stamped(Header(t_ns, WORLD_FRAME), self.truth[index])
            if (scan := self.lidar_file(index)).is_file():
                yield t_ns, 5, "/lidar/points", ros.POINT_CLOUD, ros.point_cloud(Header(t_ns, LIDAR_FRAME), read_scan(scan))

    def _info(self, header: Header, side: int) -> CameraInfo:
        camera = self.rig.camera
        t = np.zeros(3) if side == 0 else np.array(self.rig.t_right_left)
        P: FloatArray = np.column_stack([camera.K, camera.K @ t])
        d = np.array(self.distortion or (0.0,) * 5)
        return CameraInfo(header, camera.width, camera.height, "plumb_bob", d, camera.K, np.eye(3), P)

    def _fixes(self, track: GnssTrack) -> Iterator[Message]:
        frame = IMU_FRAME if self.sidecar.p_cam_gnss_m is None else GNSS_FRAME  # packets tell the place of their unit
        rows = zip(track.t_ns.tolist(), track.lon_lat_height, track.covariance_enu, track.fix_type.tolist(), strict=True)
        for t_ns, place, covariance, kind in rows:
            fix = Fix(Header(t_ns, frame), STATUS_OF_FIX[FixType(kind)], place, covariance, ros.KNOWN)
            yield t_ns, 6, "/gnss/fix", ros.NAV_SAT_FIX, ros.nav_sat_fix(fix)


def track_of(packets: list[OxtsPacket]) -> GnssTrack | None:
    """The fixes of GNSS/INS packets; None where there are none."""
    if not packets:
        return None
    covariances = [packet.sigma_m**2 * np.diag((1.0, 1.0, UP_FACTOR**2)) for packet in packets]
    return GnssTrack(
        np.array([packet.t_ns for packet in packets], np.int64),
        np.array([packet.lon_lat_height for packet in packets]),
        np.array(covariances),
        np.array([packet.fix for packet in packets], np.uint8),
    )
