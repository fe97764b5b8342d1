"""Drive log of two image folders: the common `DriveLog` of KITTI odometry, KITTI raw and KITTI-360."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.config.progress import Progress, silent
from wayloom.config.side_by_side import in_order
from wayloom.errors import LogError
from wayloom.files.text_files import read_bytes, utf8_text
from wayloom.geometry.camera import StereoRig
from wayloom.logs.images.image_files import COPY_AGAIN, ImageHeader, ImagePairs, check_image, read_header, read_image
from wayloom.logs.kitti.positioning import Positioning
from wayloom.logs.sidecars.exposure_csv import EXPOSURE_NAME, read_exposure_csv
from wayloom.logs.sidecars.sidecar import SIDECAR_NAME, Sidecar
from wayloom.logs.types import Damage, GnssTrack, Image, ImuTrack, Seen, StatedReceiver, StereoFrame

FloatArray = NDArray[np.float64]
Maps = tuple[NDArray[np.float32], NDArray[np.float32]]


@dataclass(frozen=True, slots=True)
class Rectifier:
    """Sampling maps (u, v), each (h, w) float32 pixels of the distorted image, for the left and the right camera."""

    left: Maps
    right: Maps

    def __call__(self, left: Image, right: Image) -> tuple[Image, Image]:
        """The rectified pair, bilinear; black where the lens saw nothing."""
        return tuple(cv2.remap(image, *maps, cv2.INTER_LINEAR) for image, maps in ((left, self.left), (right, self.right)))  # type: ignore[return-value]


@dataclass(slots=True)
class ImageFolderLog:
    """A `DriveLog` of image files. `stored_sizes` are (width, height) of left and right images as they lie on disk, `exposure_s`
    (N, 2) the exposure times of left and right where the log has them."""

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
    pairs: ImagePairs
    stored_sizes: tuple[tuple[int, int], tuple[int, int]]
    rectifier: Rectifier | None
    exposure_s: FloatArray | None = None

    def __len__(self) -> int:
        return len(self.t_ns)

    def frame(self, index: int) -> StereoFrame:
        """Decode (and, where the log is distorted, rectify) one pair. Raises LogError that names the file."""
        if not 0 <= index < len(self):
            raise IndexError(f"frame {index} of {len(self)}")
        left, right = (self._read(files[index], size, self.colour) for files, size in self._sides())
        if self.rectifier is not None:
            left, right = self.rectifier(left, right)
        exposed = None if self.exposure_s is None else (float(self.exposure_s[index, 0]), float(self.exposure_s[index, 1]))
        return StereoFrame(index, int(self.t_ns[index]), left, right, exposed)

    def grey_side(self, index: int, right: bool) -> Image:
        """Decode one image of a pair to grey (h, w), for those who need no colour or not both. Raises LogError as `frame`."""
        files, size = self._sides()[right]
        image = read_image(files[index], colour=False)
        check_size(ImageHeader(image.shape[1], image.shape[0], False), size, files[index])
        if self.rectifier is None:
            return image
        maps = self.rectifier.right if right else self.rectifier.left
        return np.asarray(cv2.remap(image, *maps, cv2.INTER_LINEAR), np.uint8)

    def encoded_pair(self, index: int) -> tuple[bytes, bytes] | None:
        """The files of a pair as they are stored; None where they are not rectified. Raises LogError as `frame`."""
        if self.rectifier is not None:
            return None
        return read_bytes(self.pairs.left[index], remedy=COPY_AGAIN), read_bytes(self.pairs.right[index], remedy=COPY_AGAIN)

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[StereoFrame]:
        """The pairs from start to stop in order, one in memory at a time."""
        for index in range(start, len(self) if stop is None else min(stop, len(self))):
            yield self.frame(index)

    @property
    def rectifies(self) -> bool:
        """Whether images are rectified as they are read."""
        return self.rectifier is not None

    def check_headers(self) -> None:
        """Look at both ends of every image file. Raises LogError at the first that is empty, truncated or of another size."""
        for left, right in zip(self.pairs.left, self.pairs.right, strict=True):
            for file, size in ((left, self.stored_sizes[0]), (right, self.stored_sizes[1])):
                check_size(read_header(file), size, file)

    def damaged(self, *, decode: bool, progress: Progress = silent, threads: int = 1, seen: Seen | None = None) -> list[Damage]:
        """All images that cannot be used, by checking headers and ends or by decoding every file.

        seen : where they are decoded, given each file and its bytes, by the thread that read them
        """

        def damaged_of(i: int) -> list[Damage]:
            found = []
            for files, size in self._sides():
                try:
                    check_size(read_header(files[i]), size, files[i])
                    if decode:
                        check_size(check_image(files[i], seen), size, files[i])
                except LogError as problem:
                    found.append(Damage(i, problem))
            return found

        found: list[Damage] = []
        for count, of_pair in enumerate(in_order(damaged_of, range(len(self)), threads), 1):
            found += of_pair
            progress(count / len(self), "looking at images")
        return found

    def kept(self, rows: NDArray[np.int64], missing: tuple[str, ...]) -> "ImageFolderLog":
        """The log of these frames only, in order; `missing` is said in addition."""
        return replace(
            self,
            t_ns=self.t_ns[rows],
            truth=None if self.truth is None else self.truth[rows],
            exposure_s=None if self.exposure_s is None else self.exposure_s[rows],
            pairs=self.pairs.kept(rows.tolist()),
            missing=(*self.missing, *missing),
        )

    def _sides(self) -> tuple[tuple[Sequence[Path], tuple[int, int]], ...]:
        return (self.pairs.left, self.stored_sizes[0]), (self.pairs.right, self.stored_sizes[1])

    def _read(self, file: Path, size: tuple[int, int], colour: bool) -> Image:
        image = read_image(file, colour=colour)
        check_size(ImageHeader(image.shape[1], image.shape[0], colour), size, file)
        return image


def check_size(header: ImageHeader, size: tuple[int, int], file: Path, record: str | None = None) -> None:
    """Raises LogError where an image is not (width, height) as the log's other images."""
    if (header.width, header.height) != size:
        what = f"the image is {header.width}x{header.height}, the log's others are {size[0]}x{size[1]}"
        remedy = "all images of a log must have one size: export it again"
        raise LogError(what, file=file, record=record, remedy=remedy, reason="image.size")


