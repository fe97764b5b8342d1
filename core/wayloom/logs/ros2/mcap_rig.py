"""Stereo pair and rig of a ROS 2 recording, found from the CameraInfo of its image topics."""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import permutations
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import CalibrationError, LogError
from wayloom.files.text_files import quoted
from wayloom.geometry.camera import PinholeCamera, StereoRig
from wayloom.geometry.rectification import Coefficients, DistortedCamera, FisheyeCamera, LensCamera, rectifying_maps
from wayloom.logs.kitti.image_folder_log import Rectifier
from wayloom.logs.kitti.kitti_calibration import BASELINES_M, LARGEST_DISTORTION, check_projection, t_cam_reference
from wayloom.logs.ros2 import ros_messages as ros
from wayloom.logs.ros2.cdr import CdrError, CdrReader
from wayloom.logs.ros2.mcap_index import McapFile, Topic
from wayloom.logs.ros2.ros_messages import CameraInfo
from wayloom.logs.sidecars.sidecar import SIDECAR_NAME, Sidecar

FloatArray = NDArray[np.float64]
IMAGE_KINDS: Final = (ros.COMPRESSED, ros.RAW_IMAGE)
PREFERRED: Final = ("image_rect_color", "image_rect", "image_color", "image_raw", "image")
NAME_THEM: Final = f"name left_topic and right_topic in {SIDECAR_NAME} beside the file"
FISHEYE_LENSES: Final = ("equidistant", "fisheye")
PLAIN_LENSES: Final = ("plumb_bob", "rational_polynomial", "")
SHOWN = 6
SIDE: Final = re.compile(r"left|right|\d+", re.ASCII)


@dataclass(frozen=True, slots=True)
class McapRig:
    """The stereo pair of a recording: image topics and CameraInfo of left and right."""

    topics: tuple[Topic, Topic]
    infos: tuple[CameraInfo, CameraInfo]
    file: McapFile

    @property
    def frame_id(self) -> str:
        """The tf frame of the left camera, before rectification."""
        return self.infos[0].header.frame_id

    @property
    def is_rectified(self) -> bool:
        """Whether images are rectified already: by the topics' names, or because the calibration has nothing to rectify."""
        return all("rect" in kind_of(topic.name) for topic in self.topics) or not any(has_distortion(info) for info in self.infos)

    @property
    def R_rect(self) -> FloatArray:
        """(3, 3) rectifying rotation of the left camera: from its own frame to the rectified one."""
        return self.infos[0].r if self.infos[0].r.any() else np.eye(3)

    def rectified(self, sizes: tuple[tuple[int, int], tuple[int, int]]) -> tuple[StereoRig, Rectifier | None]:
        """The rectified rig of images of these (width, height), and the rectifier that they need. Raises CalibrationError."""
        left, right = self.infos
        for info, size, topic in zip(self.infos, sizes, self.topics, strict=True):
            if (info.width, info.height) != size:
                what = f"images are {size[0]}x{size[1]}, but their camera_info is for {info.width}x{info.height}"
                raise CalibrationError(
                    what, file=self.file.path, record=topic.name, remedy="record the calibration of these images"
                )
        P = left.p
        camera = PinholeCamera(float(P[0, 0]), float(P[1, 1]), float(P[0, 2]), float(P[1, 2]), left.width, left.height)
        if not (0 < camera.cx < camera.width and 0 < camera.cy < camera.height):
            what = f"the optical centre lies outside of the {camera.width}x{camera.height} images"
            raise CalibrationError(what, file=self.file.path, record=self.topics[0].name, remedy="calibrate the cameras again")
        t = t_cam_reference(right.p) - t_cam_reference(P)
        rig = StereoRig(camera, (float(t[0]), float(t[1]), float(t[2])))
        if self.is_rectified:
            return rig, None
        maps = [rectifying_maps(lens_of(info, self.file), rotation_of(info, self.file), camera) for info in self.infos]
        return rig, Rectifier(maps[0], maps[1])


