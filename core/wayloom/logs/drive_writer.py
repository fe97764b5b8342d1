"""Base class of the drive writers: atomic, resumable writing of images, time stamps, calibration and sensor records."""

import shutil
import tempfile
from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Final, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.errors import LogError
from wayloom.files.atomic import link_or_copy, remove_unfinished, write_atomically
from wayloom.files.trajectory_files import write_kitti
from wayloom.geometry.camera import StereoRig
from wayloom.geometry.rectification import Coefficients
from wayloom.logs.sidecars.exposure_csv import EXPOSURE_NAME, write_exposure_csv
from wayloom.logs.sidecars.gnss_csv import GNSS_NAME, write_gnss_csv
from wayloom.logs.sidecars.imu_csv import IMU_NAME, write_imu_csv
from wayloom.logs.sidecars.oxts_writer import OxtsPacket, OxtsWriter
from wayloom.logs.sidecars.sidecar import SIDECAR_NAME, Sidecar
from wayloom.logs.types import NOTHING_STATED, GnssTrack, Image, ImuTrack, StatedReceiver, StereoFrame

FloatArray = NDArray[np.float64]
SIDES: Final = ("left", "right")


@dataclass(frozen=True, slots=True)
class SensorExtrinsics:
    """Mounting of the sensors beside the cameras, each None where unknown or absent.

    p_cam_gnss   (3,) m, the antenna in the left camera's frame
    receiver     what is stated of its clock and place
    T_cam_imu    (4, 4), the IMU's frame into the left camera's
    T_cam_lidar  (4, 4), the LiDAR's frame into the left camera's
    """

    p_cam_gnss: FloatArray | None = None
    T_cam_imu: FloatArray | None = None
    T_cam_lidar: FloatArray | None = None
    receiver: StatedReceiver = NOTHING_STATED


@dataclass(frozen=True, slots=True)
class ImageEncoding:
    """Format of a drive's images.

    colour        whether frames are RGB
    jpeg_quality  write JPEG of this quality (1 to 100) instead of PNG
    distortion    k1 k2 p1 p2 k3 of both images, which are then as the lens made them, with K of the rig
    """

    colour: bool = True
    jpeg_quality: int | None = None
    distortion: Coefficients | None = None


