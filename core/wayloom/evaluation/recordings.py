"""Accuracy of tracking and geo-referencing on one recording: a row of docs/results.md."""

import time
from collections.abc import Mapping
from copy import copy
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wayloom.calibration.self_calibration import track_calibrated
from wayloom.config.progress import Progress, silent
from wayloom.evaluation.georeference import TrackDistance, distance_to_ins
from wayloom.evaluation.trajectory import TrajectoryErrors, evaluate, path_length
from wayloom.geometry import se3
from wayloom.georeference.alignment import georeference
from wayloom.logs.registry import open_log
from wayloom.logs.sidecars.oxts import ins_trajectory
from wayloom.logs.types import DriveLog, GnssTrack
from wayloom.odometry.settings import OdometrySettings
from wayloom.odometry.types import OdometryResult

FloatArray = NDArray[np.float64]
SPARSE_FIXES = 20


@dataclass(frozen=True, slots=True)
class RecordingRow:
    """Measurements of one recording.

    frames, tracked, segments   how much of it was tracked in one piece
    cpu_ms_per_frame            processor time of all threads, image decoding included, compiled kernels loaded before
    same_twice                  whether two runs gave the same trajectory, bit by bit
    points_per_m                points of the odometry per metre of road
    errors                      name of the truth to the errors against it
    to_ins                      distance of the mapped antenna to the INS track, all fixes given; None without GNSS
    to_ins_sparse               the same where only one fix in SPARSE_FIXES was given and the others judge
    """

    name: str
    frames: int
    tracked: int
    segments: int
    keyframes: int
    distance_m: float
    cpu_ms_per_frame: float
    points_per_m: float
    disparity_bias_px: float
    same_twice: bool
    errors: dict[str, TrajectoryErrors]
    to_ins: TrackDistance | None
    to_ins_sparse: TrackDistance | None

    def as_json(self) -> dict[str, object]:
        """Nested dict of numbers."""
        return asdict(self)


def measure(
    name: str,
    log: DriveLog,
    truths: Mapping[str, FloatArray],
    settings: OdometrySettings = OdometrySettings(),
    progress: Progress = silent,
) -> RecordingRow:
    """Track a recording twice on one thread (the second run is the one that is timed) and place it on Earth.

    truths : name to T_world_cam (N, 4, 4), NaN where unknown
    """
    first = track_calibrated(log, settings, lambda share, what: progress(0.45 * share, what))
    start = time.process_time()
    odometry = track_calibrated(log, settings, lambda share, what: progress(0.45 + 0.45 * share, what))
    cpu_s = time.process_time() - start
    T = odometry.trajectory.T_world_cam
    distance = path_length(T[:, :3, 3])
    row = RecordingRow(
        name=name,
        frames=len(odometry.trajectory),
        tracked=int(odometry.trajectory.tracked.sum()),
        segments=len(np.unique(odometry.trajectory.segment)),
        keyframes=len(odometry.keyframes),
        distance_m=distance,
        cpu_ms_per_frame=1000.0 * cpu_s / len(odometry.trajectory),
        points_per_m=len(odometry.points) / max(distance, 1.0),
        disparity_bias_px=odometry.disparity_bias_px,
        same_twice=bool(np.array_equal(first.trajectory.T_world_cam, T)),
        errors={truth_name: evaluate(T, truth) for truth_name, truth in truths.items()},
        to_ins=placed_distance(log, odometry, 1),
        to_ins_sparse=placed_distance(log, odometry, SPARSE_FIXES),
    )
    progress(1.0, "measured")
    return row


def placed_distance(log: DriveLog, odometry: OdometryResult, one_in: int) -> TrackDistance | None:
    """Distance of the mapped antenna to all fixes of the log, geo-referenced with one in `one_in` of them; None without GNSS."""
    gnss = log.gnss
    if gnss is None:
        return None
    sparse = copy(log)
    sparse.gnss = every(gnss, one_in)
    geo = georeference(sparse, odometry)
    if geo.frame is None:
        return None
    return distance_to_ins(geo.T_enu_cam, geo.frame, log.p_cam_gnss, log.t_ns, gnss.t_ns, gnss.lon_lat_height)


def every(gnss: GnssTrack, step: int) -> GnssTrack:
    """Every step-th fix, with the first and the last."""
    rows = np.unique(np.append(np.arange(0, len(gnss), step), len(gnss) - 1))
    return replace(
        gnss,
        t_ns=gnss.t_ns[rows],
        lon_lat_height=gnss.lon_lat_height[rows],
        covariance_enu=gnss.covariance_enu[rows],
        fix_type=gnss.fix_type[rows],
    )


def ins_truth(drive: Path, log: DriveLog) -> FloatArray:
    """(N, 4, 4) T_world_cam of a KITTI raw drive from the INS's attitudes and its integrated velocities, packet i for frame i.

    Velocities, not positions: where RTK is lost, positions drift and jump, the velocities go on. Needs the log's T_cam_imu.
    """
    ins = ins_trajectory(drive, 0, len(log))
    T_enu_imu = se3.from_rotation_translation(ins.T_enu_imu[:, :3, :3], ins.integrated_enu)
    T_cam_imu = np.eye(4) if log.T_cam_imu is None else log.T_cam_imu
    return np.asarray(T_enu_imu @ se3.inverse(T_cam_imu), dtype=np.float64)


def from_frame(truth: FloatArray, first: int) -> FloatArray:
    """The same poses, unknown (NaN) before frame `first`."""
    later = truth.copy()
    later[:first] = np.nan
    return later


def measure_kitti_odometry(
    folder: Path, gnss: Path | None, name: str, fault_until: int = 0, progress: Progress = silent
) -> RecordingRow:
    """A KITTI odometry sequence against its own poses, whole and, where these are known to be wrong, from `fault_until` on."""
    log = open_log(folder, gnss=gnss)
    truths = {} if log.truth is None else {"poses": log.truth}
    if log.truth is not None and fault_until:
        truths[f"poses from frame {fault_until}"] = from_frame(log.truth, fault_until)
    return measure(name, log, truths, progress=progress)


def measure_kitti_raw(folder: Path, name: str, progress: Progress = silent) -> RecordingRow:
    """A KITTI raw drive against its INS's integrated velocities."""
    log = open_log(folder)
    return measure(name, log, {"INS velocities": ins_truth(folder, log)}, progress=progress)
