"""The window's kernels against slow twins: sampled pixel by pixel, differentiated numerically, eliminated densely."""

import numpy as np
import pytest
from made_window import BIAS_PX, NUMBERS, ROBUST, made_window

from odometry.naive import correlation, patch_terms, project, sample, schur
from wayloom.geometry import se3
from wayloom.odometry.backend.inertial import NO_IMU
from wayloom.odometry.backend.window import Window
from wayloom.odometry.kernels import adjustment, equations, linear, patch
from wayloom.odometry.kernels.arrays import LEAST_ALIKE, LEFT_ALIKE, PATTERN, RIGHT, RIGHT_ALIKE
from wayloom.odometry.kernels.compiler import opened

patch_residual, projection_jacobian = opened(patch.patch_residual), opened(patch.projection_jacobian)
looks_alike, coupling_of_state = opened(patch.looks_alike), opened(equations.coupling_of_state)

pytestmark = pytest.mark.kernels


def ray(uv):
    return (uv[0] - NUMBERS.cx) / NUMBERS.fx, (uv[1] - NUMBERS.cy) / NUMBERS.fy


def test_patch_sums_are_those_of_the_naive_patch() -> None:
    window = made_window()
    points, image = window.points, window.images.left[1]
    T = linear.relative(window.frames.T_cam_world[1], window.frames.T_cam_world[0])
    for i in range(5):
        scratch = patch.make_scratch()
        arguments = (points.rho[i], NUMBERS, 0.2, points.colour[i], points.weight[i], 1.1, -3.0, ROBUST)
        energy, inside = patch_residual(image, T, *ray(points.uv[i]), *arguments, scratch)
        M_slow, e_slow, energy_slow = patch_terms(image, T, *ray(points.uv[i]), *arguments)
        assert inside
        assert energy == pytest.approx(energy_slow, rel=1e-4)
        np.testing.assert_allclose(np.triu(scratch.M), np.triu(M_slow), rtol=1e-3, atol=1e-2)
        np.testing.assert_allclose(scratch.e, e_slow, rtol=1e-3, atol=1e-2)


def test_a_patch_outside_behind_or_not_finite_is_not_inside() -> None:
    window = made_window()
    image, colours, scratch = window.images.left[0], window.points.colour[0], patch.make_scratch()

    def inside(T, x, y, rho):
        return patch_residual(image, T, x, y, rho, NUMBERS, 0.0, colours, colours, 1.0, 0.0, ROBUST, scratch)[1]

    behind, broken = np.eye(4), np.eye(4)
    behind[2, 3], broken[0, 3] = -20.0, np.nan
    assert inside(np.eye(4), 0.0, 0.0, 0.1)
    assert not inside(np.eye(4), 0.9, 0.0, 0.1)
    assert not inside(behind, 0.0, 0.0, 0.1)
    assert not inside(broken, 0.0, 0.0, 0.1)
    assert not inside(np.eye(4), 0.0, 0.0, np.nan)


def test_an_outlier_above_the_limit_has_no_sums() -> None:
    window = made_window()
    strict = ROBUST._replace(max_energy=50.0)
    colours = np.full(8, 250.0, np.float32)
    ones, scratch = np.ones(8, np.float32), patch.make_scratch()
    energy, inside = patch_residual(
        window.images.left[0], np.eye(4), 0.0, 0.0, 0.1, NUMBERS, 0.0, colours, ones, 1.0, 0.0, strict, scratch
    )
    assert inside
    assert energy > 400.0
    assert not scratch.M.any()


