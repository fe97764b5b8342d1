"""What drives with RTK say of baseline and lens, and what they cannot."""

import numpy as np
import pytest

from wayloom.calibration.baseline import ScaleByGnss, joint_covariance, with_gnss
from wayloom.calibration.settings import CalibrationSettings

SIGMAS = CalibrationSettings().lens.sigmas
BASELINE_SIGMA = 0.003
TRUE_LOG_RATIO = 0.004
TRUE_LENS = 0.5 * SIGMAS * np.array([1, -1, 1, -1, 1, -1, 1, -1, 1, -1])


def drive(by_lens: np.ndarray, ratio_error: float = 0.0, sigma: float = 3e-4, baseline_ratio: float = 1.0) -> ScaleByGnss:
    """A drive that was tracked with the ideal lens."""
    log_ratio = by_lens @ TRUE_LENS + TRUE_LOG_RATIO - np.log(baseline_ratio) + ratio_error
    return ScaleByGnss(float(np.exp(log_ratio)), sigma, by_lens, 0.0, np.zeros(10), baseline_ratio)


def gradients(count: int, seed: int = 0) -> list[np.ndarray]:
    return [0.01 / SIGMAS * row for row in np.random.default_rng(seed).normal(size=(count, 10))]


def test_with_a_lens_that_images_know_one_drive_tells_the_baseline() -> None:
    before = joint_covariance(np.diag((1e-3 * SIGMAS) ** 2), BASELINE_SIGMA)
    found, after, used = with_gnss(TRUE_LENS, before, [drive(gradients(1)[0])])
    assert used == 1
    assert np.sqrt(after[10, 10]) < 6e-4
    assert abs(found[10] - TRUE_LOG_RATIO) < 3 * np.sqrt(after[10, 10])


def test_with_an_unknown_lens_one_drive_tells_the_sum_of_lens_and_baseline_and_neither() -> None:
    before = joint_covariance(np.diag(SIGMAS**2), BASELINE_SIGMA)
    a = gradients(1)[0]
    found, after, _ = with_gnss(np.zeros(10), before, [drive(a)])
    of_sum = np.append(a, 1.0)
    assert of_sum @ found == pytest.approx(a @ TRUE_LENS + TRUE_LOG_RATIO, abs=1e-4)
    assert np.sqrt(of_sum @ after @ of_sum) < 5e-4
    assert np.sqrt(after[10, 10]) > 0.9 * BASELINE_SIGMA


def test_drives_along_different_streets_tell_lens_and_baseline_apart() -> None:
    before = joint_covariance(np.diag(SIGMAS**2), BASELINE_SIGMA)
    found, after, used = with_gnss(np.zeros(10), before, [drive(a, sigma=1e-4) for a in gradients(30)])
    assert used == 30
    assert np.sqrt(after[10, 10]) < 0.1 * BASELINE_SIGMA
    assert abs(found[10] - TRUE_LOG_RATIO) < 3 * np.sqrt(after[10, 10])
    np.testing.assert_allclose(found[:10], TRUE_LENS, atol=0.1 * SIGMAS.max())


def test_a_drive_that_was_tracked_with_a_known_baseline_says_the_same() -> None:
    before = joint_covariance(np.diag((1e-3 * SIGMAS) ** 2), BASELINE_SIGMA)
    a = gradients(1)[0]
    one, other = (with_gnss(TRUE_LENS, before, [drive(a, baseline_ratio=ratio)])[0] for ratio in (1.0, 1.004))
    np.testing.assert_allclose(one, other, atol=1e-12)


def test_a_drive_whose_fixes_are_wrong_is_left_out() -> None:
    before = joint_covariance(np.diag((1e-3 * SIGMAS) ** 2), BASELINE_SIGMA)
    right = [drive(a) for a in gradients(4)]
    wrong = drive(gradients(1, seed=9)[0], ratio_error=0.02)
    found, _, used = with_gnss(TRUE_LENS, before, [*right[:2], wrong, *right[2:]])
    assert used == 4
    np.testing.assert_allclose(found, with_gnss(TRUE_LENS, before, right)[0], atol=1e-12)


def test_the_sigma_of_the_baseline_holds_over_many_rigs() -> None:
    rng, z = np.random.default_rng(4), []
    for _ in range(300):
        x, b = 0.02 * SIGMAS * rng.normal(size=10), BASELINE_SIGMA * rng.normal()
        drives = []
        for a in gradients(3, seed=int(rng.integers(1 << 30))):
            noise = np.hypot(3e-4, 3e-4) * rng.normal()  # of the fixes, and of the odometry's floor
            drives.append(ScaleByGnss(float(np.exp(a @ x + b + noise)), 3e-4, a, 0.0, np.zeros(10), 1.0))
        found, after, _ = with_gnss(np.zeros(10), joint_covariance(np.diag((0.02 * SIGMAS) ** 2), BASELINE_SIGMA), drives)
        z.append((found[10] - b) / np.sqrt(after[10, 10]))
    assert 0.8 < np.mean(np.square(z)) < 1.2  # 95 % of means of 300 squares lie in 0.84 to 1.16
