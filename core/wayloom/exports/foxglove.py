"""Foxglove recording of results: MCAP with Foxglove's schemas in JSON, one topic a kind of message."""

import base64
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray

from wayloom.config.classes import PALETTE_WITH_VOID
from wayloom.errors import InputError
from wayloom.exports.points import PointBatch
from wayloom.exports.recorded_drives import RecordedDrive, map_points, recorded_drives
from wayloom.exports.source import MapSource
from wayloom.files.atomic import replacing
from wayloom.geodesy.antimeridian import Box
from wayloom.geometry import se3

MAP: Final = "map"
NS: Final = 1_000_000_000
UINT8, FLOAT32 = 1, 7
COVARIANCE_KNOWN: Final = 3
POINT: Final = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("sigma", "<f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1"),
                         ("alpha", "u1"), ("label", "u1")])  # fmt: skip
TYPES: Final = {"<f4": FLOAT32, "|u1": UINT8}


def _object(**properties: Any) -> dict[str, Any]:
    return {"type": "object", "properties": properties}


_NUMBER, _WHOLE, _TEXT = {"type": "number"}, {"type": "integer"}, {"type": "string"}
_TIME: Final = _object(sec=_WHOLE, nsec=_WHOLE)
_BYTES: Final = {"type": "string", "contentEncoding": "base64"}
_VECTOR: Final = _object(x=_NUMBER, y=_NUMBER, z=_NUMBER)
_QUATERNION: Final = _object(x=_NUMBER, y=_NUMBER, z=_NUMBER, w=_NUMBER)
_POSE: Final = _object(position=_VECTOR, orientation=_QUATERNION)
SCHEMAS: Final[Mapping[str, Mapping[str, Any]]] = {
    "PoseInFrame": _object(timestamp=_TIME, frame_id=_TEXT, pose=_POSE),
    "FrameTransform": _object(
        timestamp=_TIME, parent_frame_id=_TEXT, child_frame_id=_TEXT, translation=_VECTOR, rotation=_QUATERNION
    ),
    "LocationFix": _object(
        timestamp=_TIME, frame_id=_TEXT, latitude=_NUMBER, longitude=_NUMBER, altitude=_NUMBER,
        position_covariance={"type": "array", "items": _NUMBER}, position_covariance_type=_WHOLE,
    ),
    "PointCloud": _object(
        timestamp=_TIME, frame_id=_TEXT, pose=_POSE, point_stride=_WHOLE, data=_BYTES,
        fields={"type": "array", "items": _object(name=_TEXT, offset=_WHOLE, type=_WHOLE)},
    ),
    "CompressedImage": _object(timestamp=_TIME, frame_id=_TEXT, data=_BYTES, format=_TEXT),
}  # fmt: skip
"""Foxglove's published schemas of these names, fields and units, as JSON schemas."""
Message = tuple[str, str, int, Mapping[str, Any]]
"""Topic, schema, time ns, content."""


def write_foxglove(path: Path, source: MapSource, box: Box | None, provenance: Mapping[str, Any]) -> int:
    """Write poses, transforms, places, label images and the map's points; how many messages.

    Raises InputError for a map that is not made of folders of drives, OSError.
    """
    drives = recorded_drives(source, path)
    if not drives:
        raise InputError("there is no drive to play back", file=path, remedy="export folders of drives")
    start_ns = min(int(drive.t_ns[0]) for drive in drives)
    messages = [message for drive in drives for message in _of_drive(drive)]
    messages.append(("/map/points", "PointCloud", start_ns, _cloud(map_points(source, box), start_ns)))
    messages.sort(key=lambda message: (message[2], message[0]))
    with replacing(path) as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD)
        writer.start(profile="", library="wayloom")
        channels: dict[str, int] = {}
        for number, (topic, schema, t_ns, content) in enumerate(messages):
            channel = channels.get(topic) or _channel(writer, channels, topic, schema)
            writer.add_message(channel, t_ns, json.dumps(content, separators=(",", ":")).encode(), t_ns, number)
        writer.add_metadata("wayloom", {"provenance": json.dumps(provenance)})
        writer.finish()
    return len(messages)


