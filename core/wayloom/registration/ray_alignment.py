"""Maximum likelihood alignment of two views by where the points of each lie along their rays on the other's surfaces."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.registration.kernels.ray_fitting import ray_equations
from wayloom.registration.refinement import OUTLIER_DENSITY, TILT_SIGMA_RAD, level_prior
from wayloom.registration.scene import GROUND, Scene

FloatArray = NDArray[np.float64]
REACH_M: Final = 0.8
SPREAD_M: Final = 0.05
OFFSETS: Final = np.linspace(-1.0, 1.0, 13)
RAY_SIGMAS: Final = 2.5
"""A ray is looked at so many sigmas before and behind its point, within RAY_M."""
RAY_M: Final = (0.4, 2.0)
SURFACE_SIGMA_M: Final = 0.15
"""What the other view's surfaces add to the sigma of a point along its ray."""
STEPS: Final = 15
LONGEST_STEP_M: Final = 0.3
CONVERGED: Final = 2e-4
LEAST_DAMPING, MOST_DAMPING = 0.1, 1e4


@dataclass(frozen=True, slots=True)
class RayFit:
    """T_a_b (4, 4) and the information (6, 6) of its left perturbation, from the points of both views."""

    T_a_b: FloatArray
    H: FloatArray


@dataclass(frozen=True, slots=True)
class RayPoints:
    """Points of a view as the kernel takes them: xyz, group and surface; rays (N, 3); half_m (N,)."""

    points: tuple[FloatArray, NDArray[np.int8], FloatArray]
    rays: FloatArray
    half_m: FloatArray


def aligned_along_rays(a: Scene, b: Scene, T_a_b: FloatArray, most: int) -> RayFit:
    """Fisher scoring from T_a_b (4, 4), damped where the likelihood falls; most: points of each view, evenly chosen."""
    points_a, points_b = ray_points(a, most), ray_points(b, most)
    T, damping = T_a_b, 1.0
    H, g, cost = both_ways(a, b, points_a, points_b, T)
    for _ in range(STEPS):
        xi = np.linalg.solve(damping * H + 1e-6 * np.eye(6), g)
        xi *= min(1.0, LONGEST_STEP_M / max(float(np.abs(xi[:3]).max()), 1e-12))
        T_next = se3.exp(np.asarray(xi, np.float64)) @ T
        H_next, g_next, cost_next = both_ways(a, b, points_a, points_b, T_next)
        if cost_next > cost:
            damping *= 4.0
            if damping > MOST_DAMPING:
                break
            continue
        T, H, g, cost, damping = T_next, H_next, g_next, cost_next, max(damping / 3.0, LEAST_DAMPING)
        if np.abs(xi).max() < CONVERGED:
            break
    return RayFit(T, H)


def ray_points(scene: Scene, most: int) -> RayPoints:
    """Evenly chosen points. Of the ground, which rays graze, the plain density counts: it is even, and what it says is a height."""
    step = max(1, -(-len(scene) // most))
    xyz, group, surface = (np.ascontiguousarray(array[::step]) for array in scene.points())
    half_m = np.clip(RAY_SIGMAS * np.hypot(scene.sigma_m[::step], SURFACE_SIGMA_M), *RAY_M)
    return RayPoints(
        (xyz, group, surface), np.ascontiguousarray(scene.rays[::step]), np.where(group == GROUND, 0.0, half_m)
    )  # fmt: skip


def both_ways(
    a: Scene, b: Scene, points_a: RayPoints, points_b: RayPoints, T_a_b: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    """H (6, 6), g (6,) and cost of b's points on a's surfaces, of a's on b's, and of level frames.

    A left perturbation xi of T_a_b is -Ad(T_b_a) xi of T_b_a.
    """
    T_b_a = se3.inverse(T_a_b)
    H, g, cost = one_way(a, points_b, T_a_b)
    H_back, g_back, cost_back = one_way(b, points_a, T_b_a)
    Ad = se3.adjoint(T_b_a)
    tilt_H, tilt_g = level_prior(T_a_b)
    tilt = 0.5 * float(T_a_b[:2, 2] @ T_a_b[:2, 2]) / TILT_SIGMA_RAD**2
    return H + Ad.T @ H_back @ Ad + tilt_H, g - Ad.T @ g_back + tilt_g, cost + cost_back + tilt


def one_way(a: Scene, b: RayPoints, T_a_b: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """H (6, 6), g (6,) and cost of b's points on a's surfaces."""
    H, g, cost = ray_equations(
        a.points(), b.points, b.rays, b.half_m, OFFSETS, a.cells.arrays(), T_a_b, REACH_M, SPREAD_M, OUTLIER_DENSITY
    )
    return H, g, float(cost)
