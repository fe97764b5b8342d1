"""Made drives with exact truth for the geo-reference: ways through a city, odometry and GNSS with modelled noise.

The odometry errs as docs/decisions/0008 measured it: white noise that grows with the root of the road, and a scale that wanders
(Ornstein-Uhlenbeck over SCALE_LENGTH_M). GNSS errs as the simulator's receiver does (`wayloom.simulation.sensors.gnss`): no
parameter of the geo-reference is used to make a drive.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wayloom.geodesy import wgs84
from wayloom.geodesy.map_frame import MapFrame
from wayloom.geometry import se3
from wayloom.geometry.camera import PinholeCamera, StereoRig
from wayloom.georeference.rigid import R_ENU_LEVELCAM
from wayloom.logs.sidecars.oxts import UP_FACTOR
from wayloom.logs.types import NOTHING_STATED, FixType, GnssTrack, ImuTrack, StatedReceiver
from wayloom.odometry.types import Keyframes, OdometryResult, Points, Trajectory
from wayloom.simulation.sensors.gnss import SIGMA_M, burst_errors, fix_errors
from wayloom.simulation.vehicle.vehicle_settings import GnssBurst

FloatArray = NDArray[np.float64]
PLACE = MapFrame(8.39, 48.98, 116.0)
LEVER_M = np.array([-0.34, -0.75, -1.1])
RATE_HZ = 10.0
START_NS = 1_000_000_000
WAY_STEP_M = 0.1
BLOCK_M, CORNER_RADIUS_M, CORNER_M_S, ACCELERATION_M_S2 = 150.0, 12.0, 5.0, 1.5
POSITION_NOISE_M, ROTATION_NOISE_RAD, SCALE_LENGTH_M = 0.005, float(np.radians(0.02)), 100.0
RIG = StereoRig(PinholeCamera(700.0, 700.0, 320.0, 120.0, 640, 240), (-0.5, 0.0, 0.0))


@dataclass(frozen=True, slots=True)
class MadeLog:
    """What the geo-reference reads of a log: fixes, and the lever arm (3,) m in the camera's frame, zeros where it is not given."""

    gnss: GnssTrack | None
    p_cam_gnss: FloatArray
    name: str = "made"
    imu: ImuTrack | None = None
    T_cam_imu: FloatArray | None = None
    receiver: StatedReceiver = NOTHING_STATED


@dataclass(frozen=True, slots=True)
class MadeDrive:
    """A log, its odometry, and the truth T_place_cam (N, 4, 4) in the tangent plane of PLACE."""

    log: MadeLog
    odometry: OdometryResult
    T_place_cam: FloatArray

    def truth_in(self, frame: MapFrame) -> FloatArray:
        """(N, 4, 4) in a map's frame."""
        return np.asarray(wgs84.T_enu_enu(frame, PLACE) @ self.T_place_cam)


@dataclass(frozen=True, slots=True)
class Receiver:
    """A receiver and its surroundings.

    fix           kind of every fix; stated_ratio: stated over true sigma
    late_s        by how much its stamps are late; drift s/s more all along
    lever_given   whether the log tells the lever arm; lever_error_m (3,) by how much it is wrong
    bursts        multipath; outages (start s, length s)
    shift_from    share of the drive from which every fix is shifted by shift_enu_m
    """

    fix: FixType = FixType.FIXED
    stated_ratio: float = 1.0
    late_s: float = 0.0
    drift: float = 0.0
    lever_given: bool = True
    lever_error_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    bursts: tuple[GnssBurst, ...] = ()
    outages: tuple[tuple[float, float], ...] = ()
    shift_from: float = 1.0
    shift_enu_m: tuple[float, float, float] = (0.0, 0.0, 0.0)


