"""ROS 2 recordings: as robots make them, and damaged."""

import io
import struct
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType

import cv2
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from logs.made_drives import FRAMES, RIG, T_CAM_IMU, made_frames, write_drive
from wayloom.errors import CalibrationError, InputError, LogError, UnknownFormatError
from wayloom.geometry import se3
from wayloom.geometry.rectification import DistortedCamera, rectifying_maps
from wayloom.logs.drive_writer import ImageEncoding, SensorExtrinsics
from wayloom.logs.inspection import inspect_log
from wayloom.logs.registry import open_log
from wayloom.logs.ros2 import ros_messages as ros
from wayloom.logs.ros2.cdr import CdrError, CdrReader, CdrWriter
from wayloom.logs.ros2.mcap_log import McapLog
from wayloom.logs.ros2.mcap_writer import McapWriter
from wayloom.logs.ros2.ros_messages import CameraInfo, Header
from wayloom.logs.types import FixType, ImuTrack

Messages = list[tuple[int, str, str, bytes]]
BAD_LENS = (-0.21, 0.06, 0.001, -0.0005, 0.0)


def info(t_ns: int, side: int, **changes: object) -> CameraInfo:
    K = RIG.camera.K
    t = np.zeros(3) if side == 0 else np.array(RIG.t_right_left)
    values: dict[str, object] = {
        "header": Header(t_ns, f"camera_{side}"), "width": 64, "height": 40, "model": "plumb_bob", "d": np.zeros(5), "k": K,
        "r": np.eye(3), "p": np.column_stack([K, K @ t]),
    }  # fmt: skip
    return CameraInfo(**{**values, **changes})  # type: ignore[arg-type]


def raw_image(t_ns: int, frame: str, image: np.ndarray, encoding: str, padding: int = 0) -> bytes:
    height, width = image.shape[:2]
    rows = np.ascontiguousarray(image).reshape(height, -1).view(np.uint8)
    padded = np.pad(rows, ((0, 0), (0, padding)))
    out = ros.header_of(t_ns, frame).number("I", height).number("I", width).text(encoding).number("B", 0)
    return out.number("I", padded.shape[1]).blob(padded.tobytes()).message()


def record(
    file: Path,
    messages: Messages,
    compression: CompressionType = CompressionType.ZSTD,
    encoding: str = "cdr",
    close: bool = True,
    encodings: Mapping[str, str] = MappingProxyType({}),
) -> Path:
    """A recording of (time, topic, type, bytes); some topics in encodings of their own."""
    stream = io.BytesIO()
    writer = Writer(stream, chunk_size=20_000, compression=compression)
    writer.start(profile="ros2", library="test")
    channels: dict[str, int] = {}
    for number, (t_ns, topic, kind, data) in enumerate(messages):
        if topic not in channels:
            text = ros.schema(kind) if kind in (ros.COMPRESSED, ros.CAMERA_INFO, ros.NAV_SAT_FIX, ros.IMU, ros.TRANSFORMS) else "x"
            used = encodings.get(topic, encoding)
            channels[topic] = writer.register_channel(topic, used, writer.register_schema(kind, "ros2msg", text.encode()))
        writer.add_message(channels[topic], t_ns, data, t_ns, number)
    if close:
        writer.finish()
    file.write_bytes(stream.getvalue())
    return file


def robot(topic: str = "image_rect_color", **changes: object) -> Messages:
    """Raw images and calibration of both cameras, the right one 1 ms late."""
    out: Messages = []
    for frame in made_frames(FRAMES, True):
        for side, (name, image) in enumerate((("left", frame.left), ("right", frame.right))):
            t = frame.t_ns + side * 1_000_000
            out.append((t, f"/rig/{name}/camera_info", ros.CAMERA_INFO, ros.camera_info(info(t, side, **changes))))
            out.append((t, f"/rig/{name}/{topic}", ros.RAW_IMAGE, raw_image(t, f"camera_{side}", image, "rgb8", padding=3)))
    return out


def test_truth_in_an_encoding_that_is_not_read_is_as_none(tmp_path: Path) -> None:
    messages = [*robot(), (1, "/truth/left_camera", ros.POSE, b"{}")]
    log = open_log(record(tmp_path / "drive.mcap", messages, encodings={"/truth/left_camera": "json"}))
    assert log.truth is None
    assert "truth poses" in log.missing


