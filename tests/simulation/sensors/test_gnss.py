"""GNSS: errors as stated, except where the receiver is told to be wrong, and packets that the reader understands."""

import numpy as np
import pytest
from scipy import stats

from simulation.winding import Winding
from wayloom.geodesy.map_frame import MapFrame
from wayloom.geodesy.wgs84 import enu_from_lonlatheight
from wayloom.geometry import se3
from wayloom.logs.sidecars.oxts import R_enu_imu
from wayloom.logs.types import FixType
from wayloom.simulation.sensors.gnss import SIGMA_M, GnssRecord, fix_errors, packets, simulated_fixes, steps_in_force, track
from wayloom.simulation.vehicle.motion import camera_poses
from wayloom.simulation.vehicle.vehicle_settings import (
    ClockSettings,
    GnssBurst,
    GnssSettings,
    GnssStep,
    VehicleSettings,
    gnss_steps,
)

FRAME = MapFrame(3.52, 55.49, 45.0)
NONE, SINGLE, FLOAT, FIXED = FixType.NONE, FixType.SINGLE, FixType.FLOAT, FixType.FIXED


def drive(settings: GnssSettings, seed: int = 5, clock: ClockSettings | None = None) -> tuple[GnssRecord, VehicleSettings]:
    vehicle = VehicleSettings(gnss=settings, clock=clock or ClockSettings())
    record = simulated_fixes(Winding(), vehicle, np.random.default_rng(seed))
    assert record is not None
    return record, vehicle


@pytest.mark.parametrize("fix", [FixType.FIXED, FixType.FLOAT, FixType.SINGLE])
def test_errors_have_the_stated_covariance(fix: FixType) -> None:
    drives = 400
    errors = np.array([fix_errors(np.full(5, fix, np.uint8), 0.1, np.random.default_rng([3, k]))[-1] for k in range(drives)])
    squares = np.sum((errors / (SIGMA_M[fix] * np.array([1.0, 1.0, 2.0]))) ** 2)
    low, high = stats.chi2.ppf((0.001, 0.999), 3 * drives)
    assert low < squares < high


def test_fixes_as_written_stay_within_their_covariance() -> None:
    drives, squares = 150, 0.0
    for seed in range(drives):
        record, vehicle = drive(GnssSettings(rate_hz=5.0, steps=gnss_steps((0.0, FIXED), (0.4, FLOAT), (0.7, SINGLE))), seed)
        fixes = track(record, Winding(), vehicle, FRAME, 0)
        k = seed % len(fixes)  # one fix a drive: those of one drive depend on each other
        error = enu_from_lonlatheight(fixes.lon_lat_height[k : k + 1], FRAME)[0] - record.antenna_enu[k]
        squares += float(error @ np.linalg.inv(fixes.covariance_enu[k]) @ error)
    low, high = stats.chi2.ppf((0.001, 0.999), 3 * drives)
    assert low < squares < high


def test_half_of_the_error_stays_from_one_fix_to_the_next() -> None:
    errors = np.array([fix_errors(np.full(2, FixType.FIXED, np.uint8), 0.1, np.random.default_rng([4, k])) for k in range(3000)])
    correlation = np.mean(errors[:, 0] * errors[:, 1]) / np.mean(errors**2)
    assert correlation == pytest.approx(0.5 * np.exp(-0.1 / 8.0), abs=0.05)


def test_a_plan_gives_each_part_of_the_drive_its_fix() -> None:
    steps = steps_in_force(gnss_steps((0.0, FIXED), (0.5, NONE), (0.75, FLOAT)), np.arange(9) / 8)
    assert [int(step.fix) for step in steps] == [3, 3, 3, 3, 0, 0, 2, 2, 2]


