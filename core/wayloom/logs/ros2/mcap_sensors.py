"""GNSS, IMU, static transforms, exposures and ground truth of a ROS 2 recording."""

from collections.abc import Callable
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import LogError
from wayloom.files.timestamps import NS
from wayloom.geometry import se3
from wayloom.logs.kitti.positioning import LEAST_IMU_RATE_HZ
from wayloom.logs.ros2 import ros_messages as ros
from wayloom.logs.ros2.cdr import CdrError
from wayloom.logs.ros2.mcap_index import RECOVER, McapFile, Messages, Topic
from wayloom.logs.ros2.mcap_rig import McapRig, base_of
from wayloom.logs.ros2.ros_messages import Fix
from wayloom.logs.sidecars.gnss_csv import check_places
from wayloom.logs.sidecars.oxts import ASSUMED_SIGMA_M, UP_FACTOR
from wayloom.logs.sidecars.sidecar import Sidecar
from wayloom.logs.types import FixType, GnssTrack, ImuTrack

FloatArray = NDArray[np.float64]
STATIC_TOPIC, TRUTH_TOPIC = "/tf_static", "/truth/left_camera"
FIXED_WITHIN_M: Final = 0.1
"""A fix by a base station whose horizontal sigma is below this is an integer one."""
T = TypeVar("T")


def decoded(file: McapFile, topic: str, messages: Messages, read: Callable[[bytes], T]) -> list[T]:
    """All messages of a topic. Raises LogError naming the one that is none."""
    out = []
    for index in range(len(messages)):
        try:
            out.append(read(file.read(messages, index)))
        except CdrError as problem:
            where = f"{topic} at {messages.t_ns[index] / NS:.9f} s"
            raise LogError(
                f"a message {problem}", file=file.path, record=where, remedy=RECOVER, reason="recording.damaged"
            ) from None
    return out


def read_places(file: McapFile, camera_frame: str, R_rect: FloatArray) -> dict[str, FloatArray]:
    """T_cam_frame (4, 4) of every tf frame that /tf_static connects to the left camera's, for the rectified left camera."""
    topic = next((t for t in file.topics if t.name == STATIC_TOPIC and t.kind == ros.TRANSFORMS and t.encoding == "cdr"), None)
    if topic is None:
        return {}
    messages = file.messages({topic.name}, headers=False)[topic.name]
    edges = [edge for part in decoded(file, topic.name, messages, ros.read_transforms) for edge in part]
    places = {camera_frame: se3.from_rotation_translation(R_rect, np.zeros(3))}
    grown = True
    while grown:
        grown = False
        for edge in edges:
            if edge.parent in places and edge.child not in places:
                places[edge.child], grown = places[edge.parent] @ edge.T_parent_child, True
            elif edge.child in places and edge.parent not in places:
                places[edge.parent], grown = places[edge.child] @ se3.inverse(edge.T_parent_child), True
    return places


def one_topic(file: McapFile, kind: str, named: str | None, what: str) -> Topic | None:
    """The topic that is named, or the only one of its kind, or of several the first by name. Raises LogError for no such topic."""
    topics = [topic for topic in file.topics if topic.kind == kind and topic.encoding == "cdr"]
    if named is None:
        return topics[0] if topics else None
    found = next((topic for topic in topics if topic.name == named), None)
    if found is None:
        names = ", ".join(topic.name for topic in topics) or "none"
        raise LogError(
            f"holds no {what} {named!r}; there is {names}", file=file.path, remedy="correct wayloom.json beside the file"
        )
    return found