@pytest.mark.parametrize("right", [0.0, 1.0])
def test_the_projections_jacobian_is_the_numerical_one(right: float) -> None:
    T, x, y, rho, J = se3.exp(np.array([0.1, -0.2, 0.4, 0.02, -0.03, 0.01])), 0.3, -0.2, 0.15, np.zeros((2, 8))
    assert projection_jacobian(T, x, y, rho, NUMBERS, right, J)
    for k in range(6):
        xi = np.zeros(6)
        xi[k] = 1e-6
        plus, minus = (project(se3.exp(s * xi) @ T, x, y, rho, NUMBERS, right) for s in (1, -1))
        np.testing.assert_allclose(J[:, k], (plus - minus) / 2e-6, atol=1e-4)
    plus, minus = (project(T, x, y, rho, NUMBERS, right, d) for d in (1e-4, -1e-4))
    np.testing.assert_allclose(J[:, 6], (plus - minus) / 2e-4, atol=1e-6)
    plus, minus = (project(T, x, y, rho + d, NUMBERS, right) for d in (1e-6, -1e-6))
    np.testing.assert_allclose(J[:, 7], (plus - minus) / 2e-6, atol=1e-3)


def residuals(window: Window):
    """(point, target, right) of every residual: temporal ones left and right, and the host's own right image."""
    for i, h in enumerate(window.points.host):
        yield i, h, 1
        for t in range(len(window)):
            if t != h:
                yield i, t, 0
                yield i, t, 1


def naive_equations(window: Window):
    """Dense J^T W J and -J^T W r of (delta, 8 a keyframe, one a point) and the energy; derivatives of the geometry and the
    brightness by finite differences of the model itself."""
    F, N, p, frames = len(window), len(window.point_id), window.points, window.frames
    n = 1 + 8 * F + N
    H, g, total = np.zeros((n, n)), np.zeros(n), 0.0

    def model(z, i, t, right, pixel):
        h = p.host[i]
        T = [se3.exp(z[1 + 8 * f : 7 + 8 * f]) @ frames.T_cam_world[f] for f in range(F)]
        ab = frames.affine + z[1 : 1 + 8 * F].reshape(F, 8)[:, 6:]
        x, y = ray(p.uv[i] + pixel)
        uv = project(T[t] @ np.linalg.inv(T[h]), x, y, p.rho[i] + z[1 + 8 * F + i], NUMBERS, right, window.disparity_bias[0] + z[0])
        grey = p.colour[i][next(k for k in range(8) if (PATTERN[k] == pixel).all())]
        if t == h:
            gain, offset = frames.gain_right[h]
            return uv, gain * grey + offset
        predicted = np.exp(ab[t, 0] - ab[h, 0]) * (grey - ab[h, 1]) + ab[t, 1]
        gain, offset = frames.gain_right[t] if right else (1.0, 0.0)
        return uv, gain * predicted + offset

    for i, t, right in residuals(window):
        h = p.host[i]
        scale = 1.0 if not right else ROBUST.static_weight if t == h else ROBUST.observer_right_weight
        image = (window.images.right if right else window.images.left)[frames.slot[t]]
        d_uv, zero = np.zeros((2, n)), np.zeros(n)
        used = [0, 1 + 8 * F + i, *range(1 + 8 * h, 9 + 8 * h), *range(1 + 8 * t, 9 + 8 * t)]
        for k in used:
            step = np.zeros(n)
            step[k] = 1e-6
            d_uv[:, k] = (model(step, i, t, right, (0, 0))[0] - model(-step, i, t, right, (0, 0))[0]) / 2e-6
        own, own_H, own_g = scale * equations.OFFSET_INFORMATION, np.zeros(n), 0.0  # of the patch's own offset, in right images
        for pixel, weight in zip(PATTERN, p.weight[i], strict=True):
            uv, predicted = model(zero, i, t, right, pixel)
            value, gx, gy = sample(image, *uv)
            r = value - predicted
            huber = min(1.0, ROBUST.huber / max(abs(r), 1e-12))
            J = gx * d_uv[0] + gy * d_uv[1]
            for k in used:
                step = np.zeros(n)
                step[k] = 1e-5
                J[k] -= (model(step, i, t, right, pixel)[1] - model(-step, i, t, right, pixel)[1]) / 2e-5
            total += scale * weight * r * r * huber * (2 - huber)
            H += scale * weight * huber * np.outer(J, J)
            g -= scale * weight * huber * J * r
            own, own_H, own_g = own + scale * weight * huber, own_H - scale * weight * huber * J, own_g + scale * weight * huber * r
        if right:
            H, g, total = H - np.outer(own_H, own_H) / own, g - own_H * own_g / own, total - own_g**2 / own
    return H, g, total


