import numpy as np

from georeference.made_gnss_drives import drifting, odometry_of
from wayloom.geometry import se3
from wayloom.georeference.gravity.accelerometer import GRAVITY_M_S2, up_by_accelerometer
from wayloom.logs.types import ImuTrack

R_BODY_CAM = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
SPEED_M_S, SWING_RAD, PERIOD_S = 8.0, 0.8, 7.0
FRAME_NS, SAMPLE_NS, LENGTH_NS = 100_000_000, 2_000_000, 40_000_000_000


def winding_drive() -> tuple[np.ndarray, np.ndarray, ImuTrack]:
    """Frames (N,) ns, T_place_cam (N, 4, 4) and a faultless IMU at the camera: level ground, one speed, a heading that swings."""
    t_ns = np.arange(0, LENGTH_NS + 1, SAMPLE_NS, dtype=np.int64)
    t_s = 1e-9 * t_ns
    heading = SWING_RAD * np.sin(2.0 * np.pi * t_s / PERIOD_S)
    rate = 2.0 * np.pi / PERIOD_S * SWING_RAD * np.cos(2.0 * np.pi * t_s / PERIOD_S)
    v = SPEED_M_S * np.stack([np.cos(heading), np.sin(heading), np.zeros(len(t_s))], axis=1)
    place = np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * (v[1:] + v[:-1]), axis=0) * 1e-9 * SAMPLE_NS])
    body = se3.exp(np.stack([np.zeros(len(t_s))] * 5 + [heading], axis=1))[:, :3, :3]
    T = se3.from_rotation_translation(body @ R_BODY_CAM, place)
    force_body = np.stack([np.zeros(len(t_s)), SPEED_M_S * rate, np.full(len(t_s), GRAVITY_M_S2)], axis=1)
    imu = ImuTrack(t_ns, force_body @ R_BODY_CAM, np.zeros((len(t_s), 3)))
    every = FRAME_NS // SAMPLE_NS
    return t_ns[::every], T[::every], imu


def test_windows_that_begin_and_end_in_bends_tell_up_too():
    """By a plain mean of the force they were wrong by up to 0.34 degrees here; what is left is the polygon of the frames."""
    t_ns, T, imu = winding_drive()
    windows = up_by_accelerometer(imu, np.eye(4), odometry_of(t_ns, T).trajectory, 0.0, 100.0, 0.0)
    assert len(windows.frame) == 9
    apart = np.linalg.norm(windows.up_cam - T[windows.frame, 2, :3], axis=1)
    assert np.degrees(apart.max()) < 0.01


def test_an_error_of_scale_is_what_the_covariance_says_along_the_acceleration_and_nothing_across():
    t_ns, T, imu = winding_drive()
    true = up_by_accelerometer(imu, np.eye(4), odometry_of(t_ns, T).trajectory, 0.02, 1e9, 0.001)
    shrunk = T.copy()
    shrunk[:, :3, 3] /= 1.02
    wrong = up_by_accelerometer(imu, np.eye(4), odometry_of(t_ns, shrunk).trajectory, 0.02, 1e9, 0.001)
    error = wrong.up_cam - true.up_cam
    sigmas2 = np.einsum("ni,ni->n", error, np.linalg.solve(wrong.covariance, error[:, :, None])[:, :, 0])
    assert 0.5 < sigmas2.max() < 1.2  # one sigma of scale, where the window's acceleration is large against the white part
    across, _, along = np.linalg.eigvalsh(wrong.covariance).T
    assert np.allclose(across, across[0])
    assert np.degrees(np.sqrt(along.max())) > 0.3


def test_a_scale_that_wanders_tilts_up_along_the_view_as_much_as_the_covariance_says():
    t_ns, T, imu = winding_drive()
    true = up_by_accelerometer(imu, np.eye(4), odometry_of(t_ns, T).trajectory, 0.02, 100.0, 0.0)
    error2, stated2 = [], []
    for seed in range(12):
        wandering = drifting(T, np.random.default_rng(seed), position_m=0.0, rotation_deg=0.0, scale_sigma=0.02)
        seen = up_by_accelerometer(imu, np.eye(4), odometry_of(t_ns, wandering).trajectory, 0.02, 100.0, 0.0)
        error2.append((seen.up_cam - true.up_cam)[:, 2] ** 2)
        stated2.append(seen.covariance[:, 2, 2])
    assert 0.7 < np.mean(error2) / np.mean(stated2) < 1.4
    assert np.degrees(np.sqrt(np.mean(stated2))) > 0.1


def test_a_window_with_a_hole_in_its_samples_says_nothing():
    t_ns, T, imu = winding_drive()
    trajectory = odometry_of(t_ns, T).trajectory
    whole = up_by_accelerometer(imu, np.eye(4), trajectory, 0.02, 100.0, 0.0)
    hole = (imu.t_ns > 6_000_000_000) & (imu.t_ns < 6_200_000_000)
    holed = ImuTrack(imu.t_ns[~hole], imu.specific_force[~hole], imu.angular_rate[~hole])
    left = up_by_accelerometer(holed, np.eye(4), trajectory, 0.02, 100.0, 0.0)
    assert np.array_equal(left.frame, np.delete(whole.frame, 1))
    none = ImuTrack(imu.t_ns[:0], imu.specific_force[:0], imu.angular_rate[:0])
    assert len(up_by_accelerometer(none, np.eye(4), trajectory, 0.02, 100.0, 0.0).frame) == 0
