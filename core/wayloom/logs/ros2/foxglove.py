"""Foxglove's schemas, in Protocol Buffers or JSON, as the ROS 2 messages that they correspond to.

A message is translated when it is read, so that rig, sensors and images of a recording are found and decoded in one way.
"""

import base64
import binascii
import json
import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from wayloom.logs.ros2 import protobuf
from wayloom.logs.ros2 import ros_messages as ros
from wayloom.logs.ros2.cdr import CdrError
from wayloom.logs.ros2.ros_messages import CameraInfo, Fix, Header

FloatArray = NDArray[np.float64]
NS: Final = 1_000_000_000
LARGEST_SECONDS: Final = 2**31


class Record(Protocol):
    """The values of a message by the names of their fields; what is left out is zero or empty."""

    def t_ns(self) -> int: ...
    def text(self, name: str) -> str: ...
    def whole(self, name: str) -> int: ...
    def blob(self, name: str) -> bytes: ...
    def doubles(self, name: str) -> FloatArray: ...


@dataclass(frozen=True, slots=True)
class Translator:
    """kind: the ROS 2 message type; stamp: time ns of a message; to_ros: a message as CDR. Both raise CdrError."""

    kind: str
    stamp: Callable[[bytes | memoryview], int]
    to_ros: Callable[[bytes | memoryview], bytes]


def translator(schema: str, encoding: str, description: bytes) -> Translator | None:
    """Of messages of a schema in this encoding, None where it is not one of SCHEMAS. Raises CdrError for a bad description."""
    if schema not in SCHEMAS or encoding not in ("protobuf", "json"):
        return None
    kind, build = SCHEMAS[schema]
    if encoding == "json":
        return Translator(kind, lambda data: JsonRecord(data).t_ns(), lambda data: _built(build, JsonRecord(data)))
    numbers = protobuf.field_numbers(description, schema)
    return Translator(
        kind, lambda data: ProtobufRecord(data, numbers).t_ns(), lambda data: _built(build, ProtobufRecord(data, numbers))
    )


def _built(build: Callable[[Record], bytes], record: Record) -> bytes:
    """The ROS 2 message of a record. Raises CdrError also for values that the message's types cannot hold."""
    try:
        return build(record)
    except struct.error as problem:
        raise CdrError(f"has a number that does not fit ({problem})") from None
    except UnicodeEncodeError:
        raise CdrError("has a text that is no Unicode") from None


class ProtobufRecord:
    """A `Record` of a message in Protocol Buffers, whose fields' numbers are known by name."""

    def __init__(self, data: bytes | memoryview, numbers: dict[str, int]) -> None:
        self._fields, self._numbers = protobuf.fields(data), numbers

    def t_ns(self) -> int:
        """seconds = 1, nanos = 2 of google.protobuf.Timestamp."""
        parts = protobuf.fields(self.blob("timestamp"))
        seconds, nanoseconds = (protobuf.whole(parts.get(number, [0])[-1]) for number in (1, 2))
        return checked_time(seconds, nanoseconds)

    def text(self, name: str) -> str:
        """A string."""
        return self.blob(name).decode("utf-8", "replace")

    def whole(self, name: str) -> int:
        """A fixed32 or an enumeration."""
        return protobuf.whole(self._values(name)[-1]) if self._values(name) else 0

    def blob(self, name: str) -> bytes:
        """Bytes."""
        value = self._values(name)[-1] if self._values(name) else b""
        if isinstance(value, int):
            raise CdrError(f"has a number as {name}")
        return bytes(value)

    def doubles(self, name: str) -> FloatArray:
        """(n,), one or repeated."""
        return protobuf.doubles(self._values(name))

    def _values(self, name: str) -> list[protobuf.Value]:
        return self._fields.get(self._numbers.get(name, -1), [])


