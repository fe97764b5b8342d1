"""Poses from matched local features: reprojection both ways."""

import cv2
import numpy as np
import pytest

from wayloom.geometry import se3
from wayloom.places.types import PlaceFeatures, PlaceView
from wayloom.registration.matches import Matches, equations, errors2, match, pose_of_matches

FOCAL_PX = 400.0
LEVEL_FROM_CAM = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])


def some_views(count: int = 120, wrong: int = 0, noise_px: float = 0.0) -> tuple[PlaceView, PlaceView, np.ndarray]:
    """Two views of the same points from nearby cameras, `wrong` of them with each other's descriptors, and the true T_a_b."""
    rng = np.random.default_rng(3)
    T_a_b = se3.exp(np.array([0.4, 1.5, 0.1, 0.01, -0.01, 0.06]))
    points_b = np.column_stack([rng.uniform(-8, 8, count), rng.uniform(8, 30, count), rng.uniform(-1.5, 5, count)])
    bits = rng.integers(0, 256, (count, 32)).astype(np.uint8)
    mixed = bits.copy()
    mixed[:wrong] = np.roll(bits[:wrong], 1, axis=0)
    return view(se3.transform(T_a_b, points_b), bits, noise_px, 4), view(points_b, mixed, noise_px, 5), T_a_b


def view(points_level: np.ndarray, bits: np.ndarray, noise_px: float, seed: int) -> PlaceView:
    """A view with one keyframe at its origin."""
    rng, count = np.random.default_rng(seed), len(points_level)
    p_cam = se3.transform(se3.inverse(LEVEL_FROM_CAM), points_level)
    uv = FOCAL_PX * p_cam[:, :2] / p_cam[:, 2:] + 200.0 + noise_px * rng.normal(size=(count, 2))
    sigma = 0.001 * p_cam[:, 2] ** 2 + 1e-3
    depth = p_cam[:, 2] + (sigma * rng.normal(size=count) if noise_px else 0.0)
    p_cam = np.column_stack([(uv - 200.0) / FOCAL_PX * depth[:, None], depth])
    features = PlaceFeatures(
        np.zeros(count, np.int32), bits, uv.astype(np.float32), p_cam.astype(np.float32), sigma.astype(np.float32)
    )  # fmt: skip
    none = np.zeros((0, 3), np.float32)
    return PlaceView(
        0, LEVEL_FROM_CAM, none, np.zeros(0, np.uint8), none[:, 0], np.zeros(0, np.int32), np.zeros((0, 3)), features,
        LEVEL_FROM_CAM[None],
    )  # fmt: skip


def matched(**options: float) -> tuple[Matches, Matches, np.ndarray]:
    a, b, T_a_b = some_views(**options)  # type: ignore[arg-type]
    return *match(a, b), T_a_b


def test_features_of_equal_descriptors_are_matched() -> None:
    a, b, T_a_b = matched()
    assert len(a) == 120
    assert a.focal_px == pytest.approx(FOCAL_PX, rel=1e-3)
    np.testing.assert_allclose(a.p_level, se3.transform(T_a_b, b.p_level), atol=1e-4)


def test_the_true_pose_leaves_no_error() -> None:
    a, b, T_a_b = matched()
    assert errors2(T_a_b, a, b, 1.0).max() < 1e-4


def test_the_right_hand_side_is_the_gradient_where_weights_are_one() -> None:
    """At small errors the weights are 1/2; the information is held fixed, as it hardly moves with the pose."""
    a, b, T_a_b = matched(noise_px=0.1)
    T = se3.exp(np.full(6, 1e-3)) @ T_a_b
    _, g = equations(T, a, b, 20.0)
    for k in range(6):
        xi = np.zeros(6)
        xi[k] = 1e-5
        ends = [errors2(se3.exp(s * xi) @ T, a, b, 20.0).sum() for s in (1.0, -1.0)]
        assert -0.5 * (ends[0] - ends[1]) / 2e-5 == pytest.approx(g[k], rel=0.02, abs=0.02 * np.abs(g).max())


@pytest.mark.parametrize("wrong", [0, 70])
def test_the_pose_is_found_among_wrong_matches(wrong: int) -> None:
    a, b, T_a_b = matched(wrong=wrong, noise_px=0.5)
    found = pose_of_matches(a, b)
    assert found is not None
    T, inliers = found
    apart = se3.log(T @ se3.inverse(T_a_b))
    assert np.linalg.norm(T[:3, 3] - T_a_b[:3, 3]) < 0.05
    assert np.linalg.norm(apart[3:]) < np.deg2rad(0.3)
    assert inliers >= 0.9 * (120 - wrong)


def test_the_same_matches_give_the_same_bits() -> None:
    a, b, _ = matched(wrong=60, noise_px=0.5)
    one, other = pose_of_matches(a, b), pose_of_matches(a, b)
    assert one is not None
    assert other is not None
    assert one[0].tobytes() == other[0].tobytes()


def test_the_matches_are_the_same_with_any_number_of_threads() -> None:
    a, b, _ = some_views(wrong=60, noise_px=0.5)
    before, found = cv2.getNumThreads(), []
    try:
        for threads in (1, 4):
            cv2.setNumThreads(threads)
            found.append(match(a, b)[0].p_level.tobytes())
    finally:
        cv2.setNumThreads(before)
    assert found[0] == found[1]


def test_two_matches_are_too_few() -> None:
    a, b, _ = matched(count=2)
    assert pose_of_matches(a, b) is None