@dataclass(frozen=True, slots=True)
class StereoSequence:
    """The stereo frames of a log.

    rig           the rectified rig of the frames as they are read
    t_ns          (N,) int64 time stamps
    pairs         image files
    header        of the first left image
    stored_sizes  (width, height) of left and right images as they lie on disk
    rectifier     None where images are stored rectified
    listed        how many frames exposure.csv has, of which the pairs are those with their numbers; None: exactly the pairs
    """

    rig: StereoRig
    t_ns: NDArray[np.int64]
    pairs: ImagePairs
    header: ImageHeader
    stored_sizes: tuple[tuple[int, int], tuple[int, int]]
    rectifier: Rectifier | None = None
    listed: int | None = None


@dataclass(frozen=True, slots=True)
class LogFiles:
    """Files of a log.

    path      the folder that was opened
    root      the folder that `DriveLog.files` are relative to; files outside of it are left out there
    files     calibration, time stamps, truth
    sidecars  the folder in which wayloom.json and exposure.csv may lie
    """

    path: Path
    root: Path
    files: list[Path]
    sidecars: Path


def assemble(
    log_format: str,
    location: LogFiles,
    sequence: StereoSequence,
    positioning: Positioning,
    sidecar: Sidecar,
    truth: FloatArray | None,
    missing: tuple[str, ...],
) -> ImageFolderLog:
    """Put a log together from its parts. truth : (N, 4, 4) T_world_cam, NaN where unknown; missing : in words."""
    root, pairs = location.root, sequence.pairs
    exposures = location.sidecars / EXPOSURE_NAME
    files = [*location.files, *(file for file in (location.sidecars / SIDECAR_NAME, exposures) if file.is_file())]
    others = (file.relative_to(root).as_posix() for file in (*files, *positioning.files) if file.is_relative_to(root))
    return ImageFolderLog(
        path=location.path,
        format=log_format,
        name=utf8_text(location.path.name),
        rig=sequence.rig,
        t_ns=sequence.t_ns,
        colour=sequence.header.colour,
        gnss=positioning.gnss,
        imu=positioning.imu,
        p_cam_gnss=positioning.p_cam_gnss,
        receiver=sidecar.receiver,
        T_cam_imu=positioning.T_cam_imu,
        truth=truth,
        rig_id=sidecar.rig_id,
        vehicle_id=sidecar.vehicle_id,
        missing=missing + positioning.missing,
        root=root,
        files=tuple(sorted({*pairs.left.inside(root), *pairs.right.inside(root), *others})),
        pairs=pairs,
        stored_sizes=sequence.stored_sizes,
        rectifier=sequence.rectifier,
        exposure_s=_exposures(exposures, sequence) if exposures.is_file() else None,
    )


def _exposures(file: Path, sequence: StereoSequence) -> FloatArray:
    """(N, 2) s, left and right, of the frames that are there."""
    if sequence.listed is None:
        return read_exposure_csv(file, len(sequence.t_ns))
    return read_exposure_csv(file, sequence.listed)[list(sequence.pairs.numbers)]
