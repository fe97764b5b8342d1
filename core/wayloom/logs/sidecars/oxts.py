"""GNSS/INS packets of KITTI's `oxts` folder: one text file of 30 numbers a packet, and their time stamps.

Position: the packet's latitude, longitude and altitude, which is taken as ellipsoidal. It is the unit's place, not the antenna's.
Covariance: pos_accuracy is the sigma of east and of north; the sigma of up is UP_FACTOR times that, as satellites below the horizon
are missing. Fix type: FIX_OF_POSMODE.
"""

import sys
from collections.abc import Container
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import LogError
from wayloom.files.text_files import parse_numbers, read_text
from wayloom.files.timestamps import NS, ns_from_wall_clock, read_times, times_of_numbers
from wayloom.geodesy.map_frame import MapFrame
from wayloom.geodesy.wgs84 import enu_from_lonlatheight
from wayloom.geometry import se3
from wayloom.logs.types import FixType, GnssTrack, ImuTrack

FloatArray = NDArray[np.float64]
UP_FACTOR: Final = 2.0
SMALLEST_SIGMA_M: Final = 0.005
LOCKED: Final = 4
WORST_BRIDGED_SIGMA_M: Final = 10.0
ASSUMED_SIGMA_M: Final = {FixType.NONE: 50.0, FixType.SINGLE: 3.0, FixType.FLOAT: 0.5, FixType.FIXED: 0.05}
RESTORE = "copy the packet again, or leave it out"

# OxTS NCOM position modes, as KITTI's gps_mode_to_string has them: what the receiver had, not what the INS made of it.
FIX_OF_POSMODE: Final = {
    0: FixType.NONE,  # none
    1: FixType.NONE,  # search
    2: FixType.NONE,  # doppler: velocity only
    3: FixType.SINGLE,  # standard positioning
    4: FixType.SINGLE,  # differential, pseudo-range
    5: FixType.FLOAT,  # RTK float
    6: FixType.FIXED,  # RTK integer
    7: FixType.SINGLE,  # WAAS
    8: FixType.SINGLE,  # OmniSTAR VBS
    9: FixType.FLOAT,  # OmniSTAR HP
    10: FixType.NONE,  # no data
    11: FixType.NONE,  # blanked
    12: FixType.NONE,  # doppler, post-processed
    13: FixType.SINGLE,  # standard, post-processed
    14: FixType.SINGLE,  # differential, post-processed
    15: FixType.FLOAT,  # RTK float, post-processed
    16: FixType.FIXED,  # RTK integer, post-processed
    17: FixType.FLOAT,  # OmniSTAR XP
    18: FixType.SINGLE,  # CDGPS
}
"""A mode that is not in the table (KITTI's interpolated packets say -1) is SINGLE."""


class Field(IntEnum):
    """Column of a packet, in the order of KITTI's dataformat.txt."""

    LAT, LON, ALT, ROLL, PITCH, YAW, VN, VE, VF, VL, VU = range(11)
    AX, AY, AZ, AF, AL, AU, WX, WY, WZ, WF, WL, WU = range(11, 23)
    POS_ACCURACY, VEL_ACCURACY, NAVSTAT, NUMSATS, POSMODE, VELMODE, ORIMODE = range(23, 30)


@dataclass(frozen=True, slots=True)
class OxtsPackets:
    """files (M,) and their numbers; t_ns (M,) int64 or None where the folder has no time stamps; values (M, 30)."""

    files: tuple[Path, ...]
    numbers: tuple[int, ...]
    t_ns: NDArray[np.int64] | None
    values: FloatArray


@dataclass(frozen=True, slots=True)
class InsTrajectory:
    """Trajectory of the GNSS/INS unit by its own packets.

    t_ns              (M,) int64
    T_enu_imu         (M, 4, 4): positions as said, in the tangent plane of the first packet; x forward, y left, z up
    integrated_enu    (M, 3) m: the velocities integrated by the trapezoid rule from (0, 0, 0); smooth where positions jump
    lon_lat_height    (M, 3) degrees, degrees, m
    """

    t_ns: NDArray[np.int64]
    T_enu_imu: FloatArray
    integrated_enu: FloatArray
    lon_lat_height: FloatArray

    @property
    def distance_m(self) -> float:
        """Length of the integrated way."""
        return float(np.linalg.norm(np.diff(self.integrated_enu, axis=0), axis=1).sum())


def packet_files(folder: Path) -> tuple[tuple[int, ...], tuple[Path, ...]]:
    """The packets of an oxts folder by number. Raises LogError where there is none."""
    try:
        found = sorted((int(file.stem), file) for file in (folder / "data").glob("*.txt") if file.stem.isdecimal())
    except OSError as problem:
        raise LogError(f"cannot be listed ({problem.strerror})", file=folder, remedy="check its permissions") from None
    if not found:
        raise LogError("no GNSS packets", file=folder / "data", remedy="give the oxts folder of a KITTI drive")
    return tuple(number for number, _ in found), tuple(file for _, file in found)


def read_packets(folder: Path, wanted: Container[int] | None = None) -> OxtsPackets:
    """The packets of an oxts folder, all or those with the wanted numbers. Raises LogError naming file and record."""
    numbers, files = packet_files(folder)
    stamps = folder / "timestamps.txt"
    t_ns = None
    if stamps.is_file():
        read = read_times(stamps, ns_from_wall_clock, remedy="restore the time stamps")
        t_ns = times_of_numbers(read, numbers, file=stamps, what="GNSS packets")
    keep = [i for i, number in enumerate(numbers) if wanted is None or number in wanted]
    values = np.array([read_packet(files[i]) for i in keep]).reshape(-1, len(Field))
    return OxtsPackets(tuple(files[i] for i in keep), tuple(numbers[i] for i in keep), None if t_ns is None else t_ns[keep], values)