def city_way(seconds: float, speed_m_s: float = 13.0) -> FloatArray:
    """(N, 4, 4) T_place_cam at RATE_HZ: blocks of BLOCK_M with corners to the left and right by turns, slower there, over hills."""
    pattern = np.array([1, 1, -1, -1]) / CORNER_RADIUS_M
    corner_m = 0.5 * np.pi * CORNER_RADIUS_M
    along = np.arange(0.0, seconds * speed_m_s + 2.0 * BLOCK_M, WAY_STEP_M)
    number, within = np.divmod(along + 0.5 * BLOCK_M, BLOCK_M + corner_m)
    curvature = np.where(within > BLOCK_M, pattern[number.astype(np.int64) % len(pattern)], 0.0)
    to_corner = np.minimum(np.maximum(BLOCK_M - within, 0.0), within)
    speed = np.minimum(speed_m_s, np.sqrt(CORNER_M_S**2 + 2.0 * ACCELERATION_M_S2 * to_corner))
    return _driven(along, curvature, speed, seconds)


def straight_way(seconds: float, speed_m_s: float = 10.0, bend: bool = False) -> FloatArray:
    """(N, 4, 4) T_place_cam at RATE_HZ: straight at one speed; bend: a wide one of 90 degrees in the middle third."""
    along = np.arange(0.0, seconds * speed_m_s + 1.0, WAY_STEP_M)
    third = seconds * speed_m_s / 3.0
    curvature = np.where((along > third) & (along < 2.0 * third), 0.5 * np.pi / third, 0.0) if bend else np.zeros(len(along))
    return _driven(along, curvature, np.full(len(along), speed_m_s), seconds)


def _driven(along_m: FloatArray, curvature: FloatArray, speed: FloatArray, seconds: float) -> FloatArray:
    """The way by its curvature (K,) 1/m and speed (K,) m/s at along_m (K,) as level cameras at RATE_HZ, over gentle hills."""
    t_s = np.concatenate([[0.0], np.cumsum(WAY_STEP_M / speed[:-1])])
    heading = np.concatenate([[0.0], np.cumsum(curvature[:-1] * WAY_STEP_M)])
    slope = 0.02 * np.cos(along_m / 60.0)
    east, north = np.cumsum(-np.sin(heading)) * WAY_STEP_M, np.cumsum(np.cos(heading)) * WAY_STEP_M
    frames = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    place = np.column_stack([np.interp(frames, t_s, column) for column in (east, north, np.cumsum(slope) * WAY_STEP_M)])
    yaw, pitch = np.interp(frames, t_s, heading), np.interp(frames, t_s, slope)
    T = np.empty((len(frames), 4, 4))
    for i in range(len(frames)):
        R_up, R_right = se3.exp(np.array([0, 0, 0, 0, 0, yaw[i]]))[:3, :3], se3.exp(np.array([0, 0, 0, pitch[i], 0, 0]))[:3, :3]
        T[i] = se3.from_rotation_translation(R_up @ R_right @ R_ENU_LEVELCAM, place[i])
    return T


def tracked(T: FloatArray, rng: np.random.Generator, scale_sigma: float) -> FloatArray:
    """(N, 4, 4) T_world_cam: the motion T (N, 4, 4) as an odometry sees it; the first camera is the world."""
    out = np.empty_like(T)
    out[0], s = np.eye(4), rng.normal()
    for i, step in enumerate(se3.inverse(T[:-1]) @ T[1:]):
        length = float(np.linalg.norm(step[:3, 3]))
        rho = np.exp(-length / SCALE_LENGTH_M)
        s = rho * s + np.sqrt(1.0 - rho**2) * rng.normal()
        step[:3, 3] /= 1.0 + scale_sigma * s
        noise = np.concatenate([rng.normal(size=3) * POSITION_NOISE_M, rng.normal(size=3) * ROTATION_NOISE_RAD])
        out[i + 1] = out[i] @ step @ se3.exp(noise * np.sqrt(length))
    return out


def _stretched(T_world_cam: FloatArray, scale_end: float) -> FloatArray:
    """(N, 4, 4) the same steps, longer and longer, in the end by the share scale_end."""
    longer = 1.0 + scale_end * np.linspace(0.0, 1.0, len(T_world_cam) - 1)
    out = T_world_cam.copy()
    out[1:, :3, 3] = out[0, :3, 3] + np.cumsum(np.diff(T_world_cam[:, :3, 3], axis=0) * longer[:, None], axis=0)
    return out


