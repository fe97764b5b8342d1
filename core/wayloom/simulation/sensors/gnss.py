"""GNSS receiver model: white and time-correlated position errors, outages, multipath bursts."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.geodesy.map_frame import MapFrame
from wayloom.geodesy.wgs84 import lonlatheight_from_enu
from wayloom.logs.sidecars.oxts import UP_FACTOR
from wayloom.logs.sidecars.oxts_writer import OxtsPacket
from wayloom.logs.types import FixType, GnssTrack
from wayloom.simulation.sensors.clock import stamps_ns
from wayloom.simulation.sensors.imu import true_samples
from wayloom.simulation.vehicle.motion import Motion, camera_poses, twists
from wayloom.simulation.vehicle.vehicle_settings import GnssBurst, GnssStep, VehicleSettings

F64 = NDArray[np.float64]
SIGMA_M: Final = {FixType.NONE: 50.0, FixType.SINGLE: 1.6, FixType.FLOAT: 0.30, FixType.FIXED: 0.02}
"""Standard deviation of east and of north for each kind of fix; of up it is UP_FACTOR times that."""
SATELLITES: Final = {FixType.NONE: 0, FixType.SINGLE: 7, FixType.FLOAT: 9, FixType.FIXED: 14}
SLOW_SHARE = 0.5
"""Share of the variance that changes slowly (atmosphere, constellation); the rest is new with each fix."""
SLOW_S = 8.0
"""Time after which the slow part has changed by 1 - 1/e."""


WANDER_S = 2.0
"""Over what time a reflected signal's error wanders while it lasts."""
VELOCITY_SIGMA_M_S = 0.05


@dataclass(frozen=True, slots=True)
class GnssRecord:
    """Simulated fixes at times t_s (M,), with their true errors.

    antenna_enu    (M, 3) m true place
    measured_enu   (M, 3) m
    fix            (M,) uint8 FixType
    sigma_m        (M,) true standard deviation of east and of north; of up UP_FACTOR times that; multipath is not in it
    stated_m       (M,) what the receiver says of it
    multipath      (M,) bool: within a burst
    """

    t_s: F64
    antenna_enu: F64
    measured_enu: F64
    fix: NDArray[np.uint8]
    sigma_m: F64
    stated_m: F64
    multipath: NDArray[np.bool_]


def simulated_fixes(motion: Motion, vehicle: VehicleSettings, rng: np.random.Generator) -> GnssRecord | None:
    """The fixes of a drive; None without a receiver. In an outage the last position is held and the fix type is NONE."""
    settings = vehicle.gnss
    if settings is None:
        return None
    duration_s = motion.end_s - motion.start_s
    since = np.arange(int(np.floor(duration_s * settings.rate_hz + 1e-6)) + 1) / settings.rate_hz
    t_s = np.minimum(motion.start_s + since, motion.end_s)
    antenna = placed(camera_poses(motion, vehicle.T_body_cam, t_s), np.array(vehicle.p_cam_gnss_m))
    steps = steps_in_force(settings.steps, since / max(duration_s, 1e-9))
    fix = np.array([int(step.fix) for step in steps], np.uint8)
    measured = antenna + fix_errors(fix, 1 / settings.rate_hz, rng)
    multipath = np.zeros(len(t_s), bool)
    for burst in settings.bursts:
        inside = (since >= burst.share * duration_s) & (since < burst.share * duration_s + burst.duration_s)
        measured[inside] += burst_errors(burst, int(inside.sum()), 1 / settings.rate_hz, rng)
        multipath |= inside
    for k in range(1, len(fix)):
        if fix[k] == FixType.NONE:
            measured[k] = measured[k - 1]
    sigma = np.array([SIGMA_M[FixType(f)] for f in fix])
    stated = sigma * np.array([step.stated_ratio for step in steps])
    return GnssRecord(t_s, antenna, measured, fix, sigma, stated, multipath)


def steps_in_force(steps: tuple[GnssStep, ...], shares: F64) -> list[GnssStep]:
    """The step in force at each share (M,) of the drive; steps are in order, the first counts from 0 on."""
    which = np.searchsorted([step.share for step in steps], shares, side="right") - 1
    return [steps[max(int(k), 0)] for k in which]


