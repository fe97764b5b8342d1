"""Preintegration and the IMU's residuals: against an ideal IMU on a known motion, finite differences and random draws."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from odometry import made_motion
from wayloom.geometry import se3
from wayloom.odometry.kernels import inertial as kernel
from wayloom.odometry.kernels import preintegration
from wayloom.odometry.kernels.arrays import Frames
from wayloom.odometry.kernels.compiler import opened
from wayloom.odometry.kernels.inertial import Inertial

pytestmark = pytest.mark.kernels

F64 = NDArray[np.float64]
DENSITY = np.array([1e-3, 1e-2])
TIMES = (1.0, 1.4, 2.1)


def preintegrated(t: F64, force: F64, rate: F64, start: float, stop: float, bias: F64) -> tuple[F64, ...]:
    out = (np.zeros((3, 3)), np.zeros(3), np.zeros(3), np.zeros((9, 6)), np.zeros((9, 9)))
    preintegration.preintegrate(t, force, rate, start, stop, bias, DENSITY, *out)
    return out


def ideal_samples(bias: F64 | None = None) -> tuple[F64, F64, F64]:
    t = np.arange(0.0, 4.0, 0.005)
    force, rate = made_motion.samples(t)
    shift = np.zeros(6) if bias is None else bias
    return t, force + shift[3:], rate + shift[:3]


def made_inertial(bias: F64) -> tuple[Frames, Inertial]:
    """Three keyframes on the made motion with perfect states and links from an IMU of that bias."""
    t, force, rate = ideal_samples(bias)
    F = len(TIMES)
    links = [preintegrated(t, force, rate, a, b, bias) for a, b in pairwise(TIMES)]
    links.append((np.eye(3), np.zeros(3), np.zeros(3), np.zeros((9, 6)), np.eye(9)))
    R, v, p, J, C = (np.array(column) for column in zip(*links, strict=True))
    n = made_motion.GRAVITY / np.linalg.norm(made_motion.GRAVITY)
    basis = np.column_stack([n, np.cross(n, [1.0, 0, 0]), np.cross(n, np.cross(n, [1.0, 0, 0]))])
    T = se3.inverse(made_motion.pose(np.array(TIMES)) @ se3.inverse(made_motion.T_CAM_IMU))
    velocity = made_motion.velocity(np.array(TIMES))
    information = np.array([kernel.inverse_covariance(c) for c in C])
    inertial = Inertial(
        velocity, velocity.copy(), np.tile(bias, (F, 1)), np.tile(bias, (F, 1)), np.zeros(2), basis, made_motion.T_CAM_IMU,
        np.array([1, 1, 0]), np.append(np.diff(TIMES), 0.0), R, v, p, J, information, np.tile(bias, (F, 1)),
        np.array([1e8, 1e6]), 3.0,
    )  # fmt: skip
    frames = Frames(np.arange(F), T, T.copy(), np.zeros(F, np.int64), np.zeros((F, 2)), np.zeros((F, 2)), np.zeros((F, 2)))
    return frames, inertial


def moved(frames: Frames, inertial: Inertial, x: F64) -> tuple[Frames, Inertial]:
    """The state after a step x (1 + 17F + 2)."""
    F = len(frames.slot)
    visual, own = x[1 : 1 + 8 * F].reshape(F, 8), x[1 + 8 * F : 1 + 17 * F].reshape(F, 9)
    T = se3.exp(visual[:, :6]) @ frames.T_cam_world
    return frames._replace(T_cam_world=T), inertial._replace(
        velocity=inertial.velocity + own[:, :3], bias=inertial.bias + own[:, 3:], gamma=inertial.gamma + x[-2:]
    )


link_residual, link_jacobian = opened(kernel.link_residual), opened(kernel.link_jacobian)


def jacobian(frames: Frames, inertial: Inertial, f: int) -> F64:
    """(15, 32) of link f."""
    link, r, J = kernel.make_link_space(), np.zeros(15), np.zeros((15, 32))
    link_residual(inertial, frames.T_cam_world[f], frames.T_cam_world[f + 1], f, link, r)
    link_jacobian(inertial, f, link, r, J)
    return J


def residuals(frames: Frames, inertial: Inertial) -> F64:
    out = np.zeros((2, 15))
    for f in range(2):
        link_residual(inertial, frames.T_cam_world[f], frames.T_cam_world[f + 1], f, kernel.make_link_space(), out[f])
    return out


BIAS = np.array([0.01, -0.02, 0.015, 0.1, -0.2, 0.05])


def test_ideal_samples_integrate_to_the_motion() -> None:
    t, force, rate = ideal_samples()
    start, stop = 1.003, 2.498
    R, v, p, _, _ = preintegrated(t, force, rate, start, stop, np.zeros(6))
    T, speed = made_motion.pose(np.array([start, stop])), made_motion.velocity(np.array([start, stop]))
    predicted, after = preintegration.predict(T[0], speed[0], made_motion.GRAVITY, stop - start, R, v, p)
    turn = se3.log(se3.inverse(T[1]) @ predicted)
    assert np.linalg.norm(turn[3:]) < 2e-5  # the midpoint rule at 200 Hz
    assert np.linalg.norm(predicted[:3, 3] - T[1, :3, 3]) < 5e-4
    assert np.linalg.norm(after - speed[1]) < 5e-4


def test_the_motion_changes_with_the_bias_as_its_derivative_says() -> None:
    t, force, rate = ideal_samples()
    R, _, _, J, _ = preintegrated(t, force, rate, 1.0, 2.0, np.zeros(6))
    for k in range(6):
        d = np.zeros(6)
        d[k] = 1e-4
        ahead, back = preintegrated(t, force, rate, 1.0, 2.0, d), preintegrated(t, force, rate, 1.0, 2.0, -d)
        turn = preintegration.log_so3(R.T @ ahead[0]) - preintegration.log_so3(R.T @ back[0])
        change = np.concatenate([turn, ahead[1] - back[1], ahead[2] - back[2]])
        np.testing.assert_allclose(change / 2e-4, J[:, k], atol=1e-6)


@pytest.mark.compiled
def test_the_covariance_is_that_of_noisy_samples() -> None:
    t, force, rate = ideal_samples()
    R, v, p, _, C = preintegrated(t, force, rate, 1.0, 2.0, np.zeros(6))
    rng, draws = np.random.default_rng(4), []
    for _ in range(600):
        noise = rng.normal(size=(2, len(t), 3)) / np.sqrt(0.005)
        Rd, vd, pd, _, _ = preintegrated(t, force + DENSITY[1] * noise[0], rate + DENSITY[0] * noise[1], 1.0, 2.0, np.zeros(6))
        draws.append(np.concatenate([preintegration.log_so3(R.T @ Rd), vd - v, pd - p]))
    # interpolation halves the noise within a step and ties neighbours: over 200 steps the sum is the same
    share = np.sqrt(np.diag(np.cov(np.array(draws).T)) / np.diag(C))
    np.testing.assert_allclose(share, 1.0, atol=4 / np.sqrt(2 * 600))


def test_residuals_vanish_at_the_truth() -> None:
    frames, inertial = made_inertial(BIAS)
    assert np.abs(residuals(frames, inertial)).max() < 5e-4


@pytest.mark.parametrize("moved_first", [False, True])
def test_jacobians_agree_with_finite_differences(moved_first: bool) -> None:
    frames, inertial = made_inertial(BIAS)
    rng, n = np.random.default_rng(1), 1 + 17 * 3 + 2
    if moved_first:  # away from the truth, where residuals are not small and the bias is not the one of the preintegration
        frames, inertial = moved(frames, inertial, rng.normal(size=n) * 0.02)
    for f in range(2):
        J = jacobian(frames, inertial, f)
        index = link_unknowns(f)
        for column, k in enumerate(index):
            x = np.zeros(n)
            x[k] = 1e-5
            ahead, back = residuals(*moved(frames, inertial, x))[f], residuals(*moved(frames, inertial, -x))[f]
            np.testing.assert_allclose((ahead - back) / 2e-5, J[:, column], atol=2e-6, err_msg=f"unknown {k}")


def link_unknowns(f: int, F: int = 3) -> list[int]:
    pair = [[*range(1 + 8 * g, 7 + 8 * g), *range(1 + 8 * F + 9 * g, 10 + 8 * F + 9 * g)] for g in (f, f + 1)]
    return [*pair[0], *pair[1], 1 + 17 * F, 2 + 17 * F]


def test_normal_equations_are_those_of_a_dense_twin() -> None:
    frames, inertial = made_inertial(BIAS)
    frames, inertial = moved(frames, inertial, np.random.default_rng(2).normal(size=54) * 0.01)
    H, g = np.zeros((54, 54)), np.zeros(54)
    energy = kernel.add_links(frames, inertial, H, g)
    dense: dict[str, Any] = {"H": np.zeros((54, 54)), "g": np.zeros(54), "energy": 0.0}
    for f in range(2):
        J, W, r = jacobian(frames, inertial, f), np.zeros((15, 15)), residuals(frames, inertial)[f]
        W[:9, :9] = 3.0 * inertial.information[f]
        W[9:, 9:] = 3.0 * np.diag([1e8] * 3 + [1e6] * 3) / inertial.duration[f]
        wide = np.zeros((15, 54))
        wide[:, link_unknowns(f)] = J
        dense["H"] += wide.T @ W @ wide
        dense["g"] -= wide.T @ W @ r
        dense["energy"] += r @ W @ r
    np.testing.assert_allclose(H, dense["H"], rtol=1e-9, atol=1e-6 * np.abs(H).max())
    np.testing.assert_allclose(g, dense["g"], rtol=1e-9, atol=1e-9 * np.abs(g).max())
    assert energy == pytest.approx(dense["energy"], rel=1e-9)
    assert kernel.links_energy(frames, inertial) == pytest.approx(energy, rel=1e-12)
