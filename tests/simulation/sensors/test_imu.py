"""IMU: samples that integrate to the poses they come from, and errors as specified."""

import numpy as np
import pytest
from scipy import stats

from simulation.winding import Standing, Winding
from wayloom.geometry import se3
from wayloom.simulation.rendering.renderer import World
from wayloom.simulation.sensors.imu import GRAVITY_M_S2, errors, samples, simulated_samples, true_samples
from wayloom.simulation.traffic.drives import RoutePlan, plan_drives
from wayloom.simulation.vehicle.motion import Motion, camera_poses
from wayloom.simulation.vehicle.vehicle_settings import ClockSettings, ImuSettings, VehicleSettings

VEHICLE = VehicleSettings(imu=ImuSettings(rate_hz=200.0), imu_roll_pitch_yaw_rad=(0.03, -0.02, 0.05))
T_BODY_IMU = VEHICLE.T_body_cam @ VEHICLE.T_cam_imu
SILENT = ImuSettings(
    rate_hz=200.0, accelerometer_noise=0, gyroscope_noise=0, accelerometer_bias=0, gyroscope_bias=0, accelerometer_walk=0,
    gyroscope_walk=0,
)  # fmt: skip


def integrated(motion: Motion, settings: ImuSettings) -> tuple[np.ndarray, np.ndarray]:
    """T_enu_imu at the end from the first pose and velocity and the samples alone (means of neighbours), and its true value."""
    record = simulated_samples(motion, T_BODY_IMU, settings, np.random.default_rng(0))
    t, h = record.t_s, 1e-4
    T = camera_poses(motion, T_BODY_IMU, t[:1])[0]
    few = camera_poses(motion, T_BODY_IMU, t[0] + h * np.arange(4))[:, :3, 3]
    R, p, v = T[:3, :3], T[:3, 3], (-11 * few[0] + 18 * few[1] - 9 * few[2] + 2 * few[3]) / (6 * h)
    for k in range(len(t) - 1):
        dt = t[k + 1] - t[k]
        turn = se3.exp(np.r_[np.zeros(3), 0.5 * (record.rate[k] + record.rate[k + 1]) * dt])[:3, :3]
        a = 0.5 * (R @ record.force[k] + R @ turn @ record.force[k + 1]) - (0, 0, GRAVITY_M_S2)
        p, v, R = p + v * dt + 0.5 * a * dt * dt, v + a * dt, R @ turn
    return se3.from_rotation_translation(R, p), camera_poses(motion, T_BODY_IMU, t[-1:])[0]


def test_samples_of_a_winding_way_integrate_to_its_poses() -> None:
    found, true = integrated(Winding(), SILENT)
    assert np.linalg.norm(found[:3, 3] - true[:3, 3]) < 0.002  # 10 s, about 100 m
    assert np.linalg.norm(se3.log(se3.inverse(true) @ found)[3:]) < 2e-5


def test_integrating_finer_samples_comes_nearer_as_the_square_of_their_distance() -> None:
    rough, true = integrated(Winding(), SILENT.model_copy(update={"rate_hz": 100.0}))
    fine, _ = integrated(Winding(), SILENT.model_copy(update={"rate_hz": 400.0}))
    ratio = np.linalg.norm(rough[:3, 3] - true[:3, 3]) / np.linalg.norm(fine[:3, 3] - true[:3, 3])
    assert 12 < ratio < 20


def test_samples_of_a_drive_through_the_city_integrate_to_its_poses(world: World) -> None:
    way = RoutePlan(nodes=(4, 5, 6, 10), reference=2, before_m=25.0, start_s=7.0, duration_s=6.0)
    found, true = integrated(plan_drives(world.city, [way])[0].route, SILENT)
    assert np.linalg.norm(found[:3, 3] - true[:3, 3]) < 0.005
    assert np.linalg.norm(se3.log(se3.inverse(true) @ found)[3:]) < 1e-4


def test_a_standing_imu_feels_gravity_alone() -> None:
    force, rate = true_samples(Standing(), T_BODY_IMU, np.array([20.0, 25.0, 30.0]))
    up = camera_poses(Standing(), T_BODY_IMU, np.array([25.0]))[0, 2, :3]
    np.testing.assert_allclose(force, np.tile(up * GRAVITY_M_S2, (3, 1)), atol=1e-6)
    np.testing.assert_allclose(rate, 0, atol=1e-9)


def test_the_ends_of_a_drive_are_felt_as_its_middle() -> None:
    whole = true_samples(Winding(10.0, 40.0), T_BODY_IMU, np.array([20.0, 20.002, 29.998, 30.0]))
    ends = true_samples(Winding(20.0, 30.0), T_BODY_IMU, np.array([20.0, 20.002, 29.998, 30.0]))
    np.testing.assert_allclose(ends[0], whole[0], atol=1e-5)
    np.testing.assert_allclose(ends[1], whole[1], atol=1e-8)


@pytest.mark.parametrize("rate_hz", [100.0, 200.0])
def test_noise_has_its_density_and_the_bias_walks_as_specified(rate_hz: float) -> None:
    count, noise, walk = 4000, 2e-3, 5e-4
    white, bias = errors(count, rate_hz, noise, 0.0, walk, np.random.default_rng(1))
    low, high = stats.chi2.ppf((0.001, 0.999), 3 * count)
    assert low < np.sum(white**2) / (noise**2 * rate_hz) < high
    low, high = stats.chi2.ppf((0.001, 0.999), 3 * (count - 1))
    assert low < np.sum(np.diff(bias, axis=0) ** 2) / (walk**2 / rate_hz) < high


def test_the_first_bias_is_drawn_with_its_deviation() -> None:
    first = np.array([errors(1, 100.0, 0.0, 0.05, 0.0, np.random.default_rng([2, k]))[1][0] for k in range(500)])
    low, high = stats.chi2.ppf((0.001, 0.999), first.size)
    assert low < np.sum(first**2) / 0.05**2 < high


def test_a_track_has_the_receivers_clock() -> None:
    vehicle = VEHICLE.model_copy(update={"clock": ClockSettings(offset_s=0.25, drift=1e-4)})
    track = samples(Winding(), vehicle, 5_000_000_000, np.random.default_rng(0))
    assert track is not None
    assert len(track.t_ns) == 2001
    assert track.t_ns[0] == 5_250_000_000
    assert track.t_ns[-1] == 5_250_000_000 + 10_001_000_000
    assert samples(Winding(), VehicleSettings(), 0, np.random.default_rng(0)) is None