def test_a_transform_logged_later_than_times_can_be_is_refused_by_its_topic(tmp_path: Path) -> None:
    messages = [*robot(), (2**63, "/tf_static", ros.TRANSFORMS, ros.transforms(1, []))]
    with pytest.raises(LogError, match=r"/tf_static.*at 9223372036854775808 ns") as refused:
        open_log(record(tmp_path / "drive.mcap", messages))
    assert refused.value.reason == "recording.damaged"


@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.LZ4, CompressionType.ZSTD])
def test_a_robots_recording_is_read_with_its_rig_however_it_is_compressed(tmp_path: Path, compression: CompressionType) -> None:
    log = open_log(record(tmp_path / "drive.mcap", robot(), compression))
    expected = made_frames(FRAMES, True)
    assert log.t_ns.tolist() == [frame.t_ns for frame in expected]
    assert (log.name, log.format, log.colour, log.rig.camera) == ("drive", "mcap", True, RIG.camera)
    np.testing.assert_allclose(log.rig.t_right_left, RIG.t_right_left, atol=1e-12)
    for got, frame in zip(log.frames(), expected, strict=True):
        np.testing.assert_array_equal(got.left, frame.left)
        np.testing.assert_array_equal(got.right, frame.right)
    assert log.missing == ("GNSS", "IMU", "truth poses")
    assert inspect_log(log).usable


def test_images_of_all_encodings_become_grey_or_rgb() -> None:
    rgb = np.random.default_rng(0).integers(0, 256, (5, 7, 3), dtype=np.uint8)
    grey, deep = rgb[..., 0], rgb[..., 0].astype(np.uint16) * 256 + 77
    rgba = np.dstack([rgb, np.full((5, 7), 9, np.uint8)])
    cases = {"rgb8": (rgb, rgb), "bgr8": (rgb[..., ::-1], rgb), "rgba8": (rgba, rgb), "bgra8": (rgba[..., [2, 1, 0, 3]], rgb),
             "mono8": (grey, grey), "mono16": (deep, grey), "16UC1": (deep, grey)}  # fmt: skip
    for encoding, (image, expected) in cases.items():
        np.testing.assert_array_equal(ros.read_raw_image(raw_image(1, "f", image, encoding, 2))[1], expected)
    with pytest.raises(CdrError, match="encoded as 'bayer_rggb8'; known are mono8"):
        ros.read_raw_image(raw_image(1, "f", grey, "bayer_rggb8"))


def test_distorted_images_are_rectified_as_their_calibration_says(tmp_path: Path) -> None:
    turn = se3.exp(np.array([0.0, 0.0, 0.0, 0.01, -0.02, 0.005]))[:3, :3]
    log = open_log(record(tmp_path / "drive.mcap", robot("image_raw", d=np.array(BAD_LENS), r=turn)))
    frame = made_frames(FRAMES, True)[2]
    maps = rectifying_maps(DistortedCamera(RIG.camera, BAD_LENS), turn, RIG.camera)
    np.testing.assert_array_equal(log.frame(2).left, cv2.remap(frame.left, *maps, cv2.INTER_LINEAR))
    assert inspect_log(log).camera.rectified_on_load
    plain = open_log(record(tmp_path / "plain.mcap", robot("image_rect", d=np.array(BAD_LENS), r=turn)))
    np.testing.assert_array_equal(plain.frame(2).left, frame.left)


def test_a_distorted_drive_of_the_products_writer_is_rectified(tmp_path: Path) -> None:
    with McapWriter(tmp_path / "bent", RIG, encoding=ImageEncoding(distortion=BAD_LENS)) as drive:
        for frame in made_frames(3, True):
            drive.add(frame)
    log = open_log(tmp_path / "bent")
    maps = rectifying_maps(DistortedCamera(RIG.camera, BAD_LENS), np.eye(3), RIG.camera)
    np.testing.assert_array_equal(log.frame(1).right, cv2.remap(made_frames(3, True)[1].right, *maps, cv2.INTER_LINEAR))