class DriveWriter(ABC):
    """Streaming writer of a drive. Use it as a context manager: the drive appears at `path` at the end, or not at all.

    path         where the drive will be; must not exist, or be an empty folder
    folder       where to write while the drive is not whole; anything put there moves with it
    spool        a folder of the writer's own beside it, which goes when the drive is whole
    resume       keep what was written when it is interrupted, and continue what an interrupted writer of this path left: frames
                 that are whole are then passed to `count` instead of `add`. Else nothing is left behind
    """

    name_digits: int
    wants_packets = False
    """Whether positions belong into an `oxts` folder rather than into gnss.csv."""
    holds_raw_images = False
    """Whether images may be as the lens made them."""
    holds_partial_truth = False
    """Whether some frames may have no true pose: NaN."""
    has_labels = False
    """Whether the layout has a place for label images and labelled clouds."""

    def __init__(
        self,
        path: Path,
        rig: StereoRig,
        *,
        rig_id: str | None = None,
        vehicle_id: str | None = None,
        extrinsics: SensorExtrinsics = SensorExtrinsics(),
        encoding: ImageEncoding = ImageEncoding(),
        resume: bool = False,
    ) -> None:
        if path.exists() and (not path.is_dir() or any(path.iterdir())):
            raise LogError("exists and is no empty folder", file=path, remedy="remove it or give another path")
        p_cam_gnss, T_cam_imu = extrinsics.p_cam_gnss, extrinsics.T_cam_imu
        self.path, self.rig, self.T_cam_imu, self.T_cam_lidar = path, rig, T_cam_imu, extrinsics.T_cam_lidar
        if encoding.distortion is not None and not self.holds_raw_images:
            raise LogError(
                "this layout holds rectified images only", file=path, remedy="rectify the images, or take another layout"
            )
        self.colour, self.jpeg_quality, self.distortion = encoding.colour, encoding.jpeg_quality, encoding.distortion
        self.resume = resume
        self.times_ns: list[int] = []
        self.truth: list[FloatArray] = []
        self.gnss: GnssTrack | None = None
        self.imu: ImuTrack | None = None
        self.exposure_s: FloatArray | None = None
        self.packets: list[OxtsPacket] = []
        self.sidecar = Sidecar(
            rig_id=rig_id,
            vehicle_id=vehicle_id,
            p_cam_gnss_m=None if p_cam_gnss is None else tuple(p_cam_gnss.tolist()),
            p_cam_gnss_sigma_m=extrinsics.receiver.lever_sigma_m,
            gnss_time_offset_s=None if extrinsics.receiver.time_offset_sigma_s is None else extrinsics.receiver.time_offset_s,
            gnss_time_offset_sigma_s=extrinsics.receiver.time_offset_sigma_s,
            T_cam_imu=None if T_cam_imu is None else tuple(tuple(row) for row in T_cam_imu.tolist()),
        )
        path.parent.mkdir(parents=True, exist_ok=True)
        if resume:
            self._base = unfinished_folder(path)
            self._base.mkdir(exist_ok=True)
            remove_unfinished(self._base)
        else:
            self._base = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
        self.folder, self.spool = self._base / "drive", self._base / "spool"
        self.folder.mkdir(exist_ok=True)

    @abstractmethod
    def image_folders(self) -> tuple[Path, Path]:
        """The folders of the left and the right images."""

    @abstractmethod
    def write_calibration(self) -> None:
        """Write the calibration files."""

    @abstractmethod
    def write_times(self) -> None:
        """Write the frames' time stamps."""

    @abstractmethod
    def lidar_file(self, index: int) -> Path:
        """Path of the scan of a frame: float32 x, y, z, reflectance."""

    @classmethod
    def folder_name(cls, name: str, distorted: bool) -> str:
        """The name of a drive's folder in this layout."""
        return name

    def image_files(self, index: int) -> tuple[Path, Path]:
        """Paths of the left and the right image of a frame."""
        name = f"{index:0{self.name_digits}d}.{'png' if self.jpeg_quality is None else 'jpg'}"
        left, right = self.image_folders()
        return left / name, right / name

    def add(self, frame: StereoFrame, T_world_cam: FloatArray | None = None) -> None:
        """Write the next frame and keep its true pose (4, 4), which all frames have or none.

        Raises LogError where the frame does not follow the one before, or is not as the rig says.
        """
        self.write_images(len(self.times_ns), frame.left, frame.right)
        self.count(frame.t_ns, T_world_cam)

    def write_images(self, index: int, left: Image, right: Image) -> None:
        """Write the images of a frame, which `count` counts. Frames may come in any order and from several threads.

        Raises LogError where they are not as the rig says.
        """
        camera = self.rig.camera
        shape = (camera.height, camera.width, 3) if self.colour else (camera.height, camera.width)
        for file, image in zip(self.image_files(index), (left, right), strict=True):
            if image.shape != shape:
                raise LogError(f"frame {index} is {image.shape}, the rig's images are {shape}", file=self.path)
            write_atomically(file, encoded(image, self.jpeg_quality))

    def write_encoded(self, index: int, left: bytes, right: bytes) -> None:
        """Write the images of a frame, which `count` counts, as the PNG or JPEG files that they are already."""
        for file, data in zip(self.image_files(index), (left, right), strict=True):
            write_atomically(file, data)

    def count(self, t_ns: int, T_world_cam: FloatArray | None = None) -> None:
        """Count the next frame, whose images are there. Raises LogError where it does not follow the one before."""
        if self.times_ns and t_ns <= self.times_ns[-1]:
            raise LogError(f"frame {len(self.times_ns)} is not after the one before it", file=self.path)
        self.times_ns.append(t_ns)
        if T_world_cam is not None:
            self.truth.append(T_world_cam)

    def repeat(self, index: int, source: int) -> None:
        """Make images and scan of frame `index` those of frame `source`: the same files where the disk has hard links."""
        old, new = ((*self.image_files(frame), self.lidar_file(frame)) for frame in (source, index))
        for file, copy in zip(old, new, strict=True):
            if file.is_file():
                link_or_copy(file, copy)

    def write_labels(self, index: int, side: int, class_id: NDArray[np.uint8], instances: NDArray[np.integer]) -> None:
        """Write class_id (h, w) train ids and instances (h, w) of an image, for layouts that hold labels."""
        return

    def write_lidar(
        self,
        index: int,
        points: NDArray[np.float32],
        class_id: NDArray[np.uint8] | None = None,
        instances: NDArray[np.integer] | None = None,
        moving: NDArray[np.bool_] | None = None,
    ) -> None:
        """points (N, 4) x, y, z m in the LiDAR's frame, reflectance 0 to 1: the scan of a frame; and, for layouts that have a
        place for them, each point's train id, thing (from 1 on, 0 for none), and whether that moves."""
        write_atomically(self.lidar_file(index), points.astype("<f4").tobytes())

    def add_gnss(self, packet: OxtsPacket) -> None:
        """Add the next packet of a GNSS/INS unit; they make an `oxts` folder."""
        self.packets.append(packet)

    def set_gnss(self, track: GnssTrack) -> None:
        """Set the fixes of a receiver, with their whole covariance."""
        self.gnss = track

    def set_imu(self, track: ImuTrack) -> None:
        """Set the samples of an IMU whose frame is that of T_cam_imu."""
        self.imu = track

    def set_exposures(self, exposure_s: FloatArray) -> None:
        """Set (N, 2) s, exposure times of all frames, left and right."""
        self.exposure_s = exposure_s

    def oxts_folder(self) -> Path:
        """The folder of the GNSS/INS packets."""
        return self.folder / "oxts"

    def sidecar_folder(self) -> Path:
        """The folder of wayloom.json, gnss.csv, imu.csv and exposure.csv."""
        return self.folder

    def write_positioning(self) -> None:
        """Write GNSS/INS packets, gnss.csv, imu.csv and exposure.csv, as far as there are any."""
        if self.packets:
            shutil.rmtree(self.oxts_folder(), ignore_errors=True)
            oxts = OxtsWriter(self.oxts_folder())
            for packet in self.packets:
                oxts.add(packet)
            oxts.finish()
        if self.gnss is not None:
            write_gnss_csv(self.sidecar_folder() / GNSS_NAME, self.gnss)
        if self.imu is not None:
            write_imu_csv(self.sidecar_folder() / IMU_NAME, self.imu)
        if self.exposure_s is not None:
            write_exposure_csv(self.sidecar_folder() / EXPOSURE_NAME, self.exposure_s)

    def write_truth(self) -> None:
        """Write the true poses."""
        write_kitti(self.folder / "poses.txt", np.array(self.truth))

    def write_sidecar(self) -> None:
        """Write wayloom.json."""
        write_atomically(
            self.sidecar_folder() / SIDECAR_NAME, (self.sidecar.model_dump_json(indent=2, exclude_none=True) + "\n").encode()
        )

    def finish(self) -> Path:
        """Write the small files and put the drive in its place. Raises LogError where it has no frame, or poses for some only."""
        if not self.times_ns or len(self.truth) not in (0, len(self.times_ns)):
            what = f"{len(self.times_ns)} frames with {len(self.truth)} poses are no drive"
            raise LogError(what, file=self.path, remedy="add at least one frame, and a pose for all or none")
        self.write_calibration()
        self.write_times()
        if self.truth:
            self.write_truth()
        self.write_positioning()
        self.write_sidecar()
        self.folder.replace(self.path)
        return self.path

    def discard(self) -> None:
        """Remove everything but the finished drive."""
        shutil.rmtree(self._base, ignore_errors=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self.resume:
            if kind is None:
                self.finish()
                self.discard()
            return
        try:
            if kind is None:
                self.finish()
        finally:
            self.discard()


def unfinished_folder(path: Path) -> Path:
    """The hidden folder, beside a drive's own, in which a drive is written until it is whole."""
    return path.with_name(f".{path.name}.unfinished")


def encoded(image: Image, jpeg_quality: int | None = None) -> bytes:
    """A grey or RGB image as PNG, or as JPEG where a quality is given."""
    bgr = image[..., ::-1] if image.ndim == 3 else image
    if jpeg_quality is None:
        return bytes(cv2.imencode(".png", bgr)[1])
    return bytes(cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, jpeg_quality])[1])


def encoded_map(image: NDArray[np.integer]) -> bytes:
    """A label or depth image (h, w) of 8 or 16 bit as PNG: with large even areas, which run-length coding packs best."""
    parameters = [cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE]
    return bytes(cv2.imencode(".png", image, parameters)[1])


def numbers_text(values: FloatArray) -> str:
    """Numbers, rows first, that are read back exactly."""
    return " ".join(repr(float(value)) for value in values.ravel())


def projection_texts(rig: StereoRig) -> tuple[str, str]:
    """P = K [I | t] of the left and the right camera, as KITTI's files have it."""
    K = rig.camera.K
    left, right = (np.column_stack([K, K @ np.array(t)]) for t in ((0.0, 0.0, 0.0), rig.t_right_left))
    return numbers_text(left), numbers_text(right)
