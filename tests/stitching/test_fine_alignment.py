"""Fine alignment of made street views."""

from dataclasses import replace

import numpy as np

from registration.made_streets import made_street, view_of
from wayloom.geometry import se3
from wayloom.registration.register import Prior, register_scenes
from wayloom.registration.scene import VEGETATION, Scene, prepare
from wayloom.registration.settings import RegistrationSettings
from wayloom.registration.types import Registration
from wayloom.stitching.fine_alignment import finely_aligned, without_vegetation

SETTINGS = RegistrationSettings()
PRIOR = np.diag([1.0**2] * 2 + [0.3**2] + [np.deg2rad(1.0) ** 2] * 3)


def opposite_pair(seed: int) -> tuple[Scene, Scene, np.ndarray, Registration]:
    """Two views of a street from both ends, their true T_a_b, and what registration finds."""
    street = made_street(seed)
    (one, T_a), (other, T_b) = view_of(street, 90.0, seed), view_of(street, 92.0, seed + 500, forward=False)
    T_a_b = se3.inverse(T_a) @ T_b
    a, b = prepare(one, SETTINGS), prepare(other, SETTINGS)
    return a, b, T_a_b, register_scenes(a, b, Prior(T_a_b, PRIOR), SETTINGS)


def error_m(found: Registration, T_a_b: np.ndarray) -> float:
    return float(np.linalg.norm(found.T_a_b[:3, 3] - T_a_b[:3, 3]))


def test_views_from_both_ends_are_aligned_better() -> None:
    """The root mean square over eight streets: one alone is luck."""
    before, after = [], []
    for seed in range(8):
        a, b, T_a_b, found = opposite_pair(seed)
        fine = finely_aligned(a, b, found, SETTINGS)
        before.append(error_m(found, T_a_b))
        after.append(error_m(fine, T_a_b))
        xi = se3.log(T_a_b @ se3.inverse(fine.T_a_b))
        assert xi @ np.linalg.solve(fine.covariance, xi) < 22.5  # chi-square, 6 degrees of freedom, 999 of 1000
    assert np.linalg.norm(after) < 0.9 * np.linalg.norm(before)


def test_only_vegetation_is_left_out() -> None:
    a = prepare(view_of(made_street(0), 90.0, 0)[0], SETTINGS)
    bare = without_vegetation(a)
    assert len(bare) == int((a.group != VEGETATION).sum()) < len(a)
    assert (bare.group != VEGETATION).all()
    assert bare.voxels is a.voxels


def test_a_pose_that_features_know_and_one_without_points_are_left_as_they_are() -> None:
    a, b, _, found = opposite_pair(0)
    same_way = replace(found, T_a_b=np.eye(4), evidence=found.evidence | {"inliers": SETTINGS.min_matches})
    assert finely_aligned(a, b, same_way, SETTINGS) is same_way
    many = SETTINGS.model_copy(update={"min_points": 10**6})
    assert finely_aligned(a, b, found, many) is found


def test_a_pose_that_would_move_beyond_its_covariance_is_left_as_it_was() -> None:
    a, b, T_a_b, found = opposite_pair(0)
    shifted = T_a_b.copy()
    shifted[1, 3] += 0.5
    sure = replace(found, T_a_b=shifted, covariance=np.eye(6) * 1e-6)
    assert finely_aligned(a, b, sure, SETTINGS) is sure
