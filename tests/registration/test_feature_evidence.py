"""What matched features alone say for a pose."""

import numpy as np
import pytest
from scipy.stats import binom

from wayloom.geometry import se3
from wayloom.registration.feature_evidence import chance_log10, feature_evidence, things
from wayloom.registration.matches import ROUNDS, Matches
from wayloom.registration.settings import RegistrationSettings
from wayloom.registration.verification import features_suffice, refusal

FOCAL_PX = 180.0
R_CAM_LEVEL = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
SETTINGS = RegistrationSettings()


def side(p_level: np.ndarray, rng: np.random.Generator) -> Matches:
    """Points (M, 3) of a level frame as its camera sees them, to half a pixel and with stereo's depth."""
    T_cam_level = se3.from_rotation_translation(R_CAM_LEVEL, np.zeros(3))
    p_cam = se3.transform(T_cam_level, p_level)
    ray = p_level / np.linalg.norm(p_level, axis=1)[:, None]
    sigma = 0.02 + 0.002 * p_cam[:, 2] ** 2
    seen_at = p_cam[:, :2] / p_cam[:, 2:] + rng.normal(0.0, 0.5 / FOCAL_PX, (len(p_cam), 2))
    noisy = p_level + ray * (sigma * rng.normal(size=len(sigma)))[:, None]
    spread = np.einsum("ni,nj->nij", ray, ray) * (sigma**2)[:, None, None]
    return Matches(noisy, spread, seen_at, np.tile(T_cam_level, (len(p_cam), 1, 1)), FOCAL_PX)


def street(count: int, seed: int) -> np.ndarray:
    """(count, 3) points on both sides of a street, 6 to 35 m ahead."""
    rng = np.random.default_rng(seed)
    return np.column_stack(
        [rng.choice([-7.0, 7.0], count) + rng.normal(0, 1, count), rng.uniform(9, 35, count), rng.uniform(-1, 6, count)]
    )


def pair(p_a: np.ndarray, wrong: int, seed: int = 0) -> tuple[Matches, Matches, np.ndarray]:
    """Matches of the points p_a (M, 3), of which the first `wrong` are points elsewhere, and T_a_b."""
    rng = np.random.default_rng(seed)
    T_a_b = se3.exp(np.array([0.4, -1.0, 0.05, 0.0, 0.0, 0.05]))
    p_b = se3.transform(se3.inverse(T_a_b), p_a)
    p_b[:wrong] = street(wrong, seed + 99)
    return side(p_a, rng), side(p_b, rng), T_a_b


def test_many_features_around_know_a_pose_alone() -> None:
    found = feature_evidence(*pair(street(200, 1), 100))
    assert found["chance_log10"] < -20.0
    assert features_suffice(found, SETTINGS)


def test_features_of_one_wall_far_away_do_not_though_they_are_as_many() -> None:
    rng = np.random.default_rng(1)
    wall = np.column_stack([rng.uniform(-2, 2, 200), np.full(200, 34.0), rng.uniform(0, 5, 200)])
    found = feature_evidence(*pair(wall, 40))
    assert found["feature_sigma_m"] > SETTINGS.max_feature_sigma_m
    assert not features_suffice(found, SETTINGS)


def test_few_things_do_not_though_many_corners_of_them_agree() -> None:
    corners = np.repeat(street(8, 1), 25, axis=0) + np.random.default_rng(0).uniform(0, 0.1, (200, 3))
    found = feature_evidence(*pair(np.concatenate([street(100, 2), corners]), 100))
    assert found["chance_log10"] > SETTINGS.max_chance_log10
    assert not features_suffice(found, SETTINGS)


def test_a_facade_that_fits_elsewhere_too_counts_for_less() -> None:
    """Half of the matches agree with another pose, a window beside the first."""
    p_a = street(200, 1)
    a, b, T = pair(p_a, 0)
    shifted = se3.transform(se3.inverse(T), p_a + np.array([0.0, 3.0, 0.0]))
    half = np.arange(200) % 2 == 0
    b_half = side(np.where(half[:, None], shifted, se3.transform(se3.inverse(T), p_a)), np.random.default_rng(4))
    assert feature_evidence(a, b_half, T)["chance_log10"] > -3.0
    assert feature_evidence(a, b, T)["chance_log10"] < -20.0


def test_the_number_of_false_alarms_is_the_tail_of_the_binomial_times_the_poses_tried() -> None:
    tail = sum(binom.pmf(k, 40, 0.1) for k in range(9, 41))
    assert chance_log10(9, 40, 0.1) == pytest.approx(np.log10(ROUNDS * tail))
    assert chance_log10(0, 40, 0.1) > 0.0
    assert chance_log10(40, 40, 1.0) == pytest.approx(np.log10(ROUNDS))


def test_corners_beside_each_other_are_one_thing_and_so_are_depths_that_noise_explains() -> None:
    rng = np.random.default_rng(0)
    near = np.array([[0.1, 8.0, 0.1], [0.6, 8.2, 0.3], [3.0, 8.0, 0.3]])
    assert things(side(near, rng)) == 2
    assert things(side(np.array([[0.0, 30.0, 0.0], [0.0, 33.0, 0.0]]), rng)) == 1
    assert things(side(np.zeros((0, 3)), rng)) == 0


def test_features_that_suffice_let_views_pass_that_share_little() -> None:
    evidence = {"inliers": 168, "overlap": 0.06, "through": 0.0, "agreement": 0.95, "score": 0.3, "sigma_m": 0.07}
    known = {"chance_log10": -29.0, "feature_sigma_m": 0.07, "feature_sigma_deg": 0.2}
    assert "share" in refusal(evidence, SETTINGS, True)
    assert refusal(evidence | known, SETTINGS, True) == ""
    assert "share" in refusal(evidence | known | {"feature_sigma_m": 0.2}, SETTINGS, True)
    assert "saw through" in refusal(evidence | known | {"through": 0.2}, SETTINGS, True)