def find_rig(file: McapFile, sidecar: Sidecar) -> McapRig:
    """The stereo pair that is named, or the most rectified one that fits. Raises LogError or CalibrationError."""
    topics = {topic.name: topic for topic in file.topics if topic.kind in IMAGE_KINDS and topic.encoding == "cdr"}
    if sidecar.left_topic is not None and sidecar.right_topic is not None:
        named = [topics.get(name) for name in (sidecar.left_topic, sidecar.right_topic)]
        for topic, name in zip(named, (sidecar.left_topic, sidecar.right_topic), strict=True):
            if topic is None:
                what = f"holds no images {quoted(name)}; {described_images(file)}"
                raise LogError(what, file=file.path, remedy=f"correct {SIDECAR_NAME} beside the file")
        pair = (named[0], named[1])
        infos = {topic.name: info_of(file, topic) for topic in pair if topic is not None}
        assert pair[0] is not None
        assert pair[1] is not None
        return check_rig(McapRig((pair[0], pair[1]), (infos[pair[0].name], infos[pair[1].name]), file))
    if len(topics) < 2:
        raise LogError(
            f"needs the images of two cameras; {described_images(file)}",
            file=file.path,
            remedy="record both cameras of the stereo pair",
        )
    infos = {name: info for name, topic in topics.items() if (info := find_info(file, topic)) is not None}
    fitting = [(a, b) for a, b in permutations(infos, 2) if is_counterpart(a, b) and is_pair(infos[a], infos[b])]
    if not fitting:
        what = f"no two image topics whose camera_info differ by a baseline; {described_images(file)}"
        remedy = f"record camera_info with the matrix P of a stereo calibration, or {NAME_THEM}"
        raise LogError(what, file=file.path, remedy=remedy)
    best = min(rank(a) for a, _ in fitting)
    pairs = [(a, b) for a, b in fitting if rank(a) == best]
    if len(pairs) > 1:
        names = "; ".join(f"{a}, {b}" for a, b in pairs[:SHOWN])
        raise LogError(f"{len(pairs)} stereo pairs ({names})", file=file.path, remedy=NAME_THEM)
    a, b = pairs[0]
    return check_rig(McapRig((topics[a], topics[b]), (infos[a], infos[b]), file))


def check_rig(rig: McapRig) -> McapRig:
    """The same rig. Raises CalibrationError where the pair's calibration is impossible."""
    for info, topic in zip(rig.infos, rig.topics, strict=True):
        check_projection(info.p, rig.file.path, f"P of {topic.name}")
    left, right = rig.infos
    if not np.allclose(left.p[:, :3], right.p[:, :3], rtol=1e-6, atol=1e-3):
        what = "left and right have different focal lengths or centres in P: the pair is not rectified"
        raise CalibrationError(what, file=rig.file.path, remedy="calibrate the cameras as a stereo pair")
    baseline_m = -float((t_cam_reference(right.p) - t_cam_reference(left.p))[0])
    if not BASELINES_M[0] <= baseline_m <= BASELINES_M[1]:
        what = f"a baseline of {baseline_m:g} m from {rig.topics[0].name} to {rig.topics[1].name} is impossible"
        raise CalibrationError(what, file=rig.file.path, remedy="left and right may be exchanged, or P is not in px m")
    return rig


def kind_of(topic: str) -> str:
    """The processing stage in an image topic's name: image_rect_color, image_raw, …"""
    return base_of(topic)[1]


def base_of(topic: str) -> tuple[str, str]:
    """Namespace of the camera and processing stage of an image topic, without the transport suffix."""
    parts = topic.rstrip("/").split("/")
    if parts[-1] in ("compressed", "compressed_image", "ffmpeg", "theora") and len(parts) > 2:
        parts = parts[:-1]
    return "/".join(parts[:-1]), parts[-1]


def rank(topic: str) -> int:
    """Preference of an image topic, lower first: rectified colour before rectified grey before raw."""
    kind = kind_of(topic)
    return next((k for k, name in enumerate(PREFERRED) if kind.startswith(name)), len(PREFERRED))


def is_pair(left: CameraInfo, right: CameraInfo) -> bool:
    """Whether two projection matrices belong to the left and the right camera of a rectified pair."""
    if not (left.p[0, 0] > 0 and right.p[0, 0] > 0 and left.p[1, 1] > 0 and left.p[2, 2] > 0 and right.p[2, 2] > 0):
        return False
    same = np.allclose(left.p[:, :3], right.p[:, :3], rtol=1e-6, atol=1e-3)
    return bool(same and left.p[0, 3] - right.p[0, 3] > BASELINES_M[0] * left.p[0, 0])


