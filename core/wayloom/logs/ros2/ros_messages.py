"""ROS 2 messages to and from CDR: images, calibration, GNSS, IMU, transforms, poses."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.files.text_files import LARGEST_NUMBER
from wayloom.geometry import se3
from wayloom.logs.ros2.cdr import CdrError, CdrReader, CdrWriter

FloatArray = NDArray[np.float64]
NS: Final = 1_000_000_000
COMPRESSED, RAW_IMAGE, CAMERA_INFO = "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo"
NAV_SAT_FIX, IMU, POINT_CLOUD = "sensor_msgs/msg/NavSatFix", "sensor_msgs/msg/Imu", "sensor_msgs/msg/PointCloud2"
TRANSFORMS, POSE, EXPOSURE = "tf2_msgs/msg/TFMessage", "geometry_msgs/msg/PoseStamped", "wayloom_msgs/msg/Exposure"
NO_FIX, PLAIN_FIX, GROUND_AUGMENTED_FIX = -1, 0, 2
"""NavSatStatus: none; unaugmented (1 is by satellites); by a base station."""
DIAGONAL_KNOWN, KNOWN = 2, 3
"""NavSatFix.position_covariance_type."""


@dataclass(frozen=True, slots=True)
class Header:
    """Time stamp, int64 ns, and tf frame of a message."""

    t_ns: int
    frame_id: str


@dataclass(frozen=True, slots=True)
class CameraInfo:
    """Calibration of one camera, as sensor_msgs/CameraInfo has it: d (n,), k and r (3, 3), p (3, 4)."""

    header: Header
    width: int
    height: int
    model: str
    d: FloatArray
    k: FloatArray
    r: FloatArray
    p: FloatArray


@dataclass(frozen=True, slots=True)
class Fix:
    """A GNSS fix: NavSatStatus, longitude, latitude in degrees, ellipsoidal height in m, covariance (3, 3) ENU m^2 and its type."""

    header: Header
    status: int
    lon_lat_height: FloatArray
    covariance: FloatArray
    covariance_type: int


@dataclass(frozen=True, slots=True)
class Transform:
    """T_parent_child (4, 4)."""

    parent: str
    child: str
    T_parent_child: FloatArray


def read_header(message: CdrReader) -> Header:
    """std_msgs/Header."""
    seconds, nanoseconds = message.integer("i"), message.integer("I")
    return Header(seconds * NS + nanoseconds, message.text())


def stamp_of(data: bytes | memoryview) -> int:
    """Time stamp, ns, of a message that begins with a header."""
    message = CdrReader(data)
    return message.integer("i") * NS + message.integer("I")


def read_compressed(data: bytes | memoryview) -> tuple[Header, memoryview]:
    """The image file of a CompressedImage."""
    message = CdrReader(data)
    header = read_header(message)
    message.text()
    return header, message.blob()


def read_raw_image(data: bytes | memoryview) -> tuple[Header, NDArray[np.uint8]]:
    """An Image as (h, w) grey or (h, w, 3) RGB, uint8; of 16 bit the upper eight. Raises CdrError for other encodings."""
    message = CdrReader(data)
    header = read_header(message)
    height, width, encoding, big = message.integer(), message.integer(), message.text(), message.integer("B")
    step, pixels = message.integer(), message.blob()
    layout = {"mono8": (1, "u1"), "8UC1": (1, "u1"), "mono16": (1, "u2"), "16UC1": (1, "u2"), "rgb8": (3, "u1"), "bgr8": (3, "u1"),
              "8UC3": (3, "u1"), "rgba8": (4, "u1"), "bgra8": (4, "u1")}  # fmt: skip
    if encoding not in layout:
        raise CdrError(f"an image encoded as {encoding!r}; known are {', '.join(layout)}")
    channels, kind = layout[encoding]
    dtype = np.dtype((">" if big else "<") + kind)
    row = width * channels * dtype.itemsize
    if step < row or height * step > len(pixels) or not height or not width:
        raise CdrError(f"an image of {width}x{height} {encoding} in {len(pixels)} bytes")
    rows = np.frombuffer(pixels, np.uint8, height * step).reshape(height, step)[:, :row]
    image = np.ascontiguousarray(rows).view(dtype).reshape(height, width, channels)
    if dtype.itemsize == 2:
        image = (image >> 8).astype(np.uint8)
    if channels == 1:
        return header, np.ascontiguousarray(image[..., 0], np.uint8)
    colours = image[..., 2::-1] if encoding[:3] in ("bgr", "8UC") else image[..., :3]
    return header, np.ascontiguousarray(colours, np.uint8)


def read_camera_info(data: bytes | memoryview) -> CameraInfo:
    """A CameraInfo; binning and region of interest are passed over."""
    message = CdrReader(data)
    header, height, width, model = read_header(message), message.integer(), message.integer(), message.text()
    d, k, r, p = message.sequence("d"), message.numbers("d", 9), message.numbers("d", 9), message.numbers("d", 12)
    return CameraInfo(header, width, height, model, d, k.reshape(3, 3), r.reshape(3, 3), p.reshape(3, 4))


def read_fix(data: bytes | memoryview) -> Fix:
    """A NavSatFix."""
    message = CdrReader(data)
    header, status = read_header(message), message.integer("b")
    message.integer("H")
    lat, lon, height = message.numbers("d", 3)
    covariance = message.numbers("d", 9).reshape(3, 3)
    return Fix(header, status, np.array([lon, lat, height]), covariance, message.integer("B"))


def read_imu(data: bytes | memoryview) -> tuple[Header, FloatArray, FloatArray]:
    """Specific force (3,) m/s^2 and angular rate (3,) rad/s of an Imu."""
    message = CdrReader(data)
    header = read_header(message)
    message.numbers("d", 4 + 9)
    rate = message.numbers("d", 3)
    message.numbers("d", 9)
    return header, message.numbers("d", 3), rate


def read_transforms(data: bytes | memoryview) -> list[Transform]:
    """The transforms of a TFMessage."""
    message = CdrReader(data)
    out = []
    for _ in range(message.count()):
        header, child = read_header(message), message.text()
        out.append(Transform(header.frame_id, child, read_motion(message)))
    return out


def read_pose(data: bytes | memoryview) -> tuple[Header, FloatArray]:
    """T_world_thing (4, 4) of a PoseStamped."""
    message = CdrReader(data)
    return read_header(message), read_motion(message)


def read_exposure(data: bytes | memoryview) -> tuple[Header, float]:
    """Seconds."""
    message = CdrReader(data)
    return read_header(message), float(message.number("d"))


def read_motion(message: CdrReader) -> FloatArray:
    """Translation and quaternion x y z w to (4, 4). Raises CdrError where the quaternion is none, or the place beyond all range."""
    t, (x, y, z, w) = message.numbers("d", 3), message.numbers("d", 4)
    norm = math.hypot(x, y, z, w)
    if not 0.9 < norm < 1.1:
        raise CdrError(f"a quaternion of length {norm:.3g}")
    if np.abs(t).max() > LARGEST_NUMBER:
        raise CdrError(f"a place {np.abs(t).max():.3g} m away")
    return se3.from_quaternion_wxyz(np.array([w, x, y, z]), t)


def header_of(t_ns: int, frame_id: str) -> CdrWriter:
    """A message that begins with a header."""
    return CdrWriter().number("i", t_ns // NS).number("I", t_ns % NS).text(frame_id)


def compressed_image(header: Header, kind: str, file: bytes) -> bytes:
    """An image file, `kind` png or jpeg."""
    return header_of(header.t_ns, header.frame_id).text(kind).blob(file).message()


def camera_info(info: CameraInfo) -> bytes:
    """A CameraInfo message, without binning or region of interest."""
    out = header_of(info.header.t_ns, info.header.frame_id).number("I", info.height).number("I", info.width).text(info.model)
    out.sequence(info.d).numbers(info.k.ravel()).numbers(info.r.ravel()).numbers(info.p.ravel())
    for _ in range(6):
        out.number("I", 0)
    return out.number("B", 0).message()


def nav_sat_fix(fix: Fix) -> bytes:
    """A fix of GPS."""
    lon, lat, height = fix.lon_lat_height
    out = header_of(fix.header.t_ns, fix.header.frame_id).number("b", fix.status).number("H", 1)
    out.numbers(np.array([lat, lon, height])).numbers(fix.covariance.ravel())
    return out.number("B", fix.covariance_type).message()


def imu_sample(header: Header, force: FloatArray, rate: FloatArray) -> bytes:
    """Specific force and angular rate; the orientation is said to be unknown (-1)."""
    unknown = np.zeros(9)
    unknown[0] = -1.0
    out = header_of(header.t_ns, header.frame_id).numbers(np.array([0.0, 0.0, 0.0, 1.0])).numbers(unknown)
    return out.numbers(rate).numbers(np.zeros(9)).numbers(force).numbers(np.zeros(9)).message()


def transforms(t_ns: int, parts: list[Transform]) -> bytes:
    """A TFMessage."""
    out = CdrWriter().number("I", len(parts))
    for part in parts:
        out.number("i", t_ns // NS).number("I", t_ns % NS).text(part.parent).text(part.child)
        _motion(out, part.T_parent_child)
    return out.message()


def pose_stamped(header: Header, T: FloatArray) -> bytes:
    """T_world_thing (4, 4)."""
    return _motion(header_of(header.t_ns, header.frame_id), T).message()


def exposure(header: Header, exposure_s: float) -> bytes:
    """Seconds."""
    return header_of(header.t_ns, header.frame_id).number("d", exposure_s).message()


def point_cloud(header: Header, points: NDArray[np.float32]) -> bytes:
    """points (N, 4): x, y, z in m, intensity."""
    out = header_of(header.t_ns, header.frame_id).number("I", 1).number("I", len(points)).number("I", 4)
    for k, name in enumerate(("x", "y", "z", "intensity")):
        out.text(name).number("I", 4 * k).number("B", 7).number("I", 1)  # 7: float32
    out.number("B", 0).number("I", 16).number("I", 16 * len(points))
    return out.blob(points.astype("<f4").tobytes()).number("B", 1).message()


def _motion(out: CdrWriter, T: FloatArray) -> CdrWriter:
    w, x, y, z = se3.quaternion_wxyz(T[None])[0]
    return out.numbers(T[:3, 3]).numbers(np.array([x, y, z, w]))


_HEADER = "std_msgs/Header header\n"
_PARTS: Final = {
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec\n",
    "sensor_msgs/RegionOfInterest": "uint32 x_offset\nuint32 y_offset\nuint32 height\nuint32 width\nbool do_rectify\n",
    "sensor_msgs/NavSatStatus": "int8 status\nuint16 service\n",
    "sensor_msgs/PointField": "string name\nuint32 offset\nuint8 datatype\nuint32 count\n",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n",
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n",
    "geometry_msgs/TransformStamped": f"{_HEADER}string child_frame_id\ngeometry_msgs/Transform transform\n",
}
_MESSAGES: Final = {
    COMPRESSED: f"{_HEADER}string format\nuint8[] data\n",
    CAMERA_INFO: (
        f"{_HEADER}uint32 height\nuint32 width\nstring distortion_model\nfloat64[] d\nfloat64[9] k\nfloat64[9] r\nfloat64[12] p\n"
        "uint32 binning_x\nuint32 binning_y\nsensor_msgs/RegionOfInterest roi\n"
    ),
    NAV_SAT_FIX: (
        f"{_HEADER}sensor_msgs/NavSatStatus status\nfloat64 latitude\nfloat64 longitude\nfloat64 altitude\n"
        "float64[9] position_covariance\nuint8 position_covariance_type\n"
    ),
    IMU: (
        f"{_HEADER}geometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n"
        "geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n"
        "geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance\n"
    ),
    POINT_CLOUD: (
        f"{_HEADER}uint32 height\nuint32 width\nsensor_msgs/PointField[] fields\nbool is_bigendian\nuint32 point_step\n"
        "uint32 row_step\nuint8[] data\nbool is_dense\n"
    ),
    TRANSFORMS: "geometry_msgs/TransformStamped[] transforms\n",
    POSE: f"{_HEADER}geometry_msgs/Pose pose\n",
    EXPOSURE: f"{_HEADER}float64 exposure_s\n",
}  # fmt: skip


def schema(kind: str) -> str:
    """A message's definition in the form that MCAP's `ros2msg` asks for: its own, then those of its parts."""
    text, seen, waiting = _MESSAGES[kind], set[str](), [_MESSAGES[kind]]
    while waiting:
        for line in waiting.pop().splitlines():
            name = line.split()[0].removesuffix("[]")
            if name in _PARTS and name not in seen:
                seen.add(name)
                waiting.append(_PARTS[name])
                text += f"{'=' * 80}\nMSG: {name}\n{_PARTS[name]}"
    return text