def test_the_windows_normal_equations_are_those_of_the_dense_numerical_twin() -> None:
    window = made_window(points=2)
    F, N = len(window), len(window.point_id)
    n = 1 + 8 * F
    H_slow, g_slow, energy_slow = naive_equations(window)
    terms = adjustment.make_terms(N, F)
    energy = equations.linearise(window.images, NUMBERS, window.frames, window.points, window.disparity_bias[0], ROBUST, terms)
    assert energy == pytest.approx(energy_slow, rel=1e-4)
    np.testing.assert_allclose(terms.own[:, 0], np.diag(H_slow)[n:], rtol=2e-3)
    np.testing.assert_allclose(terms.own[:, 1], g_slow[n:], rtol=2e-3, atol=2e-4 * np.abs(g_slow[n:]).max())
    H, g, V, inverse, A = np.zeros((n, n)), np.zeros(n), np.zeros((N, n)), np.zeros(N), equations.host_maps(window.frames)
    adjustment.normal_equations(terms, A, window.points, 0.0, H, g, inverse)
    for i, host in enumerate(window.points.host):
        coupling_of_state(terms.coupling[i], terms.inlier[i], host, A, V[i])
    scale = np.sqrt(np.diag(H_slow)[n:])
    np.testing.assert_allclose(V.T / scale, H_slow[:n, n:] / scale, rtol=1e-2, atol=2e-3 * np.abs(H_slow[:n, n:] / scale).max())
    H_reduced, g_reduced = schur(H_slow, g_slow, n)
    unit = 1 / np.sqrt(np.diag(H_slow)[:n])
    np.testing.assert_allclose(H * np.outer(unit, unit), H_reduced * np.outer(unit, unit), atol=2e-3)
    np.testing.assert_allclose(g * unit, g_reduced * unit, atol=2e-3 * np.abs(g_slow[:n] * unit).max())


def test_a_points_step_follows_from_its_couplings_to_the_pairs_as_from_those_to_the_state() -> None:
    window = made_window()
    F, N = len(window), len(window.point_id)
    terms, A = adjustment.make_terms(N, F), equations.host_maps(window.frames)
    equations.linearise(window.images, NUMBERS, window.frames, window.points, window.disparity_bias[0], ROBUST, terms)
    x, row = np.random.default_rng(3).normal(size=1 + 8 * F), np.zeros(1 + 8 * F)
    local = equations.steps_of_pairs(A, x)
    for i, host in enumerate(window.points.host):
        coupling_of_state(terms.coupling[i], terms.inlier[i], host, A, row)
        np.testing.assert_allclose((terms.coupling[i] * local[host]).sum(), row @ x, rtol=1e-9)


def test_closed_residuals_count_for_nothing() -> None:
    window = made_window()
    window.points.closed[:] = 1
    window.points.has_static[:] = 0
    terms = adjustment.make_terms(len(window.point_id), len(window))
    assert equations.linearise(window.images, NUMBERS, window.frames, window.points, window.disparity_bias[0], ROBUST, terms) == 0.0
    assert not terms.own.any()
    assert not terms.inlier.any()


def test_adjustment_brings_a_disturbed_window_back_to_the_truth() -> None:
    truth, window = made_window(4, 60, disturbed=False), made_window(4, 60)
    window.frames.gain_right[:] = [1.0, 0.0]
    prior = np.zeros((33, 33)), np.zeros(33)
    prior[0][0, 0] = 300.0
    window.frames.T_cam_world[0] = truth.frames.T_cam_world[0]
    robust = ROBUST._replace(max_energy=500.0)
    before = window.points.rho / truth.points.rho - 1.0
    inlier, own, *_ = adjustment.adjust_window(
        window.images,
        NUMBERS,
        window.frames,
        window.points,
        NO_IMU,
        window.disparity_bias,
        *prior,
        np.array([1e3, 1.0]),
        1.0,
        0,
        np.zeros(2),
        robust,
        30,
        1e-4,
    )
    after = window.points.rho / truth.points.rho - 1.0
    way = np.linalg.norm(se3.inverse(window.frames.T_cam_world)[:, :3, 3] - se3.inverse(truth.frames.T_cam_world)[:, :3, 3], axis=1)
    assert way.max() < 0.02
    sure = own[:, 0] * truth.points.rho**2 > np.median(own[:, 0] * truth.points.rho**2)  # pixels of some gradient
    assert np.median(np.abs(after[sure])) < 0.75 * np.median(np.abs(before[sure]))
    assert window.disparity_bias[0] == pytest.approx(BIAS_PX, abs=0.1)
    assert np.abs(window.frames.affine[:, 0]).max() < 0.04
    assert inlier[:, -1].mean() > 0.9