def received(T: FloatArray, receiver: Receiver, rng: np.random.Generator) -> GnssTrack:
    """The receiver's fixes, one a frame of T (N, 4, 4)."""
    t_s = np.arange(len(T)) / RATE_HZ
    kinds = np.full(len(T), receiver.fix, np.uint8)
    enu = T[:, :3, :3] @ LEVER_M + T[:, :3, 3] + fix_errors(kinds, 1.0 / RATE_HZ, rng)
    for burst in receiver.bursts:
        inside = (t_s >= burst.share * t_s[-1]) & (t_s < burst.share * t_s[-1] + burst.duration_s)
        enu[inside] += burst_errors(burst, int(inside.sum()), 1.0 / RATE_HZ, rng)
    enu[t_s >= receiver.shift_from * t_s[-1]] += receiver.shift_enu_m
    for start, length in receiver.outages:
        kinds[(t_s >= start) & (t_s < start + length)] = FixType.NONE
    stated = SIGMA_M[receiver.fix] * receiver.stated_ratio * np.array([1.0, 1.0, UP_FACTOR])
    t_ns = START_NS + np.rint((t_s + receiver.late_s + receiver.drift * t_s) * 1e9).astype(np.int64)
    return GnssTrack(t_ns, wgs84.lonlatheight_from_enu(enu, PLACE), np.tile(np.diag(stated**2), (len(T), 1, 1)), kinds)


def made_drive(T: FloatArray, receiver: Receiver, seed: int, scale_sigma: float = 0.01, scale_end: float = 0.0) -> MadeDrive:
    """A drive along T (N, 4, 4); equal seeds give equal drives. scale_end: share by which the odometry's steps grow all along."""
    rng = np.random.default_rng(seed)
    T_world_cam = tracked(T, rng, scale_sigma)
    if scale_end:
        T_world_cam = _stretched(T_world_cam, scale_end)
    lever = LEVER_M + receiver.lever_error_m if receiver.lever_given else np.zeros(3)
    return MadeDrive(MadeLog(received(T, receiver, rng), lever), odometry_of(T_world_cam), T)


def odometry_of(T_world_cam: FloatArray, t_s: FloatArray | None = None) -> OdometryResult:
    """Poses (N, 4, 4) at t_s (N,), or from START_NS on at RATE_HZ, as an odometry's result without points."""
    n = len(T_world_cam)
    t_ns = (
        START_NS + np.rint(np.arange(n) * (1e9 / RATE_HZ)).astype(np.int64) if t_s is None else np.rint(t_s * 1e9).astype(np.int64)
    )
    frame, segment = np.arange(0, n, 3, dtype=np.int32), np.zeros(n, np.int32)
    keyframes = Keyframes(frame, T_world_cam[frame], np.zeros((len(frame), 4)), segment[frame])
    f, i, b = np.zeros(0, np.float32), np.zeros(0, np.int32), np.zeros(0, bool)
    points = Points(i, np.zeros((0, 2), np.float32), f, f, np.zeros(0, np.uint8), np.zeros(1, np.int64), i, b, b)
    return OdometryResult(RIG, Trajectory(t_ns, T_world_cam, np.ones(n, bool), segment), keyframes, points, 0.0, np.zeros(3))


def with_bursts(receiver: Receiver, seconds: float, size_m: float, length_s: float, wander_share: float) -> Receiver:
    """The receiver with bursts of one kind over a fifth of a drive of so many seconds, evenly spread."""
    count = max(1, round(0.2 * seconds / length_s))
    share = (np.arange(count) + 0.5) / count - 0.5 * length_s / seconds
    bursts = tuple(GnssBurst(share=float(s), duration_s=length_s, size_m=size_m, wander_share=wander_share) for s in share)
    return replace(receiver, bursts=bursts)


def told_which_are_wrong(receiver: Receiver, seconds: float) -> Receiver:
    """The same receiver with the fixes of its bursts and of its shift taken out, by one who knows them: all other noise stays."""
    last_s = seconds - 1.0 / RATE_HZ
    wrong = [(burst.share * last_s, burst.duration_s) for burst in receiver.bursts]
    if any(receiver.shift_enu_m):
        wrong.append((receiver.shift_from * last_s, seconds))
    return replace(receiver, outages=(*receiver.outages, *wrong))
