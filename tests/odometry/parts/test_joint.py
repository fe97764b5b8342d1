"""The joint of two parts is as exact as it says, whether errors are independent or last for many frames."""

import numpy as np
import pytest
from made_parts import autoregressive, way

from wayloom.geometry import se3
from wayloom.odometry.parts.joint import joint, robust_mean

FRAMES, DRAWS = 80, 150
SIGMA = np.array([0.02, 0.01, 0.03, 4e-4, 6e-4, 3e-4])
T_BEFORE_AFTER = se3.exp(np.array([40.0, -2.0, 120.0, 0.02, 0.7, -0.03]))


def two_parts(seed: int, rho: float) -> tuple[np.ndarray, np.ndarray]:
    """Poses of the frames that two parts share; the later ones with noise in the camera's axes."""
    before = se3.exp(np.array([5.0, 0.0, 300.0, 0.0, 0.4, 0.0])) @ way(FRAMES)
    noise = se3.exp(SIGMA * autoregressive(np.random.default_rng([seed, 7]), FRAMES, rho))
    middle = before[FRAMES // 2]
    seen = middle @ noise @ se3.inverse(middle) @ before
    return before, se3.inverse(T_BEFORE_AFTER) @ seen


def normalised_error(before: np.ndarray, after: np.ndarray, offset: np.ndarray) -> float:
    """Squared error of the joint at the middle frame over its covariance, a sixth of it: 1 on average where it is honest."""
    found = joint(before, after)
    c = FRAMES // 2
    told = se3.inverse(before[c]) @ found.T_before_after @ after[c]
    true = se3.inverse(before[c]) @ T_BEFORE_AFTER @ after[c]
    xi = se3.log(told @ se3.inverse(true)) - offset
    return float(xi @ np.linalg.solve(found.covariance, xi)) / 6.0


def test_parts_that_agree_are_joined_exactly() -> None:
    before, _ = two_parts(0, 0.0)
    found = joint(before, se3.inverse(T_BEFORE_AFTER) @ before)
    np.testing.assert_allclose(found.T_before_after, T_BEFORE_AFTER, atol=1e-9)
    assert found.scale_ratio == pytest.approx(1.0, abs=1e-12)
    assert found.frames == FRAMES


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.8])
def test_the_covariance_of_a_joint_is_that_of_its_error(rho: float) -> None:
    errors = [normalised_error(*two_parts(seed, rho), np.zeros(6)) for seed in range(DRAWS)]
    # chi-square of 6 x 150: mean 1 with sigma 0.05; a covariance that is itself estimated adds to the mean, the more the fewer
    # independent frames there are: Hotelling's n / (n - 8), with n = 80, 27, 9
    few = FRAMES * (1.0 - rho) / (1.0 + rho)
    assert 0.8 < np.mean(errors) < 1.3 * max(few / max(few - 8.0, 1.0), 1.0)


def test_frames_that_are_far_off_do_not_move_the_joint() -> None:
    before, after = two_parts(3, 0.0)
    wrong = after.copy()
    wrong[10:20] = wrong[10:20] @ se3.exp(np.array([1.0, 0.0, -2.0, 0.0, 0.05, 0.0]))
    good, bad = joint(before, after), joint(before, wrong)
    c = FRAMES // 2
    moved = se3.log(se3.inverse(before[c]) @ bad.T_before_after @ se3.inverse(good.T_before_after) @ before[c])
    assert (np.abs(moved) < SIGMA).all()


def test_the_mean_of_poses_is_between_them_whatever_frame_they_are_in() -> None:
    rng = np.random.default_rng(1)
    T = se3.exp(0.01 * rng.normal(size=(40, 6)))
    mean, covariance = robust_mean(T)
    turned = se3.exp(np.array([0.3, 0.0, 0.0, 0.0, 1.2, 0.0]))
    other, _ = robust_mean(turned @ T @ se3.inverse(turned))
    assert np.abs(se3.log(mean)).max() < 4 * 0.01 / np.sqrt(40)
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), 0.01 / np.sqrt(40), rtol=0.6)
    assert np.abs(se3.log(other @ se3.inverse(turned @ mean @ se3.inverse(turned)))).max() < 0.01 / np.sqrt(40)


def test_a_part_of_another_scale_is_noticed() -> None:
    before, _ = two_parts(0, 0.0)
    after = before.copy()
    after[:, :3, 3] = 1.01 * (before[:, :3, 3] - before[0, :3, 3])
    assert joint(before, after).scale_ratio == pytest.approx(1.01, abs=1e-9)


def test_a_car_that_stands_tells_no_scale() -> None:
    standing = np.repeat(way(3)[1:2], FRAMES, axis=0)
    found = joint(standing, se3.inverse(T_BEFORE_AFTER) @ standing)
    assert np.isnan(found.scale_ratio)
    np.testing.assert_allclose(found.T_before_after, T_BEFORE_AFTER, atol=1e-9)