def test_what_the_first_unknown_wants_is_the_dense_solution() -> None:
    rng = np.random.default_rng(5)
    root, g = rng.normal(size=(9, 9)), rng.normal(size=9)
    H, out = root @ root.T + np.eye(9), np.zeros(2)
    adjustment.first_alone(H, g, np.zeros(9), np.zeros(9), out)
    np.testing.assert_allclose(out, [np.linalg.solve(H, g)[0], np.linalg.inv(H)[0, 0]], rtol=1e-10)
    adjustment.first_alone(-H, g, np.zeros(9), np.zeros(9), out)
    assert np.isnan(out).all()


def test_a_bias_that_is_held_stays_and_says_which_step_it_would_take() -> None:
    held, free, wish = made_window(4, 60), made_window(4, 60), np.zeros(2)
    for window, hold in ((held, 1), (free, 0)):
        window.disparity_bias[0] = 0.0
        adjustment.adjust_window(
            window.images, NUMBERS, window.frames, window.points, NO_IMU, window.disparity_bias, np.zeros((33, 33)), np.zeros(33),
            np.array([1e3, 1.0]), 1.0, hold, wish, ROBUST, 1, 1e-4,
        )  # fmt: skip
    assert held.disparity_bias[0] == 0.0
    assert free.disparity_bias[0] == pytest.approx(wish[0], rel=1e-9)
    assert free.disparity_bias[0] > 0.1
    assert wish[1] > 0


def test_adjusting_again_never_raises_the_energy() -> None:
    window, energies = made_window(3, 20), []
    for _ in range(3):
        *_, energy = adjustment.adjust_window(
            window.images, NUMBERS, window.frames, window.points, NO_IMU, window.disparity_bias, np.zeros((25, 25)), np.zeros(25),
            np.array([1e3, 1.0]), 1.0, 0, np.zeros(2), ROBUST, 4, 1e-4,
        )  # fmt: skip
        energies.append(energy)
    assert energies == sorted(energies, reverse=True)


def test_observations_note_the_naive_energy_test_and_correlations() -> None:
    window = made_window(3, 20)
    strict, p, frames = ROBUST._replace(max_energy=70.0), window.points, window.frames
    p.rho[::3] *= 1.5
    N, out = len(window.point_id), np.zeros((len(window.point_id), 3), np.int64)
    everywhere, every = np.ones((N, 5), np.int64), np.ones(N, np.bool_)
    count = adjustment.observations(
        window.images, NUMBERS, frames, p, everywhere, every, np.array([2]), BIAS_PX, strict, out
    )  # fmt: skip
    assert count == N
    np.testing.assert_array_equal(out[:, :2], np.column_stack([np.arange(N), np.full(N, 2)]))
    for i, h in enumerate(p.host):
        T_left = frames.T_cam_world[2] @ np.linalg.inv(frames.T_cam_world[h])
        T = T_left.copy()
        T[:3, 3] += (NUMBERS.tx, NUMBERS.ty, NUMBERS.tz)
        gain, gain_right = np.exp(frames.affine[2, 0] - frames.affine[h, 0]), frames.gain_right[2, 0]
        offset = gain_right * (frames.affine[2, 1] - gain * frames.affine[h, 1]) + frames.gain_right[2, 1]
        seen = (*ray(p.uv[i]), p.rho[i], NUMBERS)
        in_left = patch_terms(window.images.left[2], T_left, *seen, 0.0, p.colour[i], p.weight[i], gain, 0.0, strict)
        in_right = patch_terms(
            window.images.right[2], T, *seen, BIAS_PX, p.colour[i], p.weight[i], gain * gain_right, offset, strict
        )  # fmt: skip
        right = in_right is not None and in_right[2] <= 560.0
        left_alike = in_left is not None and correlation(window.images.left[2], T_left, *seen, 0.0, p.colour[i]) >= LEAST_ALIKE
        right_alike = right and correlation(window.images.right[2], T, *seen, BIAS_PX, p.colour[i]) >= LEAST_ALIKE
        assert out[i, 2] == RIGHT * right + LEFT_ALIKE * left_alike + RIGHT_ALIKE * right_alike
    for bit in (RIGHT, LEFT_ALIKE, RIGHT_ALIKE):
        assert 0 < (out[:, 2] & bit > 0).sum() < N


