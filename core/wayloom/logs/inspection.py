"""Inspection report of a drive log: rates, gaps, calibration, GNSS quality, damaged images."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from wayloom.config.progress import Progress, silent
from wayloom.errors import LogError
from wayloom.files.text_files import utf8_text
from wayloom.files.timestamps import NS, wall_clock_from_ns
from wayloom.geodesy.map_frame import MapFrame
from wayloom.geodesy.wgs84 import enu_from_lonlatheight
from wayloom.logs.types import Damage, DriveLog, FixType, GnssTrack, Seen, StoredLog

FloatArray = NDArray[np.float64]
GAP_FACTOR = 1.5
"""A step in time of more than this many usual ones is a gap."""
STEP_M, STEP_SIGMAS = 2.0, 3.0
FIRST_WALL_CLOCK_NS = 946_684_800 * NS
"""Time stamps from the year 2000 on are taken as wall clock."""


class Gap(BaseModel):
    """A hole in the time stamps: after which record (from 0), and how long it is."""

    after: int
    seconds: float


class RateReport(BaseModel):
    """Records of one kind: how many, how fast (the median), how long, and the gaps."""

    count: int
    rate_hz: float
    duration_s: float
    gaps: list[Gap]


class CameraReport(BaseModel):
    """The rectified camera, px; the translation to the right camera, m; the images as they lie on disk."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    baseline_m: float
    t_right_left_m: tuple[float, float, float]
    colour: bool
    rectified_on_load: bool
    stored_width: int
    stored_height: int


class GnssReport(BaseModel):
    """The fixes: their rate, the share of each type, horizontal sigma, lever arm, and how many frames lie in their time span."""

    fixes: RateReport
    share: dict[str, float]
    sigma_median_m: float
    sigma_worst_m: float
    first_lon_lat_height: tuple[float, float, float]
    p_cam_gnss_m: tuple[float, float, float]
    frames_covered: int


class DamagedImage(BaseModel):
    """An image that cannot be used, the one line that says why, its frame (-1: the log's file itself), and the reason's code."""

    file: str
    problem: str
    frame: int
    reason: str


class LogReport(BaseModel):
    """Result of `inspect_log`. `usable` is False where an image is damaged."""

    path: str
    name: str
    format: str
    rig_id: str | None
    vehicle_id: str | None
    start: str
    frames: RateReport
    camera: CameraReport
    gnss: GnssReport | None
    imu: RateReport | None
    p_cam_imu_m: tuple[float, float, float] | None = None
    truth_poses: int
    distance_m: float | None
    distance_from: str | None
    files: int
    bytes: int
    missing: list[str]
    damaged: list[DamagedImage]
    usable: bool


def inspect_log(
    log: DriveLog, *, decode: bool = True, progress: Progress = silent, threads: int = 1, seen: Seen | None = None
) -> LogReport:
    """Look at the whole log: every image is decoded, or, where `decode` is False, looked at from both ends.

    seen : as of `StoredLog.damaged`
    """
    damaged = damaged_images(log, decode, progress, threads, seen)
    distance_m, distance_from = distance(log)
    first_ns = int(log.t_ns[0])
    return LogReport(
        path=utf8_text(str(log.path)),
        name=log.name,
        format=log.format,
        rig_id=log.rig_id,
        vehicle_id=log.vehicle_id,
        start=wall_clock_from_ns(first_ns) if first_ns >= FIRST_WALL_CLOCK_NS else f"{first_ns / NS:.9f} s",
        frames=rate_report(log.t_ns),
        camera=camera_report(log),
        gnss=None if log.gnss is None else gnss_report(log.gnss, log.p_cam_gnss, log.t_ns),
        imu=None if log.imu is None else rate_report(log.imu.t_ns),
        p_cam_imu_m=None if log.imu is None or log.T_cam_imu is None else imu_place(log.T_cam_imu),
        truth_poses=0 if log.truth is None else int(np.isfinite(log.truth).all(axis=(1, 2)).sum()),
        distance_m=distance_m,
        distance_from=distance_from,
        files=len(log.files),
        bytes=sum((log.root / file).stat().st_size for file in log.files if (log.root / file).exists()),
        missing=list(log.missing),
        damaged=[
            DamagedImage(
                file=utf8_text(one.error.file or ""), problem=utf8_text(str(one.error)), frame=one.frame, reason=one.error.reason
            )
            for one in damaged
        ],
        usable=not damaged,
    )