def test_images_without_a_partner_are_left_out_and_counted(tmp_path: Path) -> None:
    messages = [
        m for m in robot() if m[1] != "/rig/right/image_rect_color" or m[0] != made_frames(FRAMES, True)[1].t_ns + 1_000_000
    ]
    log = open_log(record(tmp_path / "drive.mcap", messages))
    assert len(log) == FRAMES - 1
    assert "right image for 1 of 6 of /rig/left/image_rect_color" in log.missing
    np.testing.assert_array_equal(log.frame(1).right, made_frames(FRAMES, True)[2].right)


def test_of_several_kinds_of_images_the_rectified_colour_is_read_unless_others_are_named(tmp_path: Path) -> None:
    both = robot() + robot("image_raw")
    assert open_log(record(tmp_path / "drive.mcap", both)).files == ("drive.mcap",)
    (tmp_path / "wayloom.json").write_text('{"left_topic": "/rig/left/image_raw", "right_topic": "/rig/right/image_raw"}')
    log = open_log(tmp_path)
    assert isinstance(log, McapLog)
    assert [topic.name for topic in log.topics] == ["/rig/left/image_raw", "/rig/right/image_raw"]
    assert log.files == ("drive.mcap", "wayloom.json")


def test_two_pairs_ask_for_their_names(tmp_path: Path) -> None:
    other = [(t, topic.replace("/rig/", "/rear/"), kind, data) for t, topic, kind, data in robot()]
    with pytest.raises(LogError, match=r"stereo pairs \(.*/rear/left.*name left_topic and right_topic in wayloom.json"):
        open_log(record(tmp_path / "drive.mcap", robot() + other))


def test_gnss_imu_and_places_come_from_the_messages_alone(tmp_path: Path) -> None:
    T_cam_gnss = se3.from_rotation_translation(np.eye(3), np.array([0.1, -0.5, -1.0]))
    frames = made_frames(FRAMES, True)
    messages = robot()
    chain = [ros.Transform("base", "camera_0", se3.inverse(T_CAM_IMU)), ros.Transform("base", "imu", np.eye(4))]
    messages.append((frames[0].t_ns, "/tf_static", ros.TRANSFORMS, ros.transforms(1, chain)))
    messages.append(
        (frames[0].t_ns, "/tf_static", ros.TRANSFORMS, ros.transforms(1, [ros.Transform("camera_0", "antenna", T_cam_gnss)]))
    )
    covariance = np.diag([0.04, 0.09, 0.25])
    cases = [(2, np.diag([1e-4, 1e-4, 4e-4]), 3), (2, covariance, 3), (0, covariance, 2), (-1, covariance, 0), (0, -covariance, 3)]
    for (status, C, kind), frame in zip(cases, frames, strict=False):
        fix = ros.Fix(Header(frame.t_ns, "antenna"), status, np.array([8.39, 48.98, 116.0]), C, kind)
        messages.append((frame.t_ns, "/fix", ros.NAV_SAT_FIX, ros.nav_sat_fix(fix)))
    nowhere = ros.Fix(Header(frames[5].t_ns, "antenna"), -1, np.full(3, np.nan), covariance, 0)
    messages.append((frames[5].t_ns, "/fix", ros.NAV_SAT_FIX, ros.nav_sat_fix(nowhere)))
    times = frames[0].t_ns + 5_000_000 * np.arange(60)
    force, rate = np.random.default_rng(0).normal(size=(2, 60, 3))
    for t, f, w in zip(times.tolist(), force, rate, strict=True):
        messages.append((t, "/imu", ros.IMU, ros.imu_sample(Header(t, "imu"), f, w)))
    log = open_log(record(tmp_path / "drive.mcap", messages))
    assert log.gnss is not None
    assert log.imu is not None
    assert log.T_cam_imu is not None
    assert log.gnss.fix_type.tolist() == [FixType.FIXED, FixType.FLOAT, FixType.SINGLE, FixType.NONE, FixType.SINGLE]
    np.testing.assert_allclose(log.gnss.covariance_enu[1], covariance)
    np.testing.assert_allclose(log.gnss.covariance_enu[4], np.diag([9.0, 9.0, 36.0]))
    np.testing.assert_allclose(log.p_cam_gnss, [0.1, -0.5, -1.0])
    np.testing.assert_allclose(log.T_cam_imu, T_CAM_IMU, atol=1e-12)
    np.testing.assert_array_equal(log.imu.t_ns, times)
    np.testing.assert_array_equal(log.imu.specific_force, force)
    np.testing.assert_array_equal(log.imu.angular_rate, rate)
    assert "a place in 1 of 6 GNSS fixes" in log.missing