def test_a_patch_of_little_contrast_fits_a_plain_wall_by_its_energy_and_does_not_look_like_it() -> None:
    scratch, colours = patch.make_scratch(), np.array([100, 104, 98, 103, 101, 97, 105, 99], np.float32)
    rng = np.random.default_rng(3)
    wall = rng.integers(98, 104, (40, 40)).astype(np.uint8)
    seen = np.full((40, 40), 100, np.uint8)
    for (dx, dy), colour in zip(PATTERN, colours, strict=True):
        seen[20 + dy, 20 + dx] = colour
    rig, weights = NUMBERS._replace(fx=30.0, fy=30.0, cx=20.0, cy=20.0), np.ones(8, np.float32)
    alike = []
    for image in (wall, seen):
        energy, inside = patch_residual(
            image, np.eye(4), 0.0, 0.0, 0.1, rig, 0.0, colours, weights, 1.0, 0.0, ROBUST._replace(max_energy=70.0), scratch
        )
        assert inside
        assert energy <= 70.0 * 8
        alike.append(bool(looks_alike(scratch.columns, LEAST_ALIKE)))
    assert alike == [False, True]


def test_the_deviation_is_the_left_perturbation_since_the_first_estimate() -> None:
    window = made_window()
    frames, xi = window.frames, np.array([0.01, -0.02, 0.03, 0.004, -0.005, 0.006])
    frames.has_first[1], frames.affine_first[1] = 1, frames.affine[1] - [0.1, 2.0]
    frames.T_first[1] = np.linalg.inv(se3.exp(xi)) @ frames.T_cam_world[1]
    z = np.ones(25)
    adjustment.deviation(frames, 0.7, NO_IMU, z)
    np.testing.assert_allclose(z[9:17], [*xi, 0.1, 2.0], atol=1e-12)
    assert z[0] == 0.7
    assert not z[1:9].any()
    assert not z[17:].any()


def test_prior_energy_and_its_equations_agree() -> None:
    rng = np.random.default_rng(0)
    H, g, z, affine, weight = (
        rng.normal(size=(17, 17)),
        rng.normal(size=17),
        rng.normal(size=17),
        rng.normal(size=(2, 2)),
        np.array([5.0, 2.0]),
    )
    H = H @ H.T
    expected = z @ H @ z - 2 * g @ z + (affine**2 @ weight).sum()
    assert adjustment.prior_energy(z, H, g, affine, weight) == pytest.approx(expected)
    H_out, g_out = np.zeros((17, 17)), np.zeros(17)
    adjustment.add_prior(z, H, g, affine, weight, H_out, g_out)
    for k in range(17):
        step = np.zeros(17)
        step[k] = 1e-6
        shifted = [affine + s * step[1:].reshape(2, 8)[:, 6:] for s in (1, -1)]
        plus, minus = (adjustment.prior_energy(z + s * step, H, g, a, weight) for s, a in zip((1, -1), shifted, strict=True))
        assert g_out[k] == pytest.approx(-0.5 * (plus - minus) / 2e-6, rel=1e-4, abs=1e-4)
