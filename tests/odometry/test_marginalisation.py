import numpy as np
from made_window import BIAS_PX, NUMBERS, ROBUST, made_window

from wayloom.geometry import se3
from wayloom.odometry.backend import adjustment, marginalisation
from wayloom.odometry.kernels.adjustment import reduced_equations

AFFINE_PRIOR = (1e3, 1.0)


def spd(n: int, seed: int) -> np.ndarray:
    A = np.random.default_rng(seed).normal(size=(n, n))
    return A @ A.T + np.eye(n)


def test_elimination_keeps_the_minimum_of_what_stays() -> None:
    H, g, out = spd(17, 0), np.random.default_rng(1).normal(size=17), np.arange(3, 11)
    H_rest, g_rest = marginalisation.eliminate(H, g, out)
    full = np.linalg.solve(H, g)
    np.testing.assert_allclose(np.linalg.solve(H_rest, g_rest), np.delete(full, out), rtol=1e-8)
    np.testing.assert_array_equal(H_rest, H_rest.T)


def test_elimination_survives_unknowns_that_nothing_determines() -> None:
    H, g = spd(12, 2), np.zeros(12)
    H[4], H[:, 4] = 0.0, 0.0
    H_rest, g_rest = marginalisation.eliminate(H, g, np.arange(3, 11))
    assert np.isfinite(H_rest).all()
    assert np.isfinite(g_rest).all()
    assert np.linalg.eigvalsh(H_rest).min() > 0


def test_the_keyframe_far_from_the_newest_and_near_others_leaves() -> None:
    window = made_window(5, 12, disturbed=False)
    T = se3.inverse(window.frames.T_cam_world)
    T[:, :3, 3] = [[0, 0, 0.0], [0, 0, 0.1], [0, 0, 4.0], [0, 0, 8.0], [0, 0, 9.0]]
    window.frames.T_cam_world[:] = se3.inverse(T)
    assert marginalisation.leaving_keyframe(window.frames, window.points.host) == 0
    few = window.points.host.copy()
    few[few == 2] = 1
    assert marginalisation.leaving_keyframe(window.frames, few) == 2


def test_points_of_the_leaving_keyframe_and_those_out_of_sight_leave() -> None:
    window = made_window(4, 3)
    window.points.closed[3, 2:4] = 1
    window.points.closed[4, 3] = 1
    assert np.flatnonzero(marginalisation.leaving_points(window, 0)).tolist() == [0, 1, 2, 3]


def adjusted_window():
    window = made_window(4, 60)
    window.frames.gain_right[:] = [1.0, 0.0]
    robust = ROBUST._replace(max_energy=300.0)
    adjustment.adjust(window, NUMBERS, robust, AFFINE_PRIOR, 20)
    adjustment.cull(window)
    return window, robust


def test_the_prior_is_the_schur_complement_of_the_leaving_points_and_frame() -> None:
    window, robust = adjusted_window()
    gone = marginalisation.leaving_points(window, 0)
    fold = gone & (window.inlier[:, :4] > 0).any(axis=1) & (window.information > 1.0)
    part = type(window.points)(*(column[fold] for column in window.points))
    H, g = reduced_equations(window.images, NUMBERS, window.frames, part, window.disparity_bias[0], robust)
    H[1:7, 1:7] += marginalisation.GAUGE * np.eye(6)
    z = np.zeros(33)
    z[0] = window.disparity_bias[0]
    g = g + window.prior_g + (H @ z)
    H = H + window.prior_H
    H[[7, 8], [7, 8]] += AFFINE_PRIOR
    g[[7, 8]] -= np.array(AFFINE_PRIOR) * window.frames.affine[0]
    stay = np.r_[0, 9:33]
    scale = 1 / np.sqrt(np.diag(H)[1:9])
    C = np.linalg.inv(H[1:9, 1:9] * np.outer(scale, scale)) * np.outer(scale, scale)
    expected = H[np.ix_(stay, stay)] - H[np.ix_(stay, np.arange(1, 9))] @ C @ H[np.ix_(np.arange(1, 9), stay)]
    marginalisation.marginalise(window, 0, gone, NUMBERS, robust, AFFINE_PRIOR)
    unit = 1 / np.sqrt(np.diag(expected) + 1.0)
    np.testing.assert_allclose(window.prior_H * np.outer(unit, unit), expected * np.outer(unit, unit), atol=1e-5)
    assert len(window) == 3
    assert window.points.host.min() >= 0
    assert window.frames.has_first.all()
    assert window.inlier.shape == (len(window.point_id), 4)


def test_marginalising_does_not_move_the_window() -> None:
    window, robust = adjusted_window()
    gone = marginalisation.leaving_points(window, 0)
    before = window.frames.T_cam_world[1:].copy()
    marginalisation.marginalise(window, 0, gone, NUMBERS, robust, AFFINE_PRIOR)
    adjustment.adjust(window, NUMBERS, robust, AFFINE_PRIOR, 10)
    moved = [np.abs(se3.log(a @ se3.inverse(b))).max() for a, b in zip(window.frames.T_cam_world, before, strict=True)]
    assert max(moved) < 0.01
    assert abs(window.disparity_bias[0] - BIAS_PX) < 0.15


def test_first_estimates_stay_once_they_are_set() -> None:
    window = made_window(3, 5)
    marginalisation.fix_first_estimates(window.frames, window.inertial)
    first = window.frames.T_first.copy()
    window.frames.T_cam_world[1] = np.eye(4)
    marginalisation.fix_first_estimates(window.frames, window.inertial)
    np.testing.assert_array_equal(window.frames.T_first, first)


def test_culled_points_are_those_that_no_other_keyframe_confirms() -> None:
    window = made_window(3, 4)
    window.inlier = np.ones((12, 4), np.int64)
    window.inlier[5, :3], window.inlier[6, 2] = 0, 0
    window.information = np.arange(12.0)
    window.inlier[7, 3] = 0
    adjustment.cull(window)
    assert window.point_id.tolist() == [0, 1, 2, 3, 4, 6, 7, 8, 9, 10, 11]
    assert window.points.closed[5, 2] == 1
    assert window.points.has_static[6] == 0
    assert window.information.tolist() == window.point_id.tolist()
