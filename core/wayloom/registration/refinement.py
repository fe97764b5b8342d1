"""Refinement of a pose: points on surfaces, coarse to fine."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.registration.kernels.fitting import fit_equations
from wayloom.registration.scene import CELL_M, GROUND, Scene

FloatArray = NDArray[np.float64]
STAGES: Final = ((1.5, 1.0, 8), (1.5, 0.4, 8), (1.2, 0.15, 10))
"""Reach in m, added spread in m, most steps."""
OUTLIER_DENSITY: Final = 2.0
"""Of points that belong to nothing, 1/m^3 times (2 pi)^1.5."""
TILT_SIGMA_RAD: Final = np.deg2rad(2.0)
"""How level two level frames are to each other."""
CONVERGED: Final = 1e-4
GROUND_RADIUS_M: Final = 15.0


@dataclass(frozen=True, slots=True)
class Fit:
    """T_a_b (4, 4); H (6, 6) and g (6,) of the left perturbation; score, the mean over b's points of the log
    likelihood ratio against clutter; weight, how many of them fit."""

    T_a_b: FloatArray
    H: FloatArray
    g: FloatArray
    score: float
    weight: float


def refine(a: Scene, b: Scene, T_a_b: FloatArray, stages: tuple[tuple[float, float, int], ...] = STAGES, most: int = 10**9) -> Fit:
    """Gauss-Newton on the expected assignment, stage by stage.

    most : points of b that take part, evenly chosen
    """
    step = max(1, -(-len(b) // most))
    points_b = tuple(np.ascontiguousarray(array[::step]) for array in b.points())
    T = T_a_b
    for reach, spread, steps in stages:
        for step in range(steps + 1):
            H, g, cost, weight = fit_equations(
                a.points(), points_b, a.cells.arrays(), T, min(reach, CELL_M), spread, OUTLIER_DENSITY
            )
            tilt_H, tilt_g = level_prior(T)
            xi = np.linalg.solve(H + tilt_H + 1e-6 * np.eye(6), g + tilt_g)
            if step == steps or np.abs(xi).max() < CONVERGED:
                break
            T = se3.exp(xi) @ T
    return Fit(T, H, g, -cost / max(len(points_b[0]), 1), weight)


def level_prior(T: FloatArray) -> tuple[FloatArray, FloatArray]:
    """H (6, 6) and g (6,) of b's up being a's up: R e_z = e_z in x and y, where d(R e_z) = omega x R e_z."""
    J = np.zeros((2, 6))
    J[:, 3:] = -se3.hat(T[:3, 2])[:2]
    weight = 1.0 / TILT_SIGMA_RAD**2
    return weight * J.T @ J, -weight * J.T @ T[:2, 2]


def with_height(a: Scene, b: Scene, T_a_b: FloatArray) -> FloatArray:
    """The pose with the height at which the ground below both cameras agrees; unchanged where one sees none."""
    heights = [float(np.median(z)) for z in (_ground_heights(a, T_a_b[:2, 3]), _ground_heights(b, np.zeros(2))) if len(z)]
    if len(heights) < 2:
        return T_a_b
    out = T_a_b.copy()
    out[2, 3] = heights[0] - heights[1]
    return out


def _ground_heights(scene: Scene, centre: FloatArray) -> FloatArray:
    near = np.linalg.norm(scene.xyz[:, :2] - centre, axis=1) < GROUND_RADIUS_M
    return np.asarray(scene.xyz[near & (scene.group == GROUND), 2])
