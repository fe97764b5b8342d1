"""What an independent implementation of ROS 2's formats makes of our recordings, and we of its."""

import json
import re
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from logs.made_drives import FRAMES, RIG, T_CAM_IMU, made_frames, made_imu, made_packets, made_poses
from wayloom.geometry import se3
from wayloom.logs.drive_writer import SensorExtrinsics
from wayloom.logs.registry import open_log
from wayloom.logs.ros2.mcap_writer import McapWriter, metadata


def test_others_decode_every_message_that_we_write(tmp_path: Path) -> None:
    frames, packets, imu = made_frames(FRAMES, True), made_packets(FRAMES), made_imu()
    with McapWriter(tmp_path / "drive", RIG, extrinsics=SensorExtrinsics(T_cam_imu=T_CAM_IMU, T_cam_lidar=np.eye(4))) as drive:
        for frame, T in zip(frames, made_poses(FRAMES), strict=True):
            drive.add(frame, T)
        for packet in packets:
            drive.add_gnss(packet)
        drive.set_imu(imu)
        drive.set_exposures(np.full((FRAMES, 2), 0.004))
        scan = np.random.default_rng(0).normal(size=(50, 4)).astype(np.float32)
        drive.write_lidar(0, scan)
    store, found = get_typestore(Stores.EMPTY), dict[str, list[object]]()
    with (tmp_path / "drive" / "drive.mcap").open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            assert schema is not None
            if schema.name not in store.fielddefs:
                types = get_types_from_msg(schema.data.decode(), schema.name)
                store.register({name: fields for name, fields in types.items() if name not in store.fielddefs})
            found.setdefault(channel.topic, []).append(store.deserialize_cdr(message.data, schema.name))
    assert len(found) == 11
    info = found["/camera/right/camera_info"][0]
    np.testing.assert_allclose(info.p[[3, 7, 11]], RIG.camera.K @ RIG.t_right_left)
    assert (info.width, info.height, info.distortion_model) == (64, 40, "plumb_bob")
    fix, sample, cloud = found["/gnss/fix"][1], found["/imu/data"][7], found["/lidar/points"][0]
    assert [fix.longitude, fix.latitude, fix.altitude] == list(packets[1].lon_lat_height)
    assert (fix.status.status, fix.position_covariance[0]) == (2, packets[1].sigma_m ** 2)
    acceleration = sample.linear_acceleration
    assert [acceleration.x, acceleration.y, acceleration.z] == imu.specific_force[7].tolist()
    assert sample.header.stamp.sec * 10**9 + sample.header.stamp.nanosec == imu.t_ns[7]
    np.testing.assert_array_equal(np.frombuffer(cloud.data, "<f4").reshape(-1, 4), scan)
    assert [point_field.name for point_field in cloud.fields] == ["x", "y", "z", "intensity"]
    assert found["/camera/left/exposure"][2].exposure_s == 0.004
    place = found["/tf_static"][0].transforms[0]
    assert (place.header.frame_id, place.child_frame_id) == ("left_camera", "imu")
    t = place.transform.translation
    np.testing.assert_allclose([t.x, t.y, t.z], T_CAM_IMU[:3, 3])


def test_the_page_of_formats_names_every_member_of_the_metadata() -> None:
    page = (Path(__file__).resolve().parents[3] / "docs" / "formats.md").read_text(encoding="utf-8")
    told = page.split("lies `metadata.yaml`")[1].split("\n### ")[0]
    ((name, whole),) = json.loads(metadata("a.mcap", 1, 2, {("/a", "b"): 1})).items()
    assert {*re.findall(r"`([a-z_0-9]+)`", told)} >= {name, *whole}


def test_others_open_the_folder_of_a_recording_by_its_metadata(tmp_path: Path) -> None:
    with McapWriter(tmp_path / "drive", RIG) as drive:
        for frame, T in zip(made_frames(FRAMES, True), made_poses(FRAMES), strict=True):
            drive.add(frame, T)
    with Reader(tmp_path / "drive") as bag:
        t_ns = [t for _, t, _ in bag.messages()]
        counts = {connection.topic: connection.msgcount for connection in bag.connections}
        assert (bag.message_count, bag.start_time, bag.end_time) == (len(t_ns), min(t_ns), max(t_ns) + 1)
    assert counts["/camera/left/image_rect_color/compressed"] == counts["/truth/left_camera"] == FRAMES
    assert sum(counts.values()) == len(t_ns)
    assert len(open_log(tmp_path / "drive")) == FRAMES