def test_an_imu_whose_place_is_unknown_is_left_out(tmp_path: Path) -> None:
    messages = robot()
    times = messages[0][0] + 5_000_000 * np.arange(60)
    messages += [(t, "/imu", ros.IMU, ros.imu_sample(Header(t, "imu"), np.ones(3), np.ones(3))) for t in times.tolist()]
    log = open_log(record(tmp_path / "drive.mcap", messages))
    assert log.imu is None
    assert any("without it (in wayloom.json or /tf_static) the samples of /imu are left out" in what for what in log.missing)


def test_a_written_drive_is_a_sound_recording_to_others(tmp_path: Path) -> None:
    drive = write_drive(tmp_path, "mcap")
    with (drive / "recording.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        times = [message.log_time for _, _, message in reader.iter_messages(log_time_order=False)]
        assert reader.get_header().profile == "ros2"
    assert summary is not None
    assert {schema.encoding for schema in summary.schemas.values()} == {"ros2msg"}
    assert {channel.message_encoding for channel in summary.channels.values()} == {"cdr"}
    assert times == sorted(times)


def test_exposures_and_imu_of_a_written_drive_come_back(tmp_path: Path) -> None:
    frames = made_frames(4, True)
    seconds = np.random.default_rng(0).uniform(1e-3, 1e-2, (4, 2))
    imu = ImuTrack(frames[0].t_ns + 5_000_000 * np.arange(60), *np.random.default_rng(1).normal(size=(2, 60, 3)))
    with McapWriter(tmp_path / "drive", RIG, extrinsics=SensorExtrinsics(T_cam_imu=T_CAM_IMU)) as drive:
        for frame in frames:
            drive.add(frame)
        drive.set_exposures(seconds)
        drive.set_imu(imu)
    (tmp_path / "drive" / "wayloom.json").unlink()
    log = open_log(tmp_path)
    np.testing.assert_array_equal([frame.exposure_s for frame in log.frames()], seconds)
    assert log.imu is not None
    assert log.T_cam_imu is not None
    np.testing.assert_array_equal(log.imu.angular_rate, imu.angular_rate)
    np.testing.assert_allclose(log.T_cam_imu, T_CAM_IMU, atol=1e-12)


def without(messages: Messages, ending: str) -> Messages:
    return [message for message in messages if not message[1].endswith(ending)]


def late(messages: Messages) -> Messages:
    """Right images half a second after the left ones."""
    shift, grey = 500_000_000, np.zeros((40, 64), np.uint8)
    from_ns = messages[0][0] + 400_000_000
    left = [message for message in messages if message[1] != "/rig/right/image_rect_color" and message[0] > from_ns]
    times = [message[0] + shift for message in messages if message[1] == "/rig/right/image_rect_color"]
    far = [
        (t + 10 * shift, "/rig/right/image_rect_color", ros.RAW_IMAGE, raw_image(t + 10 * shift, "f", grey, "mono8")) for t in times
    ]
    return left + [message for message in messages if message[1] == "/rig/right/camera_info"] + far


@pytest.mark.parametrize(
    ("messages", "error", "message"),
    [
        (
            lambda: without(robot(), "image_rect_color"),
            LogError,
            "needs the images of two cameras; it holds no images, but /rig/left",
        ),
        (lambda: without(robot(), "right/image_rect_color"), LogError, "needs the images of two cameras"),
        (lambda: without(robot(), "camera_info"), LogError, "no two image topics whose camera_info differ by a baseline"),
        (lambda: robot(p=np.column_stack([RIG.camera.K, np.zeros(3)])), LogError, "no two image topics whose camera_info differ"),
        (lambda: robot(width=60), CalibrationError, "images are 64x40, but their camera_info is for 60x40"),
        (lambda: robot("image_raw", d=np.ones(6) * 0.1, model="equidistant"), CalibrationError, "a lens 'equidistant'"),
        (lambda: robot("image_raw", d=np.full(5, 1e9)), CalibrationError, "is no calibration"),
        (lambda: late(robot()), LogError, "was taken with one of"),
        (lambda: robot() + robot()[:2], LogError, "two images have the time stamp"),
    ],
)
def test_what_a_recording_lacks_is_told(
    messages: Callable[[], Messages], error: type[InputError], message: str, tmp_path: Path
) -> None:
    with pytest.raises(error, match=message) as told:
        open_log(record(tmp_path / "drive.mcap", messages()))
    assert "\n" not in str(told.value)


def test_other_encodings_and_what_is_no_recording_are_told(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"needs the images .* \(sensor_msgs/msg/Image, protobuf\)"):
        open_log(record(tmp_path / "other.mcap", robot(), encoding="protobuf"))
    assert "the recording was not closed" in open_log(record(tmp_path / "open.mcap", robot(), close=False)).missing[0]
    (tmp_path / "text.mcap").write_text("no recording")
    with pytest.raises(LogError, match="is no MCAP file"):
        open_log(tmp_path / "text.mcap")
    with pytest.raises(UnknownFormatError, match=r"holds 3 logs \(open.mcap, other.mcap, text.mcap\)"):
        open_log(tmp_path)
    (tmp_path / "note.txt").write_text("hello")
    with pytest.raises(UnknownFormatError, match="is a file"):
        open_log(tmp_path / "note.txt")


@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.ZSTD])
def test_damage_anywhere_is_an_error_of_one_line_or_harmless(tmp_path: Path, compression: CompressionType) -> None:
    drive = write_drive(tmp_path / "own", "mcap")
    made = (drive / "recording.mcap").read_bytes() if compression == CompressionType.NONE else b""
    sound = made or record(tmp_path / "sound.mcap", robot(), compression).read_bytes()
    rng, told = np.random.default_rng(5), 0
    file = tmp_path / "spoilt.mcap"
    for trial in range(120):
        data = bytearray(sound)
        if trial % 4 == 0:
            del data[int(rng.integers(0, len(data))) :]
        for _ in range(int(rng.integers(1, 5))):
            if data:
                data[int(rng.integers(0, len(data)))] = int(rng.integers(0, 256))
        file.write_bytes(data)
        said = ""
        try:
            told += not inspect_log(open_log(file)).usable
        except InputError as problem:
            said, told = str(problem), told + 1
        assert "\n" not in said
    assert told > 90


