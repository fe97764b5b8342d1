import numpy as np
import pytest
from made_street import CAMERA, RIG, pair

from wayloom.geometry.camera import StereoRig
from wayloom.odometry.rig import rows


def made_matches(coefficients: np.ndarray, rig: StereoRig, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    u, v, disparity = rng.uniform(60, 310, 800), rng.uniform(10, 190, 800), rng.uniform(1, 40, 800)
    x, y = (u - disparity - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy
    dv = rows.design(x, y) @ coefficients + rows.known_row_offset(rig, v, disparity) + 0.05 * rng.normal(size=800)
    dv[::10] += rng.uniform(-2, 2, 80)
    return np.column_stack([u, v, disparity, dv])


def test_the_rows_misalignment_is_fitted_among_outliers() -> None:
    truth = np.array([-0.3, 0.5, 4.0])
    np.testing.assert_allclose(rows.fit(made_matches(truth, RIG), RIG), truth, atol=0.1)


def test_what_the_calibration_knows_of_the_rows_is_not_fitted_again() -> None:
    rig = StereoRig(CAMERA, (-0.5, 0.01, 0.005))
    np.testing.assert_allclose(rows.fit(made_matches(np.zeros(3), rig), rig), 0.0, atol=0.1)


def test_too_few_matches_change_nothing() -> None:
    assert rows.fit(made_matches(np.ones(3), RIG)[:20], RIG).tolist() == [0.0, 0.0, 0.0]


def test_a_bent_right_image_is_found_and_straightened() -> None:
    left, right, _ = pair(np.eye(4))
    left8, right8 = (np.round(image).astype(np.uint8) for image in (left, right))
    truth = np.array([0.4, -0.5, 1.0])
    bent = rows.align(right8, rows.displacements(-truth, RIG))  # lies about dv lower than it should
    found = rows.fit(rows.row_matches(left8, bent), RIG)
    np.testing.assert_allclose(found, truth, atol=0.15)
    straight = rows.align(bent, rows.displacements(found, RIG))
    inner = np.s_[10:-10, 10:-10]
    error = [np.abs(image[inner].astype(float) - right8[inner]).mean() for image in (bent, straight)]
    assert error[1] < 0.7 * error[0]


def test_a_straight_pair_stays_straight() -> None:
    left, right, _ = pair(np.eye(4))
    left8, right8 = (np.round(image).astype(np.uint8) for image in (left, right))
    assert np.abs(rows.fit(rows.row_matches(left8, right8), RIG)).max() < 0.1


@pytest.mark.parametrize("disparity", [0.0, 12.0])
def test_the_known_row_offset_is_that_of_the_projection(disparity: float) -> None:
    rig = StereoRig(CAMERA, (-0.5, 0.02, -0.03))
    rho = disparity / rig.bf
    y = (150.0 - CAMERA.cy) / CAMERA.fy
    expected = CAMERA.fy * (y + 0.02 * rho) / (1 - 0.03 * rho) + CAMERA.cy - 150.0
    assert rows.known_row_offset(rig, np.array([150.0]), np.array([disparity]))[0] == pytest.approx(expected)
