"""Recordings of Foxglove's schemas, encoded by Google's library, and in JSON."""

from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer

from logs.made_drives import FRAMES, RIG, made_frames
from logs.ros2.foxglove_kit import FIELDS, descriptor_set, protobuf_encoder, record
from wayloom.errors import LogError
from wayloom.logs.registry import open_log
from wayloom.logs.ros2 import foxglove, protobuf
from wayloom.logs.ros2.cdr import CdrError
from wayloom.logs.types import FixType


@pytest.mark.parametrize("raw", [False, True])
@pytest.mark.parametrize("encoding", ["protobuf", "json"])
def test_a_foxglove_recording_is_read_whatever_its_topics_are_called(tmp_path: Path, encoding: str, raw: bool) -> None:
    log = open_log(record(tmp_path / "drive.mcap", encoding, raw=raw))
    expected = made_frames(FRAMES, True)
    assert log.t_ns.tolist() == [frame.t_ns for frame in expected]
    for got, frame in zip(log.frames(), expected, strict=True):
        np.testing.assert_array_equal(got.left, frame.left)
        np.testing.assert_array_equal(got.right, frame.right)
    assert log.rig.camera == RIG.camera
    np.testing.assert_allclose(log.rig.t_right_left, RIG.t_right_left, atol=1e-15)
    assert log.gnss is not None
    assert log.gnss.lon_lat_height[2].tolist() == [8.4, 49.0, 115.0]
    assert log.gnss.fix_type.tolist() == [FixType.SINGLE] * FRAMES
    np.testing.assert_array_equal(log.gnss.covariance_enu[0], 0.25 * np.eye(3))


def test_the_wire_format_is_read_as_google_writes_it() -> None:
    encode = protobuf_encoder()
    values = {"timestamp": 1_700_000_000_123_456_789, "frame_id": "é", "width": 2**32 - 1, "D": [1.5, -2.0], "P": []}
    data = encode("CameraCalibration", values)
    numbers = protobuf.field_numbers(descriptor_set().SerializeToString(), "foxglove.CameraCalibration")
    assert numbers == {name: number for name, _, number in FIELDS["CameraCalibration"]}
    made = foxglove.ProtobufRecord(data, numbers)
    assert (made.t_ns(), made.text("frame_id"), made.whole("width")) == (values["timestamp"], "é", 2**32 - 1)
    assert (made.doubles("D").tolist(), made.doubles("P").tolist(), made.whole("height")) == ([1.5, -2.0], [], 0)


@pytest.mark.parametrize(
    ("data", "what"),
    [
        (b"[" * 100_000, "is no JSON"),
        (b"[1]", "no JSON object"),
        (b"{}", "no timestamp"),
        (b'{"timestamp": {"sec": 1e300}}', "timestamp that is none"),
        (b'{"timestamp": {"sec": 99999999999}}', "has the time"),
        (b'{"timestamp": {"sec": 1}, "data": "\\u0000"}', "no base64"),
    ],
)
def test_json_that_is_none_of_these_messages_is_told(data: bytes, what: str) -> None:
    found = foxglove.translator("foxglove.CompressedImage", "json", b"")
    assert found is not None
    with pytest.raises(CdrError, match=what):
        found.to_ros(data)


@pytest.mark.parametrize(
    ("schema", "data", "what"),
    [
        (
            "LocationFix",
            b'{"timestamp": {"sec": 1}, "position_covariance": [0, 0, 0, 0, 0, 0, 0, 0, 0], "position_covariance_type": 300}',
            "does not fit",
        ),
        ("CompressedImage", b'{"timestamp": {"sec": 1}, "frame_id": "\\ud800"}', "no Unicode"),
    ],
)
def test_values_that_a_ros_message_cannot_hold_are_told(schema: str, data: bytes, what: str) -> None:
    found = foxglove.translator(f"foxglove.{schema}", "json", b"")
    assert found is not None
    with pytest.raises(CdrError, match=what):
        found.to_ros(data)


def test_a_width_of_more_than_32_bits_is_told() -> None:
    number = next(number for name, _, number in FIELDS["RawImage"] if name == "width")
    assert number < 16  # so that the field's key is one byte
    varint = bytes([0x80, 0x80, 0x80, 0x80, 0x10])  # 2**32
    found = foxglove.translator("foxglove.RawImage", "protobuf", descriptor_set().SerializeToString())
    assert found is not None
    with pytest.raises(CdrError, match="does not fit"):
        found.to_ros(bytes([number << 3]) + varint)


def test_a_schema_that_does_not_describe_its_message_is_refused(tmp_path: Path) -> None:
    with (tmp_path / "x.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        channel = writer.register_channel("/a", "protobuf", writer.register_schema("foxglove.RawImage", "protobuf", b"\x0a\x00"))
        writer.add_message(channel, 1, b"", 1, 0)
        writer.finish()
    with pytest.raises(LogError, match=r"'/a': a topic is described by a schema without foxglove.RawImage"):
        open_log(tmp_path / "x.mcap")
