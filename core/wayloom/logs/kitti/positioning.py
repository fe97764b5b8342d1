"""GNSS and IMU of a KITTI log: their source, the association of fixes with frames, and the lever arm."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import LogError, UnknownFormatError
from wayloom.files.timestamps import NS
from wayloom.logs.kitti.kitti_calibration import CAM_TO_CAM, IMU_TO_VELO, VELO_TO_CAM, T_cam_imu_from_files
from wayloom.logs.sidecars import gnss_csv, imu_csv, oxts
from wayloom.logs.sidecars.gnss_csv import GNSS_NAME
from wayloom.logs.sidecars.imu_csv import IMU_NAME
from wayloom.logs.sidecars.sidecar import Sidecar
from wayloom.logs.types import GnssTrack, ImuTrack

FloatArray = NDArray[np.float64]
LEAST_IMU_RATE_HZ = 50.0
CLOCK_SLACK_NS = 2 * NS
LARGEST_PACE_RATIO = 1.5


@dataclass(frozen=True, slots=True)
class Positioning:
    """GNSS and IMU of a log, the lever arm (zeros where unknown), what was not found, and the files that were read."""

    gnss: GnssTrack | None
    imu: ImuTrack | None
    p_cam_gnss: FloatArray
    T_cam_imu: FloatArray | None
    missing: tuple[str, ...]
    files: tuple[Path, ...]


@dataclass(frozen=True, slots=True)
class FrameClock:
    """The frames' file numbers and time stamps (N,) int64 ns: what GNSS packets are matched against."""

    numbers: tuple[int, ...]
    t_ns: NDArray[np.int64]

    def overlaps(self, t_ns: NDArray[np.int64]) -> bool:
        """Whether these time stamps can be of the same clock: the two spans meet."""
        return bool(len(t_ns) and t_ns[0] <= self.t_ns[-1] + CLOCK_SLACK_NS and t_ns[-1] >= self.t_ns[0] - CLOCK_SLACK_NS)


@dataclass(frozen=True, slots=True)
class Unit:
    """The GNSS/INS unit of a log whose layout says where it sits: T_cam_unit (4, 4), and the files that say it."""

    T_cam_unit: FloatArray
    files: tuple[Path, ...]


def find_positioning(
    log_folder: Path, gnss: Path | None, clock: FrameClock, P_left: FloatArray, sidecar: Sidecar, unit: Unit | None = None
) -> Positioning:
    """The GNSS that was given, else the log's own `oxts` folder or `gnss.csv`, else none; `imu.csv`, else what `oxts` holds at
    an IMU's rate. Raises LogError or CalibrationError.

    log_folder : where `oxts`, `gnss.csv` and `imu.csv` are looked for
    P_left     : (3, 4) projection matrix of the left camera in KITTI's rectified frame 0
    unit       : where the GNSS/INS unit sits; None looks for KITTI's calibration files
    """
    source = locate(gnss) if gnss is not None else own_source(log_folder)
    track: GnssTrack | None = None
    imu: ImuTrack | None = None
    T_cam_unit: FloatArray | None = None
    files: tuple[Path, ...] = ()
    missing: tuple[str, ...] = ()
    if source is None:
        missing = ("GNSS",)
    elif source.suffix == ".csv":
        track, files = read_csv(source, clock), (source,)
    else:
        by_number = gnss is not None and not source.parent.name.endswith("_extract")
        track, imu, files, missing = read_oxts(source, clock, by_number=by_number)
        if unit is None:
            T_cam_unit, calibration_files, lacking = find_T_cam_imu(source.parent, log_folder, P_left)
        else:
            T_cam_unit, calibration_files, lacking = unit.T_cam_unit, unit.files, ()
        files, missing = files + calibration_files, missing + lacking
    T_cam_imu = T_cam_unit if sidecar.T_cam_imu is None else np.array(sidecar.T_cam_imu)
    own_imu = log_folder / IMU_NAME
    if own_imu.is_file():
        imu, files = read_imu(own_imu, clock), (*files, own_imu)
    if imu is None:
        missing += ("IMU",)
    elif T_cam_imu is None:
        imu, missing = (
            None,
            (*missing, f"T_cam_imu: without it the samples of {own_imu.name if own_imu.is_file() else 'oxts'} are left out"),
        )
    p_cam_gnss, is_known = lever_arm(sidecar, T_cam_imu if source is not None and source.suffix != ".csv" else None)
    missing += ("lever arm",) if track is not None and not is_known else ()
    return Positioning(track, imu, p_cam_gnss, T_cam_imu, missing, files)


def lever_arm(sidecar: Sidecar, T_cam_unit: FloatArray | None) -> tuple[FloatArray, bool]:
    """p_cam_gnss (3,) m and whether it is known: the sidecar's, else the place of the unit, whose position oxts packets hold."""
    if sidecar.p_cam_gnss_m is not None:
        return np.array(sidecar.p_cam_gnss_m), True
    return (np.zeros(3), False) if T_cam_unit is None else (T_cam_unit[:3, 3].copy(), True)


def own_source(log_folder: Path) -> Path | None:
    """The GNSS that lies inside a log's folder: an `oxts` folder or `gnss.csv`."""
    for candidate in (log_folder / "oxts", log_folder / GNSS_NAME):
        if candidate.exists():
            return candidate
    return None