def _channel(writer: Writer, channels: dict[str, int], topic: str, schema: str) -> int:
    text = json.dumps({"title": f"foxglove.{schema}", "$schema": "http://json-schema.org/draft-07/schema#", **SCHEMAS[schema]})
    number = writer.register_schema(f"foxglove.{schema}", "jsonschema", text.encode())
    channels[topic] = writer.register_channel(topic, "json", number)
    return channels[topic]


def _of_drive(drive: RecordedDrive) -> Iterator[Message]:
    """Its messages; the camera's frame is named after the drive, so that several drives play beside each other."""
    camera, q_wxyz = f"{drive.name}/left_camera", se3.quaternion_wxyz(drive.T_map_cam)
    for row, t_ns in enumerate(drive.t_ns.tolist()):
        place, rotation = _vector(drive.T_map_cam[row, :3, 3]), dict(zip("wxyz", q_wxyz[row].tolist(), strict=True))
        pose = {"timestamp": _time(t_ns), "frame_id": MAP, "pose": {"position": place, "orientation": rotation}}
        yield f"/{drive.name}/pose", "PoseInFrame", t_ns, pose
        frames = {"parent_frame_id": MAP, "child_frame_id": camera}
        yield "/tf", "FrameTransform", t_ns, {"timestamp": _time(t_ns), **frames, "translation": place, "rotation": rotation}
        if drive.lon_lat_height is not None and drive.covariance_enu is not None:
            yield f"/{drive.name}/location", "LocationFix", t_ns, {"timestamp": _time(t_ns), "frame_id": camera, **_fix(drive, row)}
    for frame, png in drive.pictures():
        t_ns = int(drive.t_ns[frame])
        image = {"timestamp": _time(t_ns), "frame_id": camera, "format": "png", "data": base64.b64encode(png).decode()}
        yield f"/{drive.name}/left/labels", "CompressedImage", t_ns, image


def _fix(drive: RecordedDrive, row: int) -> dict[str, Any]:
    assert drive.lon_lat_height is not None
    assert drive.covariance_enu is not None
    lon, lat, height = drive.lon_lat_height[row].tolist()
    known = bool(np.isfinite(drive.covariance_enu[row]).all())
    covariance = drive.covariance_enu[row].ravel().tolist() if known else [0.0] * 9
    about = {"position_covariance": covariance, "position_covariance_type": COVARIANCE_KNOWN if known else 0}
    return {"latitude": lat, "longitude": lon, "altitude": height, **about}


def _cloud(batch: PointBatch, t_ns: int) -> dict[str, Any]:
    rows = np.empty(len(batch), POINT)
    rows["x"], rows["y"], rows["z"] = batch.points.T
    rows["sigma"], rows["label"], rows["alpha"] = batch.sigma_m, batch.label, 255
    rows["red"], rows["green"], rows["blue"] = PALETTE_WITH_VOID[batch.label].T
    layout: Mapping[str, Any] = POINT.fields or {}
    fields = [{"name": name, "offset": layout[name][1], "type": TYPES[POINT[name].str]} for name in POINT.names or ()]
    pose = {"position": _vector(np.zeros(3)), "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
    data = base64.b64encode(rows.tobytes()).decode()
    return {
        "timestamp": _time(t_ns), "frame_id": MAP, "pose": pose, "point_stride": POINT.itemsize, "fields": fields, "data": data,
    }  # fmt: skip


def _time(t_ns: int) -> dict[str, int]:
    return {"sec": t_ns // NS, "nsec": t_ns % NS}


def _vector(place: NDArray[np.float64]) -> dict[str, float]:
    return dict(zip("xyz", place.tolist(), strict=True))
