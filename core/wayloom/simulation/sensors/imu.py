"""IMU model: specific force and angular rate of a moving body, with bias random walk and white noise.

Samples are instantaneous, at their time stamps: f = R^T (a + g up), w = (R^T dR/dt)^vee, from derivatives of the route's poses by
seven-point differences. The city's tangent plane is taken as inertial: the Earth does not turn, and gravity is GRAVITY_M_S2 down.
"""

from dataclasses import dataclass
from math import factorial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.logs.types import ImuTrack
from wayloom.simulation.sensors.clock import stamps_ns
from wayloom.simulation.vehicle.motion import Motion, camera_poses
from wayloom.simulation.vehicle.vehicle_settings import ImuSettings, VehicleSettings

F64 = NDArray[np.float64]
GRAVITY_M_S2: Final = 9.81
UPWARDS: Final = np.array([0.0, 0.0, GRAVITY_M_S2])
STEP_S: Final = 2e-3
"""Of the differences: short against all that moves a vehicle, long against rounding (1e-7 m/s^2 a kilometre from the origin)."""
NODES: Final = 7


@dataclass(frozen=True, slots=True)
class ImuRecord:
    """t_s (M,) true times; force, rate (M, 3) as measured; true_force, true_rate (M, 3) without bias and noise; biases (M, 3)."""

    t_s: F64
    force: F64
    rate: F64
    true_force: F64
    true_rate: F64
    force_bias: F64
    rate_bias: F64


def samples(motion: Motion, vehicle: VehicleSettings, start_ns: int, rng: np.random.Generator) -> ImuTrack | None:
    """The samples of a drive as the log holds them, on the receiver's clock; None where the vehicle has no IMU.

    start_ns  the cameras' time stamp of motion.start_s
    """
    if vehicle.imu is None:
        return None
    record = simulated_samples(motion, vehicle.T_body_cam @ vehicle.T_cam_imu, vehicle.imu, rng)
    return ImuTrack(stamps_ns(record.t_s, motion.start_s, start_ns, vehicle.clock), record.force, record.rate)


def simulated_samples(motion: Motion, T_body_imu: F64, settings: ImuSettings, rng: np.random.Generator) -> ImuRecord:
    """Samples from the drive's start to its end."""
    count = int(np.floor((motion.end_s - motion.start_s) * settings.rate_hz + 1e-6)) + 1
    t_s = np.minimum(motion.start_s + np.arange(count) / settings.rate_hz, motion.end_s)
    force, rate = true_samples(motion, T_body_imu, t_s)
    a_noise, a_bias = errors(
        count, settings.rate_hz, settings.accelerometer_noise, settings.accelerometer_bias, settings.accelerometer_walk, rng
    )
    g_noise, g_bias = errors(
        count, settings.rate_hz, settings.gyroscope_noise, settings.gyroscope_bias, settings.gyroscope_walk, rng
    )
    return ImuRecord(t_s, force + a_bias + a_noise, rate + g_bias + g_noise, force, rate, a_bias, g_bias)


def errors(count: int, rate_hz: float, noise: float, bias: float, walk: float, rng: np.random.Generator) -> tuple[F64, F64]:
    """White noise (count, 3) of density `noise` per root hertz, and a bias (count, 3) that starts at random and walks."""
    white = rng.normal(size=(count, 3)) * (noise * np.sqrt(rate_hz))
    steps = rng.normal(size=(count, 3)) * (walk / np.sqrt(rate_hz))
    steps[0] = rng.normal(size=3) * bias
    return white, np.cumsum(steps, axis=0)


def true_samples(motion: Motion, T_body_imu: F64, t_s: F64) -> tuple[F64, F64]:
    """Specific force (M, 3) m/s^2 and angular rate (M, 3) rad/s in the IMU's frame at t_s (M,)."""
    offsets, first, second = stencils(motion, t_s)
    times = (t_s[:, None] + offsets * STEP_S).ravel()
    T = camera_poses(motion, T_body_imu, times).reshape(len(t_s), NODES, 4, 4)
    middle = camera_poses(motion, T_body_imu, t_s)
    Rt = np.swapaxes(middle[:, :3, :3], 1, 2)
    acceleration = np.einsum("mk,mki->mi", second, T[..., :3, 3] - middle[:, None, :3, 3])
    W = Rt @ np.einsum("mk,mkij->mij", first, T[..., :3, :3])
    rate = 0.5 * np.stack([W[:, 2, 1] - W[:, 1, 2], W[:, 0, 2] - W[:, 2, 0], W[:, 1, 0] - W[:, 0, 1]], axis=1)
    force = np.einsum("mij,mj->mi", Rt, acceleration + UPWARDS)
    return force, rate


def stencils(motion: Motion, t_s: F64) -> tuple[F64, F64, F64]:
    """(M, 7) offsets in steps at which to look, within the drive, and weights of the first and second derivative there."""
    half = NODES // 2
    before = np.floor((t_s - motion.start_s) / STEP_S + 1e-6).astype(int)
    after = np.floor((motion.end_s - t_s) / STEP_S + 1e-6).astype(int)
    shift = np.maximum(half - before, 0) - np.maximum(half - after, 0)
    offsets = np.arange(-half, half + 1) + shift[:, None]
    table = {
        int(s): (_weights(np.arange(-half, half + 1) + s, 1), _weights(np.arange(-half, half + 1) + s, 2)) for s in np.unique(shift)
    }
    first, second = (np.array([table[int(s)][k] for s in shift]) for k in (0, 1))
    return offsets.astype(float), first / STEP_S, second / STEP_S**2


def _weights(offsets: NDArray[np.int64], derivative: int) -> F64:
    """(7,) weights of values at these offsets (in steps) whose sum is the derivative at 0: exact for polynomials of degree 6."""
    powers = np.vander(offsets.astype(float), NODES, increasing=True).T
    wanted = np.zeros(NODES)
    wanted[derivative] = factorial(derivative)
    return np.asarray(np.linalg.solve(powers, wanted))
