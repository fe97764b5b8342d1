"""Recordings of Foxglove's schemas, encoded by Google's library or as JSON."""

import base64
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.writer import Writer

from logs.made_drives import FRAMES, RIG, made_frames

FIELDS: dict[str, list[tuple[str, str, int]]] = {
    "CompressedImage": [("timestamp", "time", 1), ("frame_id", "string", 4), ("data", "bytes", 2), ("format", "string", 3)],
    "RawImage": [
        ("timestamp", "time", 1), ("frame_id", "string", 7), ("width", "fixed32", 2), ("height", "fixed32", 3),
        ("encoding", "string", 4), ("step", "fixed32", 5), ("data", "bytes", 6),
    ],
    "CameraCalibration": [
        ("timestamp", "time", 1), ("frame_id", "string", 9), ("width", "fixed32", 2), ("height", "fixed32", 3),
        ("distortion_model", "string", 4), ("D", "doubles", 5), ("K", "doubles", 6), ("R", "doubles", 7), ("P", "doubles", 8),
    ],
    "LocationFix": [
        ("timestamp", "time", 6), ("frame_id", "string", 7), ("latitude", "double", 1), ("longitude", "double", 2),
        ("altitude", "double", 3), ("position_covariance", "doubles", 4), ("position_covariance_type", "int32", 5),
    ],
}  # fmt: skip
KINDS = {"string": 9, "bytes": 12, "double": 1, "doubles": 1, "fixed32": 7, "int32": 5}
Encoder = Callable[[str, dict[str, Any]], bytes]


def descriptor_set() -> descriptor_pb2.FileDescriptorSet:
    time = descriptor_pb2.FileDescriptorProto(name="google/protobuf/timestamp.proto", package="google.protobuf", syntax="proto3")
    stamp = time.message_type.add(name="Timestamp")
    stamp.field.add(name="seconds", number=1, label=1, type=3)
    stamp.field.add(name="nanos", number=2, label=1, type=5)
    file = descriptor_pb2.FileDescriptorProto(name="all.proto", package="foxglove", syntax="proto3", dependency=[time.name])
    for name, fields in FIELDS.items():
        message = file.message_type.add(name=name)
        for field, kind, number in fields:
            if kind == "time":
                message.field.add(name=field, number=number, label=1, type=11, type_name=".google.protobuf.Timestamp")
            else:
                message.field.add(name=field, number=number, label=3 if kind == "doubles" else 1, type=KINDS[kind])
    return descriptor_pb2.FileDescriptorSet(file=[time, file])


def protobuf_encoder() -> Encoder:
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_set().file:
        pool.Add(file)

    def encode(name: str, values: dict[str, Any]) -> bytes:
        kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(f"foxglove.{name}"))
        t_ns = values["timestamp"]
        return kind(**{**values, "timestamp": {"seconds": t_ns // 10**9, "nanos": t_ns % 10**9}}).SerializeToString()

    return encode


def json_encoder() -> Encoder:
    def encode(name: str, values: dict[str, Any]) -> bytes:
        t_ns = values["timestamp"]
        out = {**values, "timestamp": {"sec": t_ns // 10**9, "nsec": t_ns % 10**9}}
        plain = {key: base64.b64encode(value).decode() if isinstance(value, bytes) else value for key, value in out.items()}
        return json.dumps(plain).encode()

    return encode


def record(file: Path, encoding: str, *, raw: bool, topics: tuple[str, str] = ("/cam_left", "/cam_right")) -> Path:
    """A made drive as foxglove messages, with topics that are told by type and frame alone."""
    encode = protobuf_encoder() if encoding == "protobuf" else json_encoder()
    with file.open("wb") as stream:
        writer = Writer(stream, chunk_size=20_000)
        writer.start(profile="", library="test")
        channels: dict[str, int] = {}

        def add(topic: str, name: str, values: dict[str, Any]) -> None:
            if topic not in channels:
                text = descriptor_set().SerializeToString() if encoding == "protobuf" else b"{}"
                schema = writer.register_schema(f"foxglove.{name}", "protobuf" if encoding == "protobuf" else "jsonschema", text)
                channels[topic] = writer.register_channel(topic, encoding, schema)
            writer.add_message(channels[topic], values["timestamp"], encode(name, values), values["timestamp"], 0)

        for frame in made_frames(FRAMES, True):
            for side, image in enumerate((frame.left, frame.right)):
                K = RIG.camera.K
                P = np.column_stack([K, K @ (np.array(RIG.t_right_left) * side)])
                head = {"timestamp": frame.t_ns, "frame_id": f"eye_{side}"}
                size = {"width": 64, "height": 40}
                lens = {"distortion_model": "plumb_bob", "D": [0.0] * 5, "K": K.ravel().tolist(), "R": np.eye(3).ravel().tolist()}
                add(f"/calibration_{side}", "CameraCalibration", {**head, **size, **lens, "P": P.ravel().tolist()})
                if raw:
                    pixels = {"encoding": "rgb8", "step": 192, "data": image.tobytes()}
                    add(topics[side], "RawImage", {**head, **size, **pixels})
                else:
                    data = cv2.imencode(".png", image[..., ::-1])[1].tobytes()
                    add(topics[side], "CompressedImage", {**head, "data": data, "format": "png"})
            place = {"latitude": 49.0, "longitude": 8.4, "altitude": 115.0}
            covariance = (0.25 * np.eye(3)).ravel().tolist()
            fix = {"timestamp": frame.t_ns + 5, "frame_id": "antenna", "position_covariance": covariance}
            add("/where", "LocationFix", {**fix, **place, "position_covariance_type": 3})
        writer.finish()
    return file