class JsonRecord:
    """A `Record` of a message in JSON, whose bytes are in base64."""

    def __init__(self, data: bytes | memoryview) -> None:
        try:
            content = json.loads(bytes(data))
        except (ValueError, RecursionError) as problem:
            raise CdrError(f"is no JSON ({type(problem).__name__})") from None
        if not isinstance(content, dict):
            raise CdrError("is no JSON object")
        self._content: dict[str, Any] = content

    def t_ns(self) -> int:
        """sec and nsec."""
        stamp = self._content.get("timestamp")
        if not isinstance(stamp, dict):
            raise CdrError("has no timestamp")
        seconds, nanoseconds = stamp.get("sec", 0), stamp.get("nsec", 0)
        if type(seconds) is not int or type(nanoseconds) is not int:
            raise CdrError("has a timestamp that is none")
        return checked_time(seconds, nanoseconds)

    def text(self, name: str) -> str:
        """A string."""
        return str(self._content.get(name, ""))

    def whole(self, name: str) -> int:
        """A whole number."""
        value = self._content.get(name, 0)
        if type(value) is not int or not 0 <= value < 2**32:
            raise CdrError(f"has no whole number as {name}")
        return value

    def blob(self, name: str) -> bytes:
        """Bytes."""
        try:
            return base64.b64decode(self.text(name), validate=True)
        except (binascii.Error, ValueError):
            raise CdrError(f"has no base64 as {name}") from None

    def doubles(self, name: str) -> FloatArray:
        """(n,), one or several."""
        value = self._content.get(name, [])
        try:
            return np.atleast_1d(np.array(value, np.float64)).ravel()
        except (ValueError, TypeError, OverflowError):
            raise CdrError(f"has no numbers as {name}") from None


def checked_time(seconds: int, nanoseconds: int) -> int:
    """Nanoseconds since 1970. Raises CdrError for a time that ROS cannot hold."""
    if not (0 <= seconds < LARGEST_SECONDS and 0 <= nanoseconds < NS):
        raise CdrError(f"has the time {seconds} s, {nanoseconds} ns")
    return seconds * NS + nanoseconds


def _header(record: Record) -> Header:
    return Header(record.t_ns(), record.text("frame_id"))


def _compressed_image(record: Record) -> bytes:
    return ros.compressed_image(_header(record), record.text("format"), record.blob("data"))


def _raw_image(record: Record) -> bytes:
    header = _header(record)
    out = ros.header_of(header.t_ns, header.frame_id).number("I", record.whole("height")).number("I", record.whole("width"))
    return out.text(record.text("encoding")).number("B", 0).number("I", record.whole("step")).blob(record.blob("data")).message()


def _camera_calibration(record: Record) -> bytes:
    K, R, P = (record.doubles(name) for name in "KRP")
    R = R if len(R) else np.zeros(9)
    if (len(K), len(R), len(P)) != (9, 9, 12):
        raise CdrError(f"has {len(K)}, {len(R)} and {len(P)} numbers as K, R and P")
    width, height, model = record.whole("width"), record.whole("height"), record.text("distortion_model")
    return ros.camera_info(
        CameraInfo(_header(record), width, height, model, record.doubles("D"), K.reshape(3, 3), R.reshape(3, 3), P.reshape(3, 4))
    )


def _location_fix(record: Record) -> bytes:
    places = [record.doubles(name) for name in ("longitude", "latitude", "altitude")]
    lon_lat_height = np.array([place[-1] if len(place) else 0.0 for place in places])
    covariance = record.doubles("position_covariance")
    known = len(covariance) == 9
    kind = record.whole("position_covariance_type") if known else 0
    return ros.nav_sat_fix(
        Fix(_header(record), ros.PLAIN_FIX, lon_lat_height, (covariance if known else np.zeros(9)).reshape(3, 3), kind)
    )


SCHEMAS: Final[dict[str, tuple[str, Callable[[Record], bytes]]]] = {
    "foxglove.CompressedImage": (ros.COMPRESSED, _compressed_image),
    "foxglove.RawImage": (ros.RAW_IMAGE, _raw_image),
    "foxglove.CameraCalibration": (ros.CAMERA_INFO, _camera_calibration),
    "foxglove.LocationFix": (ros.NAV_SAT_FIX, _location_fix),
}
"""The ROS 2 type, and what makes it of a record. A LocationFix says nothing of the fix's type: single."""