def locate(gnss: Path) -> Path:
    """The oxts folder or CSV file that a GNSS path means. Raises LogError for no such path, UnknownFormatError else."""
    if not gnss.exists():
        raise LogError("no such file or folder", file=gnss, remedy="give a KITTI …_sync folder, its oxts folder or a gnss.csv")
    if gnss.is_file() and gnss.suffix == ".csv":
        return gnss
    for folder in (gnss / "oxts", gnss):
        if (folder / "data").is_dir():
            return folder
    what = "no GNSS log: looked for oxts/data, data and a .csv file"
    raise UnknownFormatError(what, file=gnss, remedy="give a KITTI …_sync folder, its oxts folder or a gnss.csv")


def read_oxts(
    folder: Path, clock: FrameClock, *, by_number: bool
) -> tuple[GnssTrack, ImuTrack | None, tuple[Path, ...], tuple[str, ...]]:
    """Packets as fixes on the clock of the frames, IMU where it is fast enough, the files read, and what is missing.

    By number: packet n belongs to the frame numbered n and takes its time stamp. Else the packets' own time stamps count,
    where they are of the frames' clock; where they are not, the packets belong to the frames by number.
    """
    packets = oxts.read_packets(folder, frozenset(clock.numbers) if by_number else None)
    files = (*packets.files, *(folder / name for name in ("timestamps.txt", "dataformat.txt") if (folder / name).is_file()))
    if not by_number and packets.t_ns is not None and clock.overlaps(packets.t_ns):
        t_ns = packets.t_ns
        rate_hz = (len(t_ns) - 1) * NS / max(int(t_ns[-1] - t_ns[0]), 1)
        imu = oxts.imu_track(packets.values, t_ns) if rate_hz >= LEAST_IMU_RATE_HZ else None
        return oxts.gnss_track(packets.values, t_ns), imu, files, ()
    place = {number: i for i, number in enumerate(clock.numbers)}
    keep = [i for i, number in enumerate(packets.numbers) if number in place]
    if not keep:
        what = f"no packet has the number of a frame ({clock.numbers[0]} to {clock.numbers[-1]})"
        raise LogError(what, file=folder, remedy="give the GNSS log of the same drive")
    t_ns = clock.t_ns[[place[packets.numbers[i]] for i in keep]]
    if packets.t_ns is not None:
        check_same_pace(packets.t_ns[keep], t_ns, folder)
    short = () if len(keep) == len(place) else (f"GNSS for {len(place) - len(keep)} of {len(place)} frames",)
    return oxts.gnss_track(packets.values[keep], t_ns), None, files, short


def read_imu(file: Path, clock: FrameClock) -> ImuTrack:
    """The samples of an imu.csv. Raises LogError where they are not on the clock of the frames."""
    track = imu_csv.read_imu_csv(file)
    if not clock.overlaps(track.t_ns):
        gap_s = (int(track.t_ns[0]) - int(clock.t_ns[0])) / NS
        what = f"the samples start {gap_s:.3f} s from the first frame and never meet the frames"
        raise LogError(what, file=file, remedy="give the samples on the clock of the frames", reason="times.other_clock")
    return track


def check_same_pace(packets_ns: NDArray[np.int64], frames_ns: NDArray[np.int64], folder: Path) -> None:
    """Raises LogError where packets and the frames of their numbers (M,) int64 ns span very different times: no packet a frame."""
    packets_s, frames_s = (int(t_ns[-1] - t_ns[0]) / NS for t_ns in (packets_ns, frames_ns))
    if len(packets_ns) > 1 and not 1 / LARGEST_PACE_RATIO < packets_s / frames_s < LARGEST_PACE_RATIO:
        what = f"{len(packets_ns)} packets span {packets_s:.2f} s, the frames of their numbers {frames_s:.2f} s"
        raise LogError(what, file=folder, remedy="give a log with one packet a frame (KITTI's …_sync), or one on the frames' clock")


def find_T_cam_imu(
    drive: Path, log_folder: Path, P_left: FloatArray
) -> tuple[FloatArray | None, tuple[Path, ...], tuple[str, ...]]:
    """T_cam_imu from the calibration files inside or beside the GNSS drive or the log; None where they are nowhere."""
    places = (drive, drive.parent, log_folder, log_folder.parent)
    imu_to_velo, velo_to_cam = (first_file(name, places) for name in (IMU_TO_VELO, VELO_TO_CAM))
    cam_to_cam = first_file(CAM_TO_CAM, (*places[2:], *places[:2]))  # the log's own rectification, where it has one
    if imu_to_velo is None or velo_to_cam is None:
        return None, (), ()
    T = T_cam_imu_from_files(imu_to_velo, velo_to_cam, cam_to_cam, P_left)
    lacking = () if cam_to_cam else (f"{CAM_TO_CAM} (its R_rect_00 is taken as identity: the lever arm is good to about 1 cm)",)
    return T, tuple(file for file in (imu_to_velo, velo_to_cam, cam_to_cam) if file), lacking


def first_file(name: str, places: tuple[Path, ...]) -> Path | None:
    """The first file of this name in these folders."""
    return next((place / name for place in places if (place / name).is_file()), None)


def read_csv(file: Path, clock: FrameClock) -> GnssTrack:
    """The fixes of a gnss.csv. Raises LogError where they are not on the clock of the frames."""
    track = gnss_csv.read_gnss_csv(file)
    if not clock.overlaps(track.t_ns):
        gap_s = (int(track.t_ns[0]) - int(clock.t_ns[0])) / NS
        what = f"the fixes start {gap_s:.3f} s from the first frame and never meet the frames"
        raise LogError(what, file=file, remedy="give the fixes on the clock of the frames", reason="times.other_clock")
    return track