def read_fixes(
    file: McapFile, messages: dict[str, Messages], sidecar: Sidecar, places: dict[str, FloatArray]
) -> tuple[GnssTrack | None, FloatArray | None, tuple[str, ...]]:
    """The fixes, T_cam_gnss of their frame where /tf_static says it, and what is missing. Raises LogError."""
    topic = one_topic(file, ros.NAV_SAT_FIX, sidecar.gnss_topic, "GNSS fixes")
    if topic is None:
        return None, None, ("GNSS",)
    fixes = decoded(file, topic.name, messages[topic.name], ros.read_fix)
    valid = [fix for fix in fixes if np.isfinite(fix.lon_lat_height).all()]
    t_ns = np.array([fix.header.t_ns for fix in valid], np.int64)
    fresh = np.flatnonzero(np.diff(t_ns, prepend=np.iinfo(np.int64).min // 2) > 0)
    kept = [valid[index] for index in fresh]
    if not kept:
        return None, None, ("GNSS: no message holds a place",)
    lon_lat_height = np.array([fix.lon_lat_height for fix in kept])
    check_places(lon_lat_height, file.path, lambda row: f"{topic.name} at {kept[row].header.t_ns / NS:.9f} s")
    kinds, covariances = zip(*(fix_of(fix) for fix in kept), strict=True)
    track = GnssTrack(t_ns[fresh], lon_lat_height, np.array(covariances), np.array(kinds, np.uint8))
    lost = len(fixes) - len(kept)
    return track, places.get(kept[0].header.frame_id), (f"a place in {lost} of {len(fixes)} GNSS fixes",) if lost else ()


def fix_of(fix: Fix) -> tuple[FixType, FloatArray]:
    """Type and covariance (3, 3) ENU: what the message says, or usual values where it says nothing that can be."""
    kind = FixType.NONE if fix.status < ros.PLAIN_FIX else FixType.SINGLE
    covariance = fix.covariance if fix.covariance_type == ros.KNOWN else np.diag(np.diag(fix.covariance))
    known = bool(fix.covariance_type != 0 and np.isfinite(covariance).all())
    known = bool(known and np.allclose(covariance, covariance.T) and np.linalg.eigvalsh(covariance).min() > 0)
    if fix.status >= ros.GROUND_AUGMENTED_FIX:
        sigma2 = 0.5 * (covariance[0, 0] + covariance[1, 1]) if known else np.inf
        kind = FixType.FIXED if sigma2 <= FIXED_WITHIN_M**2 else FixType.FLOAT
    if not known:
        covariance = ASSUMED_SIGMA_M[kind] ** 2 * np.diag((1.0, 1.0, UP_FACTOR**2))
    return kind, covariance


def read_imu(
    file: McapFile, messages: dict[str, Messages], sidecar: Sidecar, places: dict[str, FloatArray]
) -> tuple[ImuTrack | None, FloatArray | None, tuple[str, ...]]:
    """The samples, T_cam_imu, and what is missing. Raises LogError."""
    topic = one_topic(file, ros.IMU, sidecar.imu_topic, "IMU samples")
    T_cam_imu = None if sidecar.T_cam_imu is None else np.array(sidecar.T_cam_imu)
    if topic is None or not len(messages[topic.name]):
        return None, T_cam_imu, ("IMU",)
    samples = decoded(file, topic.name, messages[topic.name], ros.read_imu)
    t_ns = np.array([header.t_ns for header, _, _ in samples], np.int64)
    fresh = np.flatnonzero(np.diff(t_ns, prepend=np.iinfo(np.int64).min // 2) > 0)
    rate_hz = (len(fresh) - 1) * NS / max(int(t_ns[fresh[-1]] - t_ns[fresh[0]]), 1)
    if rate_hz < LEAST_IMU_RATE_HZ:
        return None, T_cam_imu, (f"IMU: {topic.name} comes at {rate_hz:.1f} Hz, which is too slow",)
    place = places.get(samples[0][0].frame_id)
    T_cam_imu = T_cam_imu if T_cam_imu is not None else place
    if T_cam_imu is None:
        return None, None, (f"T_cam_imu: without it (in wayloom.json or /tf_static) the samples of {topic.name} are left out",)
    force, rate = (np.array([samples[index][part] for index in fresh]) for part in (1, 2))
    if not (np.isfinite(force).all() and np.isfinite(rate).all()):
        raise LogError("a number is not finite", file=file.path, record=topic.name, remedy="leave the sample out")
    return ImuTrack(t_ns[fresh], force, rate), T_cam_imu, ()


def read_exposures(
    file: McapFile, messages: dict[str, Messages], topics: tuple[Topic, Topic], t_ns: NDArray[np.int64]
) -> FloatArray | None:
    """(N, 2) s, left and right; None unless every frame has both."""
    sides = []
    for topic in topics:
        name = f"{base_of(topic.name)[0]}/exposure"
        found = messages.get(name)
        if found is None or not any(t.name == name and t.kind == ros.EXPOSURE for t in file.topics):
            return None
        of_time = {header.t_ns: seconds for header, seconds in decoded(file, name, found, ros.read_exposure)}
        if any(t not in of_time for t in t_ns.tolist()):
            return None
        sides.append([of_time[t] for t in t_ns.tolist()])
    return np.array(sides).T.copy()


def read_truth(file: McapFile, messages: dict[str, Messages], t_ns: NDArray[np.int64], rig: McapRig) -> FloatArray | None:
    """(N, 4, 4) T_world_cam of the rectified left camera at its frames, NaN where there is none; None without any."""
    if not any(topic.name == TRUTH_TOPIC and topic.kind == ros.POSE and topic.encoding == "cdr" for topic in file.topics):
        return None
    poses = {header.t_ns: T for header, T in decoded(file, TRUTH_TOPIC, messages[TRUTH_TOPIC], ros.read_pose)}
    nowhere = np.full((4, 4), np.nan)
    T_rect_cam = se3.from_rotation_translation(rig.R_rect, np.zeros(3))
    truth = np.array([poses[t] @ se3.inverse(T_rect_cam) if t in poses else nowhere for t in t_ns.tolist()])
    return truth if np.isfinite(truth).any() else None