def test_cdr_aligns_each_value_to_its_size() -> None:
    out = CdrWriter().number("B", 7).number("d", 1.5).text("abc").number("H", 9).sequence(np.array([2.5])).blob(b"xy").message()
    assert out[:4] == b"\x00\x01\x00\x00"
    assert out[4] == 7
    assert out[5:12] == bytes(7)
    message = CdrReader(out)
    assert (message.integer("B"), message.number("d"), message.text(), message.integer("H")) == (7, 1.5, "abc", 9)
    assert message.sequence("d").tolist() == [2.5]
    assert bytes(message.blob()) == b"xy"
    big = b"\x00\x00\x00\x00" + (5).to_bytes(4, "big")
    assert CdrReader(big).integer() == 5
    with pytest.raises(CdrError, match="ends after 4 bytes"):
        CdrReader(big).number("d")
    with pytest.raises(CdrError, match="not CDR"):
        CdrReader(b"\x07\x07\x00\x00")
    with pytest.raises(CdrError, match="says 5 values"):
        CdrReader(big).sequence("d")


@pytest.mark.parametrize(
    ("place", "quaternion", "what"), [(1e300, 1.0, "a place 1e\\+300 m away"), (0.0, 0.0, "a quaternion of length 0")]
)
def test_a_pose_beyond_all_range_is_refused(place: float, quaternion: float, what: str) -> None:
    values = struct.pack("<7d", 0.0, place, 0.0, 0.0, 0.0, 0.0, quaternion)
    with pytest.raises(CdrError, match=what):
        ros.read_motion(CdrReader(bytes([0, 1, 0, 0]) + values))


def test_a_log_that_is_let_go_closes_its_file(tmp_path: Path) -> None:
    drive = write_drive(tmp_path, "mcap")
    log = open_log(drive)
    assert log.frame(1).left.shape == (40, 64, 3)
    assert is_open(drive / "recording.mcap")
    del log
    assert not is_open(drive / "recording.mcap")


def is_open(file: Path) -> bool:
    """Whether this process holds the file."""
    return any(link.is_symlink() and link.resolve() == file for link in Path("/proc/self/fd").iterdir())