def imu_place(T_cam_imu: FloatArray) -> tuple[float, float, float]:
    """(3,) m, the IMU's position in the left camera's frame."""
    x, y, z = (float(value) for value in T_cam_imu[:3, 3])
    return x, y, z


def damaged_images(log: DriveLog, decode: bool, progress: Progress, threads: int = 1, seen: Seen | None = None) -> Sequence[Damage]:
    """All images that cannot be used. seen : as of `StoredLog.damaged`."""
    if isinstance(log, StoredLog):
        return log.damaged(decode=decode, progress=progress, threads=threads, seen=seen)
    found = []
    for i in range(len(log)):
        try:
            log.frame(i)
        except LogError as problem:
            found.append(Damage(i, problem))
        progress((i + 1) / len(log), "looking at images")
    return found


def rate_report(t_ns: NDArray[np.int64]) -> RateReport:
    """t_ns (N,) int64, increasing, to its median rate, its length and its gaps; rate 0 for a single record."""
    steps = np.diff(t_ns)
    usual = float(np.median(steps)) if len(steps) else 0.0
    gaps = [Gap(after=int(i), seconds=float(steps[i] / NS)) for i in np.flatnonzero(steps > GAP_FACTOR * usual)]
    duration_s = float((t_ns[-1] - t_ns[0]) / NS) if len(t_ns) else 0.0
    return RateReport(count=len(t_ns), rate_hz=NS / usual if usual else 0.0, duration_s=duration_s, gaps=gaps)


def camera_report(log: DriveLog) -> CameraReport:
    """Report of the rig's calibration."""
    camera = log.rig.camera
    files = log if isinstance(log, StoredLog) else None
    stored = files.stored_sizes[0] if files else (camera.width, camera.height)
    return CameraReport(
        width=camera.width,
        height=camera.height,
        fx=camera.fx,
        fy=camera.fy,
        cx=camera.cx,
        cy=camera.cy,
        baseline_m=log.rig.baseline_m,
        t_right_left_m=log.rig.t_right_left,
        colour=log.colour,
        rectified_on_load=files is not None and files.rectifies,
        stored_width=stored[0],
        stored_height=stored[1],
    )


def gnss_report(gnss: GnssTrack, p_cam_gnss: FloatArray, t_ns: NDArray[np.int64]) -> GnssReport:
    """Report of the fixes; t_ns (N,) are the frames' time stamps."""
    sigma = horizontal_sigma_m(gnss)
    inside = (t_ns >= gnss.t_ns[0]) & (t_ns <= gnss.t_ns[-1])
    lon, lat, height = (float(value) for value in gnss.lon_lat_height[0])
    x, y, z = (float(value) for value in p_cam_gnss)
    return GnssReport(
        fixes=rate_report(gnss.t_ns),
        share={fix.name.lower(): float((gnss.fix_type == fix).mean()) for fix in FixType},
        sigma_median_m=float(np.median(sigma)),
        sigma_worst_m=float(sigma.max()),
        first_lon_lat_height=(lon, lat, height),
        p_cam_gnss_m=(x, y, z),
        frames_covered=int(inside.sum()),
    )


def horizontal_sigma_m(gnss: GnssTrack) -> FloatArray:
    """(M,) m: root of the mean of the variances east and north."""
    return np.sqrt(0.5 * (gnss.covariance_enu[:, 0, 0] + gnss.covariance_enu[:, 1, 1]))


def distance(log: DriveLog) -> tuple[float | None, str | None]:
    """Length of the path, m, and its source: truth, else GNSS, else (None, None).

    GNSS noise would add up while the car stands, so a fix counts once it is STEP_M and STEP_SIGMAS sigmas from the last that did.
    """
    if log.truth is not None and np.isfinite(log.truth).all():
        return float(np.linalg.norm(np.diff(log.truth[:, :3, 3], axis=0), axis=1).sum()), "truth"
    if log.gnss is None:
        return None, None
    enu = enu_from_lonlatheight(log.gnss.lon_lat_height, MapFrame(*log.gnss.lon_lat_height[0].tolist()))
    least = np.maximum(STEP_M, STEP_SIGMAS * horizontal_sigma_m(log.gnss))
    total, last = 0.0, enu[0]
    for place, step in zip(enu[1:], least[1:], strict=True):
        moved = float(np.linalg.norm(place - last))
        if moved >= step:
            total, last = total + moved, place
    return total + float(np.linalg.norm(enu[-1] - last)), "GNSS"
