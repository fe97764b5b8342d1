"""Drive log protocol, stereo frames, GNSS and IMU tracks."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Final, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from wayloom.config.progress import Progress
from wayloom.errors import LogError
from wayloom.geometry.camera import StereoRig

FloatArray = NDArray[np.float64]
Image = NDArray[np.uint8]
Seen = Callable[[Path, bytes], None]
"""What is told of a file that was read as a whole, and of its bytes."""


class FixType(IntEnum):
    """Quality of a GNSS fix."""

    NONE = 0
    SINGLE = 1
    FLOAT = 2
    FIXED = 3


@dataclass(frozen=True, slots=True)
class StereoFrame:
    """One rectified stereo pair.

    index         place in the log, from 0
    t_ns          time stamp, integer nanoseconds
    left, right   (h, w) grey or (h, w, 3) RGB, uint8, of one size
    exposure_s    exposure times of left and right in seconds, times the amplifier's gain; None where the log has none
    """

    index: int
    t_ns: int
    left: Image
    right: Image
    exposure_s: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class GnssTrack:
    """GNSS fixes in time order.

    t_ns            (M,) int64 time stamps, on the clock of the frames
    lon_lat_height  (M, 3) WGS84 degrees, degrees, ellipsoidal metres of the antenna
    covariance_enu  (M, 3, 3) m^2 in the local east, north, up
    fix_type        (M,) uint8, FixType
    """

    t_ns: NDArray[np.int64]
    lon_lat_height: FloatArray
    covariance_enu: FloatArray
    fix_type: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.t_ns)


@dataclass(frozen=True, slots=True)
class ImuTrack:
    """IMU samples in time order: t_ns (M,) int64, specific force (M, 3) m/s^2 and angular rate (M, 3) rad/s in the IMU frame."""

    t_ns: NDArray[np.int64]
    specific_force: FloatArray
    angular_rate: FloatArray


@dataclass(frozen=True, slots=True)
class StatedReceiver:
    """What a log states of its GNSS receiver; None where it does not.

    time_offset_s        by how much the stamps of its fixes are too late against the cameras', s, and the sigma of that
    lever_sigma_m        sigma of p_cam_gnss, m, each axis
    """

    time_offset_s: float = 0.0
    time_offset_sigma_s: float | None = None
    lever_sigma_m: float | None = None


NOTHING_STATED: Final = StatedReceiver()


class DriveLog(Protocol):
    """A drive as a vehicle recorded it. A reader streams: it never holds a drive's images in memory.

    path          folder or file that was opened
    format        key of LOG_FORMATS
    name          short name for people, e.g. the folder's
    rig           the rectified stereo rig of the frames as `frame` returns them
    t_ns          (N,) int64 time stamps of the frames, strictly increasing
    colour        whether frames are RGB
    gnss, imu     None where the log has none
    p_cam_gnss    (3,) m: the antenna in the left camera's frame; zeros where unknown (then "lever arm" is in `missing`)
    receiver      what is stated of the GNSS clock, and how well of the antenna's place
    T_cam_imu     (4, 4), None without IMU
    truth         (N, 4, 4) T_world_cam in any world frame, NaN where unknown; None where the log has none
    rig_id        of the rig, by which a folder of rig files is looked up; None where the log does not say it
    vehicle_id    of the vehicle; None where the log does not say it
    missing       what the reader looked for and did not find, in words
    files         every file that belongs to the log, relative to `root`, with forward slashes, sorted
    root          the folder that `files` are relative to
    """

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

    def __len__(self) -> int: ...

    def frame(self, index: int) -> StereoFrame:
        """Decode (and, where the log is distorted, rectify) one pair. Raises LogError that names the file."""
        ...

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[StereoFrame]:
        """The pairs from start to stop in order, one in memory at a time."""
        ...


@dataclass(frozen=True, slots=True)
class Damage:
    """An image that cannot be used: its frame, and the error that says why. Frame -1: the log's file itself."""

    frame: int
    error: LogError


@runtime_checkable
class StoredLog(DriveLog, Protocol):
    """A `DriveLog` of files that can be looked over. stored_sizes: (width, height) of left and right images as they lie on disk."""

    stored_sizes: tuple[tuple[int, int], tuple[int, int]]

    @property
    def rectifies(self) -> bool:
        """Whether images are rectified as they are read."""
        ...

    def check_headers(self) -> None:
        """Look at every image without decoding it. Raises LogError at the first that is empty, truncated or of another size."""
        ...

    def damaged(self, *, decode: bool, progress: Progress = ..., threads: int = ..., seen: Seen | None = ...) -> list[Damage]:
        """All images that cannot be used, by checking or by decoding them, so many pairs at a time.

        seen : where they are decoded, given each file of its own that was read as a whole, by the thread that read it
        """
        ...

    def kept(self, rows: NDArray[np.int64], missing: tuple[str, ...]) -> "StoredLog":
        """The log of these frames only, in order; `missing` is said in addition."""
        ...
