"""MCAP reader for ROS 2 recordings: a stereo pair of image topics with CameraInfo, and GNSS, IMU and ground truth where present.

The pair is found by its calibration: two cameras of one kind of image topic whose projection matrices differ by a baseline. Where
several fit, or none, `left_topic` and `right_topic` of wayloom.json beside the file name them.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.config.progress import Progress, silent
from wayloom.config.side_by_side import in_order
from wayloom.errors import LogError
from wayloom.files.text_files import utf8_text
from wayloom.files.timestamps import NS
from wayloom.geometry.camera import StereoRig
from wayloom.logs.images.image_files import ImageHeader, decode_image, first_that_can
from wayloom.logs.kitti.image_folder_log import Rectifier, check_size
from wayloom.logs.kitti.positioning import FrameClock, find_positioning, lever_arm
from wayloom.logs.ros2 import ros_messages as ros
from wayloom.logs.ros2.cdr import CdrError
from wayloom.logs.ros2.mcap_index import McapFile, Messages, Topic
from wayloom.logs.ros2.mcap_rig import McapRig, find_rig
from wayloom.logs.ros2.mcap_sensors import read_exposures, read_fixes, read_imu, read_places, read_truth
from wayloom.logs.sidecars.sidecar import SIDECAR_NAME, read_sidecar
from wayloom.logs.stereo_pairing import taken_together
from wayloom.logs.types import Damage, GnssTrack, Image, ImuTrack, Seen, StatedReceiver, StereoFrame

FloatArray = NDArray[np.float64]
FORMAT: Final = "mcap"
ENDING: Final = ".mcap"
LOOKS_FOR: Final = "a ROS 2 recording .mcap, or a folder with one, with two image topics and their camera_info"


@dataclass(slots=True)
class McapLog:
    """A `DriveLog` of a recording. stored_sizes: (width, height) of left and right images as they are recorded."""

    path: Path
    format: str
    name: str
    rig: StereoRig
    t_ns: NDArray[np.int64]
    colour: bool
    gnss: GnssTrack | None
    imu: ImuTrack | None
    p_cam_gnss: FloatArray
    receiver: StatedReceiver
    T_cam_imu: FloatArray | None
    truth: FloatArray | None
    rig_id: str | None
    vehicle_id: str | None
    missing: tuple[str, ...]
    root: Path
    files: tuple[str, ...]
    stored_sizes: tuple[tuple[int, int], tuple[int, int]]
    rectifier: Rectifier | None
    exposure_s: FloatArray | None
    file: McapFile = field(repr=False)
    topics: tuple[Topic, Topic]
    images: tuple[Messages, Messages] = field(repr=False)

    def __len__(self) -> int:
        return len(self.t_ns)

    def frame(self, index: int) -> StereoFrame:
        """Decode (and, where the log is distorted, rectify) one pair. Raises LogError that names file, topic and image."""
        if not 0 <= index < len(self):
            raise IndexError(f"frame {index} of {len(self)}")
        left, right = (self._read(side, index) for side in (0, 1))
        if self.rectifier is not None:
            left, right = self.rectifier(left, right)
        exposed = None if self.exposure_s is None else (float(self.exposure_s[index, 0]), float(self.exposure_s[index, 1]))
        return StereoFrame(index, int(self.t_ns[index]), left, right, exposed)

    def grey_side(self, index: int, right: bool) -> Image:
        """Decode one image of a pair to grey (h, w), for those who need no colour or not both. Raises LogError as `frame`."""
        side = int(right)
        messages, topic, size = self.images[side], self.topics[side], self.stored_sizes[side]
        image = read_image(self.file, topic, messages, index, colour=False, size=size)
        if self.rectifier is None:
            return image
        return np.asarray(cv2.remap(image, *(self.rectifier.left, self.rectifier.right)[side], cv2.INTER_LINEAR), np.uint8)

    def encoded_pair(self, index: int) -> tuple[bytes, bytes] | None:
        """The image files of a pair as they are recorded; None where they are not rectified or not compressed."""
        if self.rectifier is not None or any(topic.kind != ros.COMPRESSED for topic in self.topics):
            return None
        left, right = (bytes(ros.read_compressed(self.file.read(messages, index))[1]) for messages in self.images)
        return left, right

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[StereoFrame]:
        """The pairs from start to stop in order, one in memory at a time."""
        for index in range(start, len(self) if stop is None else min(stop, len(self))):
            yield self.frame(index)

    @property
    def rectifies(self) -> bool:
        """Whether images are rectified as they are read."""
        return self.rectifier is not None

    def check_headers(self) -> None:
        """Nothing: opening has read the head of every message, and its check sum where it is compressed."""
        return

    def damaged(self, *, decode: bool, progress: Progress = silent, threads: int = 1, seen: Seen | None = None) -> list[Damage]:
        """All images that cannot be used, by decoding every one; and, as frame -1, a chunk that holds none of them and whose check
        sum is wrong. No image is a file of its own, so `seen` is given none."""
        found: list[Damage] = []
        spoilt = set[int]()
        for index, of_pair in enumerate(in_order(self._damaged_pair, range(len(self)) if decode else (), threads)):
            found += of_pair.values()
            spoilt |= {int(self.images[side].chunk[index]) for side in of_pair}
            progress((index + 1) / len(self), "looking at images")
        try:
            if decode:
                self.file.check(spoilt)
        except LogError as problem:
            found.append(Damage(-1, problem))
        return found

    def _damaged_pair(self, index: int) -> dict[int, Damage]:
        """By side."""
        found = {}
        for side in (0, 1):
            try:
                self._read(side, index)
            except LogError as problem:
                found[side] = Damage(index, problem)
        return found

    def kept(self, rows: NDArray[np.int64], missing: tuple[str, ...]) -> "McapLog":
        """The log of these frames only, in order; `missing` is said in addition."""
        return replace(
            self,
            t_ns=self.t_ns[rows],
            truth=None if self.truth is None else self.truth[rows],
            exposure_s=None if self.exposure_s is None else self.exposure_s[rows],
            images=(chosen(self.images[0], rows), chosen(self.images[1], rows)),
            missing=(*self.missing, *missing),
        )

    def _read(self, side: int, index: int) -> Image:
        messages, topic, size = self.images[side], self.topics[side], self.stored_sizes[side]
        return read_image(self.file, topic, messages, index, colour=self.colour, size=size)


def recognise(path: Path) -> bool:
    """Whether a path is a recording, or a folder that holds one and is no other log."""
    return path.suffix.lower() == ENDING if path.is_file() else len(recordings(path)) == 1


def recordings(folder: Path) -> list[Path]:
    """The .mcap files of a folder, by name."""
    return sorted(
        file for file in folder.iterdir() if file.suffix.lower() == ENDING and not file.name.startswith(".") and file.is_file()
    )


def open_mcap(path: Path, gnss: Path | None = None) -> McapLog:
    """Open without decoding more than the first pair. Raises LogError or CalibrationError."""
    path = path if path.is_file() else recordings(path)[0]
    file, sidecar = McapFile(path), read_sidecar(path.parent)
    found = find_rig(file, sidecar)
    places = read_places(file, found.frame_id, found.R_rect)
    names = {topic.name for topic in found.topics} | {t.name for t in file.topics if t.kind in ros_kinds() and t.encoding == "cdr"}
    messages = file.messages(names)
    images, lacking = paired(file, found, messages)
    t_ns = images[0].t_ns
    first = [first_image(file, topic, of) for topic, of in zip(found.topics, images, strict=True)]
    sizes = [(image.shape[1], image.shape[0]) for image in first]
    rig, rectifier = found.rectified((sizes[0], sizes[1]))
    if gnss is not None:
        positioning = find_positioning(path.parent, gnss, FrameClock(tuple(range(len(t_ns))), t_ns), np.eye(3, 4), sidecar)
        track, p_cam_gnss, missing = positioning.gnss, positioning.p_cam_gnss, positioning.missing
        missing = tuple(what for what in missing if what != "IMU")
    else:
        track, place, missing = read_fixes(file, messages, sidecar, places)
        p_cam_gnss, is_known = lever_arm(sidecar, place)
        missing += ("lever arm",) if track is not None and not is_known else ()
    imu, T_cam_imu, without = read_imu(file, messages, sidecar, places)
    truth = read_truth(file, messages, t_ns, found)
    note = path.parent / SIDECAR_NAME
    return McapLog(
        path=path,
        format=FORMAT,
        name=utf8_text(path.stem),
        rig=rig,
        t_ns=t_ns,
        colour=first[0].ndim == 3,
        gnss=track,
        imu=imu,
        p_cam_gnss=p_cam_gnss,
        receiver=sidecar.receiver,
        T_cam_imu=T_cam_imu,
        truth=truth,
        rig_id=sidecar.rig_id,
        vehicle_id=sidecar.vehicle_id,
        missing=(*([file.cut] if file.cut else []), *lacking, *missing, *without, *(() if truth is not None else ("truth poses",))),
        root=path.parent,
        files=tuple(sorted([path.name, *([SIDECAR_NAME] if note.is_file() else [])])),
        stored_sizes=(sizes[0], sizes[1]),
        rectifier=rectifier,
        exposure_s=read_exposures(file, messages, found.topics, t_ns),
        file=file,
        topics=found.topics,
        images=images,
    )


def ros_kinds() -> tuple[str, ...]:
    """The message types that are read besides images."""
    return ros.NAV_SAT_FIX, ros.IMU, ros.POSE, ros.EXPOSURE


def paired(file: McapFile, found: McapRig, messages: dict[str, Messages]) -> tuple[tuple[Messages, Messages], tuple[str, ...]]:
    """The left and right images that belong together, in order, and what is missing, in words. Raises LogError."""
    left, right = (messages[topic.name] for topic in found.topics)
    for topic, of in zip(found.topics, (left, right), strict=True):
        repeated = np.flatnonzero(np.diff(of.t_ns) == 0)
        if len(repeated):
            what = f"two images have the time stamp {of.t_ns[repeated[0]] / NS:.9f}"
            raise LogError(what, file=file.path, record=topic.name, remedy="leave one of them out", reason="image.ambiguous")
    rows = taken_together(left.t_ns, right.t_ns)
    if not len(rows[0]):
        what = f"no image of {found.topics[1].name} was taken with one of {found.topics[0].name}"
        raise LogError(what, file=file.path, remedy="the cameras must be triggered together, on one clock", reason="image.unpaired")
    lacking = []
    for side, topic, alone in ((0, found.topics[0], len(left)), (1, found.topics[1], len(right))):
        without = alone - len(rows[0])
        if without > 0:
            lacking.append(f"{('right', 'left')[side]} image for {without} of {alone} of {topic.name}")
    return (chosen(left, rows[0]), chosen(right, rows[1])), tuple(lacking)


def chosen(messages: Messages, rows: NDArray[np.int64]) -> Messages:
    """The messages of these rows."""
    return Messages(messages.t_ns[rows], messages.chunk[rows], messages.start[rows], messages.length[rows], messages.translator)


def read_image(
    file: McapFile, topic: Topic, messages: Messages, index: int, *, colour: bool | None, size: tuple[int, int] | None
) -> Image:
    """An image of a topic, (h, w) grey or (h, w, 3) RGB; as it is recorded where `colour` is None. Raises LogError."""
    where = f"{topic.name} at {messages.t_ns[index] / NS:.9f} s"
    try:
        data = file.read(messages, index)
        if topic.kind == ros.COMPRESSED:
            image = decode_image(bytes(ros.read_compressed(data)[1]), file.path, colour=colour, record=where)
        else:
            image = in_colour(ros.read_raw_image(data)[1], colour)
    except CdrError as problem:
        raise LogError(
            str(problem), file=file.path, record=where, remedy="record images that can be read", reason="image.undecodable"
        ) from None
    if size is not None:
        check_size(ImageHeader(image.shape[1], image.shape[0], image.ndim == 3), size, file.path, where)
    return image


def first_image(file: McapFile, topic: Topic, messages: Messages) -> Image:
    """The first image that can be decoded, of the first few. Raises the LogError of the first where there is none."""
    return first_that_can(lambda index: read_image(file, topic, messages, index, colour=None, size=None), range(len(messages)))


def in_colour(image: Image, colour: bool | None) -> Image:
    """The image (h, w) or (h, w, 3) converted to grey (BT.601, as OpenCV's reader does) or RGB."""
    if colour is None or colour == (image.ndim == 3):
        return image
    if colour:
        return np.repeat(image[..., None], 3, axis=2)
    return np.asarray(image @ np.array([0.299, 0.587, 0.114]) + 0.5, np.uint8)
