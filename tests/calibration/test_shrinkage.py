"""How much of a learnt lens is used."""

import numpy as np
import pytest
from made_observations import LENS, made_drive

from wayloom.calibration.covariance import lens_covariance
from wayloom.calibration.learn import learn_rig
from wayloom.calibration.settings import CalibrationSettings
from wayloom.calibration.shrinkage import SIZES, shrunk
from wayloom.geometry.lens import IDENTITY

SETTINGS = CalibrationSettings()
UNIT = SETTINGS.lens.sigmas


def naive(x: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """The twin: the size by the density of a normal distribution, one after another."""
    best, best_cost = 0.0, np.inf
    for tau in SIZES:
        total = covariance + tau**2 * np.diag(UNIT**2)
        cost = x @ np.linalg.inv(total) @ x + np.linalg.slogdet(total)[1]
        if cost < best_cost:
            best, best_cost = float(tau), cost
    prior = best**2 * np.diag(UNIT**2)
    return prior @ np.linalg.inv(covariance + prior) @ x


def test_it_is_what_the_equations_say() -> None:
    rng = np.random.default_rng(0)
    for size in (0.05, 0.3, 1.0):
        root = 0.1 * rng.normal(size=(10, 10))
        covariance = (root @ root.T + 0.01 * np.eye(10)) * np.outer(UNIT, UNIT)
        x = size * UNIT * rng.normal(size=10)
        np.testing.assert_allclose(shrunk(x, covariance), naive(x, covariance), atol=1e-6 * UNIT.max())


def test_noise_about_the_ideal_camera_is_left_out_and_a_fault_is_used_as_it_is() -> None:
    rng = np.random.default_rng(1)
    covariance = np.diag((0.02 * UNIT) ** 2)
    noise = [0.02 * UNIT * rng.normal(size=10) for _ in range(50)]
    left = [np.linalg.norm(shrunk(x, covariance) / UNIT) / np.linalg.norm(x / UNIT) for x in noise]
    assert np.median(left) < 0.2
    fault = UNIT * rng.normal(size=10)
    np.testing.assert_allclose(shrunk(fault, covariance), fault, rtol=2e-3, atol=1e-7)


def test_what_is_hardly_known_stays_near_zero_beside_what_is_known_well() -> None:
    x = UNIT * np.array([0.3, -0.4, 0.2, 0.3, 0.9, 0.3, -0.2, 0.3, 0.2, -0.3])
    sigma = 0.02 * UNIT
    sigma[4] = UNIT[4]
    used = shrunk(x, np.diag(sigma**2))
    assert abs(used[4]) < 0.2 * abs(x[4])
    assert used[0] == pytest.approx(x[0], rel=0.02)


@pytest.mark.parametrize(("lens", "share"), [(LENS, (0.97, 1.01)), (IDENTITY, (0.0, 0.7))], ids=["worn", "perfect"])
def test_drives_of_a_worn_rig_use_its_lens_and_those_of_a_perfect_one_hardly_any(lens: object, share: tuple[float, float]) -> None:
    rig = learn_rig([made_drive(lens, seed, group_px=0.05) for seed in range(2)]).rig  # type: ignore[arg-type]
    x = rig.lens.values - IDENTITY.values
    used = shrunk(x, lens_covariance(rig, SETTINGS)[0])
    assert share[0] <= np.linalg.norm(used / UNIT) / np.linalg.norm(x / UNIT) <= share[1]