def fix_errors(fixes: NDArray[np.uint8], period_s: float, rng: np.random.Generator) -> F64:
    """(M, 3) errors east, north, up, m: normal with the stated sigma, half of the variance slowly changing."""
    kept = np.exp(-period_s / SLOW_S)
    slow, unit = rng.normal(size=3), np.empty((len(fixes), 3))
    for k in range(len(fixes)):
        unit[k] = np.sqrt(SLOW_SHARE) * slow + np.sqrt(1 - SLOW_SHARE) * rng.normal(size=3)
        slow = kept * slow + np.sqrt(1 - kept**2) * rng.normal(size=3)
    sigma = np.array([SIGMA_M[FixType(f)] for f in fixes])
    return np.asarray(unit * sigma[:, None] * (1.0, 1.0, UP_FACTOR))


def burst_errors(burst: GnssBurst, count: int, period_s: float, rng: np.random.Generator) -> F64:
    """(count, 3) errors east, north, up, m, of reflected signals: a jump (or ramp) of the burst's size that wanders a little."""
    angle, kept = rng.uniform(0, 2 * np.pi), np.exp(-period_s / WANDER_S)
    jump = burst.size_m * np.array([np.cos(angle), np.sin(angle), 0.5 * rng.choice((-1.0, 1.0))])
    wander, out = np.zeros(3), np.empty((count, 3))
    for k in range(count):
        wander = kept * wander + np.sqrt(1 - kept**2) * burst.wander_share * burst.size_m * rng.normal(size=3)
        out[k] = jump + wander
    if burst.ramp_s > 0.0:
        from_end = np.minimum(np.arange(count), np.arange(count)[::-1]) * period_s
        out *= np.minimum(from_end / burst.ramp_s, 1.0)[:, None]
    return out


def track(record: GnssRecord, motion: Motion, vehicle: VehicleSettings, frame: MapFrame, start_ns: int) -> GnssTrack:
    """The fixes as a log holds them, on the receiver's clock. start_ns: the cameras' time stamp of motion.start_s."""
    covariance = (record.stated_m**2)[:, None, None] * np.diag((1.0, 1.0, UP_FACTOR**2))
    t_ns = stamps_ns(record.t_s, motion.start_s, start_ns, vehicle.clock)
    return GnssTrack(t_ns, lonlatheight_from_enu(record.measured_enu, frame), covariance, record.fix)


def packets(
    record: GnssRecord, motion: Motion, vehicle: VehicleSettings, frame: MapFrame, start_ns: int, rng: np.random.Generator
) -> list[OxtsPacket]:
    """The fixes as packets of a GNSS/INS unit; attitude, force and rate are true, the velocity has errors of VELOCITY_SIGMA_M_S."""
    places = lonlatheight_from_enu(record.measured_enu, frame)
    t_ns = stamps_ns(record.t_s, motion.start_s, start_ns, vehicle.clock)
    T_body_imu = vehicle.T_body_cam @ vehicle.T_cam_imu
    T_enu_imu = camera_poses(motion, T_body_imu, record.t_s)
    forward = twists(motion, T_body_imu, record.t_s)[:, :3]
    velocity = np.einsum("mij,mj->mi", T_enu_imu[:, :3, :3], forward) + rng.normal(0, VELOCITY_SIGMA_M_S, forward.shape)
    force, rate = true_samples(motion, T_body_imu, record.t_s)
    return [
        OxtsPacket(
            t_ns=int(t_ns[k]),
            lon_lat_height=tuple(places[k].tolist()),
            sigma_m=float(record.stated_m[k]),
            fix=FixType(record.fix[k]),
            roll_pitch_yaw=roll_pitch_yaw(T_enu_imu[k, :3, :3]),
            velocity_enu=tuple(velocity[k].tolist()),
            specific_force=tuple(force[k].tolist()),
            angular_rate=tuple(rate[k].tolist()),
            satellites=SATELLITES[FixType(record.fix[k])],
        )
        for k in range(len(t_ns))
    ]


def placed(T: F64, point: F64) -> F64:
    """(M, 3): one point (3,) moved by each of T (M, 4, 4)."""
    return np.asarray(T[:, :3, :3] @ point + T[:, :3, 3])


def roll_pitch_yaw(R_enu_imu: F64) -> tuple[float, float, float]:
    """KITTI's angles, rad, of a unit whose x points forward, y left, z up: (3, 3)."""
    R = R_enu_imu
    return float(np.arctan2(R[2, 1], R[2, 2])), float(np.arcsin(np.clip(-R[2, 0], -1, 1))), float(np.arctan2(R[1, 0], R[0, 0]))
