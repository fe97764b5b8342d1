"""Made drives with exact truth: gently rolling ground, odometry that drifts, GNSS with correlated noise and a lever arm."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayloom.geodesy import wgs84
from wayloom.geodesy.map_frame import MapFrame
from wayloom.geometry import se3
from wayloom.geometry.camera import PinholeCamera, StereoRig
from wayloom.georeference.rigid import R_ENU_LEVELCAM
from wayloom.logs.types import NOTHING_STATED, FixType, GnssTrack, ImuTrack, StatedReceiver
from wayloom.odometry.types import Keyframes, OdometryResult, Points, Trajectory

FloatArray = NDArray[np.float64]
PLACE = MapFrame(8.39, 48.98, 116.0)
LEVER = np.array([-0.34, 0.75, -1.1])
RIG = StereoRig(PinholeCamera(700.0, 700.0, 320.0, 120.0, 640, 240), (-0.5, 0.0, 0.0))


@dataclass
class MadeLog:
    """What the geo-reference reads of a log."""

    gnss: GnssTrack | None
    p_cam_gnss: FloatArray
    name: str = "made"
    imu: ImuTrack | None = None
    T_cam_imu: FloatArray | None = None
    receiver: StatedReceiver = NOTHING_STATED


@dataclass
class MadeDrive:
    log: MadeLog
    odometry: OdometryResult
    T_place_cam: FloatArray

    def truth_in(self, frame: MapFrame) -> FloatArray:
        return wgs84.T_enu_enu(frame, PLACE) @ self.T_place_cam


def path(
    frames: int, step_m: float = 1.0, turn_rad: float = 0.02, bend_from: int = 60, bend_to: int = 140, hills: float = 0.02
) -> FloatArray:
    """(N, 4, 4) T_place_cam: straight, a left bend, straight; hills of a few degrees."""
    T = np.empty((frames, 4, 4))
    T[0] = se3.from_rotation_translation(R_ENU_LEVELCAM, np.zeros(3))
    for i in range(1, frames):
        yaw = -turn_rad if bend_from < i < bend_to else 0.0
        pitch = hills * np.cos(i / 30.0) / 30.0
        T[i] = T[i - 1] @ se3.exp(np.array([0.0, 0.0, step_m, pitch, yaw, 0.0]))
    return T


def drifting(
    T: FloatArray,
    rng: np.random.Generator,
    position_m: float = 0.005,
    rotation_deg: float = 0.02,
    scale_sigma: float = 0.02,
    scale: float | None = None,
) -> FloatArray:
    """(N, 4, 4) T_world_cam: the same motion with the errors that the drive graph assumes; the first camera is the world.

    scale : metres of road per metre of odometry; None draws the process that the graph assumes, over 100 m
    """
    out = np.empty_like(T)
    out[0] = np.eye(4)
    s = rng.normal()
    for i in range(1, len(T)):
        step = se3.inverse(T[i - 1]) @ T[i]
        rho = np.exp(-np.linalg.norm(step[:3, 3]) / 100.0)
        s = rho * s + np.sqrt(1.0 - rho**2) * rng.normal()
        step[:3, 3] /= 1.0 + scale_sigma * s if scale is None else scale
        root = np.sqrt(np.linalg.norm(step[:3, 3]))
        noise = np.concatenate([rng.normal(size=3) * position_m * root, rng.normal(size=3) * np.radians(rotation_deg) * root])
        out[i] = out[i - 1] @ step @ se3.exp(noise)
    return out


def correlated(t_s: FloatArray, sigma_m: float, correlation_s: float, white_share: float, rng: np.random.Generator) -> FloatArray:
    """(M, 3) m: white noise plus an Ornstein-Uhlenbeck process, together of the given sigma."""
    bias = np.empty((len(t_s), 3))
    bias[0] = rng.normal(size=3)
    for k in range(1, len(t_s)):
        rho = np.exp(-(t_s[k] - t_s[k - 1]) / correlation_s)
        bias[k] = rho * bias[k - 1] + np.sqrt(1.0 - rho**2) * rng.normal(size=3)
    return np.asarray(sigma_m * (np.sqrt(1.0 - white_share**2) * bias + white_share * rng.normal(size=(len(t_s), 3))))


def made_drive(
    seed: int = 0,
    frames: int = 200,
    sigma_m: float = 0.5,
    step_m: float = 1.0,
    fix_every: int = 1,
    turn_rad: float = 0.02,
    drift: bool = True,
    hills: float = 0.02,
    scale: float | None = None,
    correlation_s: float = 30.0,
    white_share: float = 0.3,
) -> MadeDrive:
    rng = np.random.default_rng(seed)
    T = path(frames, step_m, turn_rad, hills=hills)
    t_ns = 1_000_000_000 + np.arange(frames, dtype=np.int64) * 100_000_000
    T_world_cam = drifting(T, rng, scale=scale) if drift else se3.inverse(T[0]) @ T
    rows = np.arange(0, frames, fix_every)
    antenna = T[rows, :3, :3] @ LEVER + T[rows, :3, 3]
    fixes = antenna + correlated(t_ns[rows] * 1e-9, sigma_m, correlation_s, white_share, rng)
    return MadeDrive(MadeLog(track_of(t_ns[rows], fixes, sigma_m), LEVER), odometry_of(t_ns, T_world_cam), T)


def track_of(t_ns: NDArray[np.int64], fixes: FloatArray, sigma_m: float) -> GnssTrack:
    covariance = np.tile(np.eye(3) * sigma_m**2, (len(fixes), 1, 1))
    lon_lat_height = wgs84.lonlatheight_from_enu(fixes, PLACE)
    return GnssTrack(t_ns, lon_lat_height, covariance, np.full(len(fixes), FixType.SINGLE, np.uint8))


def odometry_of(t_ns: NDArray[np.int64], T_world_cam: FloatArray, segment: NDArray[np.int32] | None = None) -> OdometryResult:
    n = len(t_ns)
    segment = np.zeros(n, np.int32) if segment is None else segment
    keyframe = np.arange(0, n, 3, dtype=np.int32)
    keyframes = Keyframes(keyframe, T_world_cam[keyframe], np.zeros((len(keyframe), 4)), segment[keyframe])
    return OdometryResult(RIG, Trajectory(t_ns, T_world_cam, np.ones(n, bool), segment), keyframes, no_points(), 0.0, np.zeros(3))


def no_points() -> Points:
    f, i = np.zeros(0, np.float32), np.zeros(0, np.int32)
    b = np.zeros(0, bool)
    return Points(i, np.zeros((0, 2), np.float32), f, f, np.zeros(0, np.uint8), np.zeros(1, np.int64), i, b, b)
