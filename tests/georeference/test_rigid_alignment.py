import numpy as np
import pytest

from wayloom.geometry import se3
from wayloom.georeference.rigid import align_rigid, align_robust, align_yaw, horizontal_spread, mean_motion, ransac_yaw


@pytest.fixture
def cloud():
    return np.random.default_rng(0).normal(size=(40, 3)) * [30.0, 20.0, 2.0]


def test_a_rigid_motion_is_found_exactly(cloud):
    T = se3.exp(np.array([100.0, -50.0, 3.0, 0.3, -0.8, 2.0]))
    assert np.allclose(align_rigid(cloud, se3.transform(T, cloud), np.ones(40)), T, atol=1e-9)


def test_a_turn_about_up_is_found_exactly_and_tilt_is_never_invented(cloud):
    T = se3.exp(np.array([100.0, -50.0, 3.0, 0.0, 0.0, 2.5]))
    assert np.allclose(align_yaw(cloud, se3.transform(T, cloud), np.ones(40)), T, atol=1e-9)
    tilted = align_yaw(cloud, se3.transform(se3.exp(np.array([0, 0, 0, 0.1, 0.1, 0.5])), cloud), np.ones(40))
    assert np.allclose(tilted[2], [0, 0, 1, tilted[2, 3]])


def test_a_mirrored_cloud_still_gives_a_rotation(cloud):
    T = align_rigid(cloud, cloud * [1, 1, -1], np.ones(40))
    assert np.isclose(np.linalg.det(T[:3, :3]), 1.0)


def test_a_third_of_wild_fixes_neither_turns_nor_moves_the_alignment(cloud):
    rng = np.random.default_rng(1)
    T = se3.exp(np.array([10.0, 20.0, 0.0, 0.0, 0.0, 1.0]))
    target = se3.transform(T, cloud) + rng.normal(size=cloud.shape) * 0.01
    target[:13] += rng.normal(size=(13, 3)) * 40.0
    inlier = ransac_yaw(cloud, target, np.full(40, 0.05), 4.0, 200)
    assert not inlier[:13].any()
    assert inlier[13:].all()
    found, residual = align_robust(cloud, target, np.full(40, 0.05), align_rigid)
    assert np.allclose(found, T, atol=0.02)
    assert (residual[13:] < 0.1).all()


def test_the_spread_of_an_evenly_travelled_street_is_its_length():
    street = np.column_stack([np.linspace(0, 100, 500), np.zeros(500), np.zeros(500)])
    assert np.allclose(horizontal_spread(street), [100.0, 0.0], atol=0.5)


def test_the_mean_of_motions_is_between_them():
    T = se3.exp(np.array([[0, 0, 0, 0, 0, -0.1], [2.0, 0, 0, 0, 0, 0.1]]))
    mean = mean_motion(T)
    assert np.allclose(mean[:3, :3], np.eye(3), atol=1e-12)
    assert np.allclose(mean[:3, 3], T[:, :3, 3].mean(axis=0))