def test_fixes_come_at_their_own_rate_on_the_receivers_clock() -> None:
    record, vehicle = drive(GnssSettings(rate_hz=7.0), clock=ClockSettings(offset_s=-0.1, drift=1e-3))
    fixes = track(record, Winding(), vehicle, FRAME, 1_000_000_000)
    assert len(fixes) == 71
    np.testing.assert_allclose(np.diff(fixes.t_ns), 1e9 / 7 * 1.001, atol=2)
    assert fixes.t_ns[0] == 900_000_000


def test_fixes_are_the_antennas_place_and_held_in_an_outage() -> None:
    record, vehicle = drive(GnssSettings(steps=gnss_steps((0.0, FIXED), (0.5, NONE), (0.75, FIXED))))
    T = camera_poses(Winding(), vehicle.T_body_cam, record.t_s)
    np.testing.assert_allclose(record.antenna_enu, [se3.transform(t, np.array([vehicle.p_cam_gnss_m]))[0] for t in T], atol=1e-9)
    fixed = record.fix == FIXED
    assert np.abs(record.measured_enu - record.antenna_enu)[fixed].max() < 0.2
    assert np.all(record.measured_enu[50:75] == record.measured_enu[49])
    said = packets(record, Winding(), vehicle, FRAME, 0, np.random.default_rng(0))
    assert {p.sigma_m for p in said} == {0.02, 50.0}
    assert said[60].satellites == 0


def test_multipath_jumps_together_while_the_receiver_claims_a_fix() -> None:
    record, _ = drive(GnssSettings(steps=gnss_steps((0.0, FIXED)), bursts=(GnssBurst(share=0.3, duration_s=2.0, size_m=8.0),)))
    error = record.measured_enu - record.antenna_enu
    inside = record.multipath
    assert inside.sum() == 20
    assert np.all(record.fix == FIXED)
    assert np.all(record.stated_m == SIGMA_M[FIXED])
    assert np.linalg.norm(error[inside].mean(axis=0)[:2]) == pytest.approx(8.0, abs=8.0 * 0.2 * 3)
    assert np.abs(error[~inside]).max() < 0.2
    steps = np.linalg.norm(np.diff(error[inside], axis=0), axis=1)
    assert steps.max() < 4.0  # it wanders; it does not jump back and forth


def test_an_overconfident_stretch_states_less_than_its_errors() -> None:
    steps = (GnssStep(share=0.0, fix=FLOAT), GnssStep(share=0.5, fix=FLOAT, stated_ratio=0.1))
    squares = np.zeros(2)
    for seed in range(100):
        record, _ = drive(GnssSettings(rate_hz=5.0, steps=steps), seed)
        normalised = (record.measured_enu - record.antenna_enu)[:, :2] / record.stated_m[:, None]
        squares += [np.sum(normalised[10] ** 2), np.sum(normalised[40] ** 2)]
    low, high = stats.chi2.ppf((0.001, 0.999), 200)
    assert low < squares[0] < high
    assert 100 * low < squares[1] < 100 * high


def test_packets_say_how_the_unit_stands_and_moves() -> None:
    record, vehicle = drive(GnssSettings())
    said = packets(record, Winding(), vehicle, FRAME, 0, np.random.default_rng(0))
    T = camera_poses(Winding(), vehicle.T_body_cam @ vehicle.T_cam_imu, record.t_s)
    angles = np.array([p.roll_pitch_yaw for p in said]).T
    np.testing.assert_allclose(R_enu_imu(*angles), T[:, :3, :3], atol=1e-9)
    velocity = np.gradient(T[:, :3, 3], record.t_s, axis=0)[1:-1]
    assert np.std(np.array([p.velocity_enu for p in said])[1:-1] - velocity) < 0.1
    assert np.linalg.norm(np.mean([p.specific_force for p in said], axis=0)) == pytest.approx(9.8, abs=0.5)


def test_a_vehicle_without_a_receiver_has_no_fixes() -> None:
    assert simulated_fixes(Winding(), VehicleSettings(gnss=None), np.random.default_rng(0)) is None