def find_info(file: McapFile, topic: Topic) -> CameraInfo | None:
    """The first calibration of an image topic; None where there is none.

    `camera_info` in the camera's namespace, else the only calibration there, else the only one that speaks of the image's frame.
    """
    space = base_of(topic.name)[0]
    known = [other for other in file.topics if other.kind == ros.CAMERA_INFO and other.encoding == "cdr"]
    beside = [other for other in known if base_of(other.name)[0] == space]
    chosen = [other for other in beside if base_of(other.name)[1] == "camera_info"] or beside
    if len(chosen) != 1:
        frame = first_frame(file, topic)
        chosen = [other for other in (chosen or known) if frame and first_frame(file, other) == frame]
    if len(chosen) != 1:
        return None
    try:
        return ros.read_camera_info(file.first(chosen[0].name))
    except CdrError as problem:
        raise LogError(
            f"a message {problem}", file=file.path, record=chosen[0].name, remedy="record the calibration again"
        ) from None


def first_frame(file: McapFile, topic: Topic) -> str:
    """The tf frame of a topic's first message; empty where it has none."""
    try:
        return ros.read_header(CdrReader(file.first(topic.name))).frame_id
    except CdrError:
        return ""


def is_counterpart(a: str, b: str) -> bool:
    """Whether the last parts of two topics are one kind of image: the same, or apart from the camera's side or number."""
    return SIDE.sub("", kind_of(a)) == SIDE.sub("", kind_of(b))


def info_of(file: McapFile, topic: Topic) -> CameraInfo:
    """As `find_info`. Raises CalibrationError where there is none."""
    info = find_info(file, topic)
    if info is None:
        name = f"{base_of(topic.name)[0]}/camera_info"
        raise CalibrationError(f"no messages {name}", file=file.path, record=topic.name, remedy="record the calibration too")
    return info


def described_images(file: McapFile) -> str:
    """The images that the file holds, as part of an error message."""
    shown = [topic for topic in file.topics if "image" in topic.kind.lower() or "Image" in topic.kind]
    if not shown:
        names: Iterable[str] = (topic.name for topic in file.topics[:SHOWN])
        return f"it holds no images, but {', '.join(names) or 'nothing'}"
    return "it holds " + ", ".join(f"{topic.name} ({topic.kind}, {topic.encoding or 'no encoding'})" for topic in shown[:SHOWN])


def has_distortion(info: CameraInfo) -> bool:
    """Whether an unrectified image of this camera differs from the rectified one."""
    turned = info.r.any() and not np.allclose(info.r, np.eye(3), atol=1e-9)
    return bool(np.abs(info.d).max(initial=0.0) > 0 or turned or not np.allclose(info.k, info.p[:, :3], atol=1e-6))


def lens_of(info: CameraInfo, file: McapFile) -> LensCamera:
    """The distorted camera of a CameraInfo's K and D. Raises CalibrationError for lenses that are not radial-tangential."""
    record = f"camera_info of {info.header.frame_id}"
    is_fisheye = info.model in FISHEYE_LENSES and len(info.d) == 4
    if not is_fisheye and (info.model not in PLAIN_LENSES or np.abs(info.d[5:]).max(initial=0.0) > 0):
        what = f"a lens {quoted(info.model)} with {len(info.d)} coefficients; known are plumb_bob and equidistant"
        raise CalibrationError(what, file=file.path, record=record, remedy="record rectified images")
    if (
        info.k[0, 0] < 1
        or info.k[1, 1] < 1
        or not np.isfinite(info.k).all()
        or np.abs(info.d).max(initial=0.0) > LARGEST_DISTORTION
    ):
        raise CalibrationError("is no calibration", file=file.path, record=record, remedy="calibrate the camera again")
    k1, k2, p1, p2, k3 = (float(value) for value in np.concatenate([info.d, np.zeros(5)])[:5])
    coefficients: Coefficients = (k1, k2, p1, p2, k3)
    camera = PinholeCamera(
        float(info.k[0, 0]), float(info.k[1, 1]), float(info.k[0, 2]), float(info.k[1, 2]), info.width, info.height
    )
    return FisheyeCamera(camera, (k1, k2, p1, p2)) if is_fisheye else DistortedCamera(camera, coefficients)


def rotation_of(info: CameraInfo, file: McapFile) -> FloatArray:
    """The rectifying rotation R of a CameraInfo, identity where it was left out. Raises CalibrationError for others."""
    R = info.r if info.r.any() else np.eye(3)
    if not (np.allclose(R @ R.T, np.eye(3), atol=1e-3) and np.linalg.det(R) > 0):
        raise CalibrationError("R is no rotation", file=file.path, record=info.header.frame_id, remedy="calibrate the pair again")
    return R