def read_packet(file: Path) -> FloatArray:
    """(30,) the numbers of a packet. Raises LogError where one is missing, not finite, or the place is not on earth."""
    text = read_text(file, remedy=RESTORE)
    values = parse_numbers(text, file=file, record="line 1", count=len(Field))
    lat, lon, alt = values[:3]
    if not (abs(lat) <= 90 and abs(lon) <= 180 and -1_000 <= alt <= 20_000):
        raise LogError(f"latitude {lat:g}, longitude {lon:g}, altitude {alt:g} is no place", file=file, remedy=RESTORE)
    if np.abs(values).max() > 1e9 or values[Field.POS_ACCURACY] > 1e6:
        raise LogError("a number is out of all range", file=file, remedy=RESTORE)
    return values


def fix_types(values: FloatArray) -> NDArray[np.uint8]:
    """(M,) FixType of packets (M, 30).

    Where the receiver had no position but the locked unit still says how well it knows its place, it has bridged the gap by
    inertia (all of KITTI's 2011_09_26_drive_0106 is so, at 0.4 to 1.4 m): that place is as good as its covariance, hence SINGLE.
    """
    modes = values[:, Field.POSMODE].round().astype(np.int64)
    fix = np.array([FIX_OF_POSMODE.get(int(mode), FixType.SINGLE) for mode in modes], dtype=np.uint8)
    sigma = values[:, Field.POS_ACCURACY]
    bridged = (fix == FixType.NONE) & (values[:, Field.NAVSTAT].round() == LOCKED) & (sigma > 0) & (sigma <= WORST_BRIDGED_SIGMA_M)
    fix[bridged] = FixType.SINGLE
    return fix


def gnss_track(values: FloatArray, t_ns: NDArray[np.int64]) -> GnssTrack:
    """Packets (M, 30) at t_ns (M,) as GNSS fixes."""
    fix = fix_types(values)
    stated = values[:, Field.POS_ACCURACY]
    assumed = np.array([ASSUMED_SIGMA_M[FixType(f)] for f in fix])
    sigma = np.where(stated > 0, np.maximum(stated, SMALLEST_SIGMA_M), assumed)
    covariance = np.zeros((len(values), 3, 3))
    covariance[:, 0, 0] = covariance[:, 1, 1] = sigma**2
    covariance[:, 2, 2] = (UP_FACTOR * sigma) ** 2
    return GnssTrack(t_ns, values[:, [Field.LON, Field.LAT, Field.ALT]].copy(), covariance, fix)


def imu_track(values: FloatArray, t_ns: NDArray[np.int64]) -> ImuTrack:
    """Packets (M, 30) at t_ns (M,) as IMU samples: x forward, y left, z up."""
    return ImuTrack(t_ns, values[:, Field.AX : Field.AZ + 1].copy(), values[:, Field.WX : Field.WZ + 1].copy())


def R_enu_imu(roll: FloatArray, pitch: FloatArray, yaw: FloatArray) -> FloatArray:
    """Angles (M,) rad to (M, 3, 3): R = Rz(yaw) Ry(pitch) Rx(roll), KITTI's order; yaw 0 is east, counter-clockwise."""
    zero = np.zeros_like(roll)
    about = [se3.exp(np.stack([zero] * 3 + axis, axis=-1))[:, :3, :3] for axis in (
        [zero, zero, yaw], [zero, pitch, zero], [roll, zero, zero],
    )]  # fmt: skip
    return np.asarray(about[0] @ about[1] @ about[2], dtype=np.float64)


def velocity_enu(values: FloatArray) -> FloatArray:
    """(M, 3) m/s as the unit says it of east, north and up.

    Not from forward and leftward velocity: KITTI's recordings count the latter to the right, whatever their description says
    (in all of the drives tried, east and north agree with it to a tenth of m/s so, and differ by up to 0.8 m/s otherwise).
    """
    return np.column_stack([values[:, Field.VE], values[:, Field.VN], values[:, Field.VU]])


def ins_trajectory(folder: Path, first: int = 0, count: int | None = None) -> InsTrajectory:
    """The INS's own way from an oxts folder (or a drive's folder that holds one), `count` packets from number `first` on.

    Raises LogError where there are no packets or no time stamps.
    """
    oxts = folder / "oxts" if (folder / "oxts").is_dir() else folder
    packets = read_packets(oxts, range(first, sys.maxsize if count is None else first + count))
    if packets.t_ns is None:
        raise LogError("no such file", file=oxts / "timestamps.txt", remedy="velocities cannot be integrated without time stamps")
    values = packets.values
    lon_lat_height = values[:, [Field.LON, Field.LAT, Field.ALT]].copy()
    T = se3.from_rotation_translation(
        R_enu_imu(values[:, Field.ROLL], values[:, Field.PITCH], values[:, Field.YAW]),
        enu_from_lonlatheight(lon_lat_height, MapFrame(*lon_lat_height[0].tolist())) if len(values) else np.zeros((0, 3)),
    )
    v = velocity_enu(values)
    steps = 0.5 * (v[1:] + v[:-1]) * (np.diff(packets.t_ns) / NS)[:, None]
    return InsTrajectory(packets.t_ns, T, np.vstack([np.zeros((1, 3)), np.cumsum(steps, axis=0)]), lon_lat_height)
