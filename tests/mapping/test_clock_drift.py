"""Clocks of receivers that drift against the cameras'."""

import numpy as np
import pytest

from mapping.test_drive_graph import NOISE, exact_fixes, straight
from wayloom.evaluation.gnss_drives import Receiver, city_way, made_drive
from wayloom.georeference.alignment import georeference
from wayloom.mapping.clock_drift import ClockDrift, clock_drift
from wayloom.mapping.drive_equations import CorrelatedFixes, DriveEquations
from wayloom.mapping.drive_types import DriveNoise
from wayloom.mapping.odometry_links import links_of

UNKNOWN_CLOCK = DriveNoise(
    0.005, np.radians(0.02), 0.002, np.radians(0.01), 1e-4, 100.0, np.radians(3.0), 30.0, 0.02, 0.9999, 0.05, 1e-3
)
"""Of an odometry whose scale is known: on a straight road it is all that tells a drift."""


def seen(drift: float, noise: DriveNoise, seconds: float = 20.0) -> ClockDrift | None:
    """By a straight drive at 10 m/s whose stamps are later and later."""
    chain = straight(round(10 * seconds))
    fixes = exact_fixes(chain, 0.02)
    late_s = drift * (fixes.t_s - fixes.t_s.mean())
    fixes.position_enu[:, 1] -= 10.0 * late_s
    equations = DriveEquations(chain, links_of(chain, noise), CorrelatedFixes(fixes, noise), noise)
    return clock_drift(equations, equations.descend(equations.first_state(chain.T_world_node)))


@pytest.mark.parametrize("drift", [0.0, 1e-3, -2e-3])
def test_a_drift_is_found_where_the_odometry_knows_its_length(drift: float) -> None:
    found = seen(drift, UNKNOWN_CLOCK)
    assert found is not None
    assert found.drift == pytest.approx(drift, abs=0.2 * found.sigma + 0.1 * abs(drift))


def test_clocks_of_one_pulse_are_not_asked() -> None:
    assert seen(1e-3, NOISE) is None


def test_a_drive_of_seconds_tells_no_drift() -> None:
    assert seen(1e-3, UNKNOWN_CLOCK, seconds=5.0) is None


@pytest.mark.parametrize(("drift", "seed"), [(5e-4, 1), (0.0, 1)])
def test_a_clock_that_drifts_is_put_right_and_one_that_does_not_is_left_alone(drift: float, seed: int) -> None:
    """Half a millisecond a second for two minutes: the drive was 0.17 m off at a third of the sigma."""
    drive = made_drive(city_way(120.0), Receiver(drift=drift), seed)
    geo = georeference(drive.log, drive.odometry)  # type: ignore[arg-type]
    assert geo.frame is not None
    error = geo.T_enu_cam[:, :3, 3] - drive.truth_in(geo.frame)[:, :3, 3]
    assert np.sqrt((error**2).sum(axis=1).mean()) < 0.06
    assert geo.report["clock_drift_ms_per_s"] == pytest.approx(1e3 * drift, abs=0.1)
    assert any("drifts" in message for message in geo.report["messages"]) == (drift > 0.0)