def test_we_read_a_bag_that_others_wrote(tmp_path: Path) -> None:
    store, frames, imu = get_typestore(Stores.ROS2_HUMBLE), made_frames(FRAMES, False), made_imu()
    types = store.types

    def header(t_ns: int, frame: str) -> object:
        stamp = types["builtin_interfaces/msg/Time"](t_ns // 10**9, t_ns % 10**9)
        return types["std_msgs/msg/Header"](stamp, frame)

    def vector(values: np.ndarray) -> object:
        return types["geometry_msgs/msg/Vector3"](*values.tolist())

    region = types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as bag:

        def channel(topic: str, kind: str) -> object:
            return bag.add_connection(topic, kind, typestore=store)

        for side, name in enumerate(("left", "right")):
            images = channel(f"/stereo/{name}/image_rect", "sensor_msgs/msg/Image")
            infos = channel(f"/stereo/{name}/camera_info", "sensor_msgs/msg/CameraInfo")
            P = np.column_stack([RIG.camera.K, RIG.camera.K @ (np.array(RIG.t_right_left) * side)])
            for frame in frames:
                head, image = header(frame.t_ns, name), (frame.left, frame.right)[side]
                info = types["sensor_msgs/msg/CameraInfo"](
                    head, 40, 64, "plumb_bob", np.zeros(5), RIG.camera.K.ravel(), np.eye(3).ravel(), P.ravel(), 0, 0, region
                )
                bag.write(infos, frame.t_ns, store.serialize_cdr(info, "sensor_msgs/msg/CameraInfo"))
                picture = types["sensor_msgs/msg/Image"](head, 40, 64, "mono8", 0, 64, image.ravel())
                bag.write(images, frame.t_ns, store.serialize_cdr(picture, "sensor_msgs/msg/Image"))
        fixes, samples = channel("/fix", "sensor_msgs/msg/NavSatFix"), channel("/imu", "sensor_msgs/msg/Imu")
        for packet in made_packets(FRAMES):
            lon, lat, height = packet.lon_lat_height
            covariance, status = np.diag([1.0, 1.0, 4.0]) * packet.sigma_m**2, types["sensor_msgs/msg/NavSatStatus"](0, 1)
            fix = types["sensor_msgs/msg/NavSatFix"](header(packet.t_ns, "gps"), status, lat, lon, height, covariance.ravel(), 2)
            bag.write(fixes, packet.t_ns, store.serialize_cdr(fix, "sensor_msgs/msg/NavSatFix"))
        upright, unsaid = types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0), np.zeros(9)
        for t, force, rate in zip(imu.t_ns.tolist(), imu.specific_force, imu.angular_rate, strict=True):
            sample = types["sensor_msgs/msg/Imu"](header(t, "imu"), upright, unsaid, vector(rate), unsaid, vector(force), unsaid)
            bag.write(samples, t, store.serialize_cdr(sample, "sensor_msgs/msg/Imu"))
        w, x, y, z = se3.quaternion_wxyz(T_CAM_IMU[None])[0].tolist()
        transform = types["geometry_msgs/msg/Transform"](
            vector(T_CAM_IMU[:3, 3]), types["geometry_msgs/msg/Quaternion"](x, y, z, w)
        )
        stamped = types["geometry_msgs/msg/TransformStamped"](header(0, "left"), "imu", transform)
        message = types["tf2_msgs/msg/TFMessage"]([stamped])
        bag.write(
            channel("/tf_static", "tf2_msgs/msg/TFMessage"), frames[0].t_ns, store.serialize_cdr(message, "tf2_msgs/msg/TFMessage")
        )
    log = open_log(tmp_path / "bag")
    assert (log.format, log.colour, log.rig.camera) == ("mcap", False, RIG.camera)
    for got, frame in zip(log.frames(), frames, strict=True):
        assert got.t_ns == frame.t_ns
        np.testing.assert_array_equal(got.left, frame.left)
        np.testing.assert_array_equal(got.right, frame.right)
    assert log.gnss is not None
    assert log.imu is not None
    assert log.T_cam_imu is not None
    assert log.gnss.lon_lat_height.tolist() == [list(packet.lon_lat_height) for packet in made_packets(FRAMES)]
    np.testing.assert_array_equal(log.imu.specific_force, imu.specific_force)
    np.testing.assert_array_equal(log.imu.angular_rate, imu.angular_rate)
    np.testing.assert_allclose(log.T_cam_imu, T_CAM_IMU, atol=1e-12)
