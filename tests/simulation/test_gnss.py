"""GNSS: errors as stated, and packets that the reader understands."""

import numpy as np
import pytest
from scipy import stats

from wayloom.geometry import se3
from wayloom.georeference.geodesy import enu_from_lonlatheight
from wayloom.georeference.types import MapFrame
from wayloom.logs.oxts import R_enu_imu
from wayloom.logs.types import FixType
from wayloom.simulation.gnss import SIGMA_M, FixPlan, fix_errors, receive, roll_pitch_yaw
from wayloom.simulation.rigs import camera_on_ground

FRAME = MapFrame(3.52, 55.49, 45.0)
LEVER = np.array([0.1, -0.5, -0.9])


@pytest.mark.parametrize("fix", [FixType.FIXED, FixType.FLOAT, FixType.SINGLE])
def test_errors_have_the_stated_covariance(fix: FixType) -> None:
    drives = 400
    errors = np.array([fix_errors(np.full(5, fix, np.uint8), 0.1, np.random.default_rng([3, k]))[-1] for k in range(drives)])
    squares = np.sum((errors / (SIGMA_M[fix] * np.array([1.0, 1.0, 2.0]))) ** 2)
    low, high = stats.chi2.ppf((0.001, 0.999), 3 * drives)
    assert low < squares < high


def test_half_of_the_error_stays_from_one_fix_to_the_next() -> None:
    errors = np.array([fix_errors(np.full(2, FixType.FIXED, np.uint8), 0.1, np.random.default_rng([4, k])) for k in range(3000)])
    correlation = np.mean(errors[:, 0] * errors[:, 1]) / np.mean(errors**2)
    assert correlation == pytest.approx(0.5 * np.exp(-0.1 / 8.0), abs=0.05)


def test_a_plan_gives_each_part_of_the_drive_its_fix() -> None:
    plan = FixPlan(((0.0, FixType.FIXED), (0.5, FixType.NONE), (0.75, FixType.FLOAT)))
    assert plan.fixes(9).tolist() == [3, 3, 3, 3, 0, 0, 2, 2, 2]


def test_packets_are_the_antennas_place_and_hold_it_in_an_outage() -> None:
    T = np.array([camera_on_ground(1.2 * k, 0.3 * k, 0.24, k) for k in range(40)])
    t_ns = np.arange(40, dtype=np.int64) * 100_000_000
    plan = FixPlan(((0.0, FixType.FIXED), (0.5, FixType.NONE), (0.75, FixType.FIXED)))
    packets = receive(t_ns, T, FRAME, LEVER, plan, np.random.default_rng(5))
    antenna = np.array([se3.transform(pose, LEVER[None])[0] for pose in T])
    measured = enu_from_lonlatheight(np.array([p.lon_lat_height for p in packets]), FRAME)
    fixed = np.array([p.fix == FixType.FIXED for p in packets])
    assert np.abs(measured - antenna)[fixed].max() < 0.2
    assert np.all(measured[21:29] == measured[20])
    assert {p.sigma_m for p in packets} == {0.02, 50.0}
    assert packets[25].satellites == 0
    assert packets[0].t_ns == 0


def test_angles_are_kittis() -> None:
    T = camera_on_ground(30.0, 12.0, 2.1, 7.0)
    roll, pitch, yaw = (np.array([a]) for a in roll_pitch_yaw(T))
    body_axes = np.column_stack([T[:3, 2], -T[:3, 0], -T[:3, 1]])  # forward, left, up
    np.testing.assert_allclose(R_enu_imu(roll, pitch, yaw)[0], body_axes, atol=1e-9)
