"""Distinctness of a pose: how much better what stands in the street fits there than elsewhere along the street.

Any street with walls on both sides fits any other. Only edges of facades, poles and gaps tell where along it a view is, and
those fit at one place. The ground, which fits anywhere, has no say.
"""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.registration.kernels.fitting import fit_equations
from wayloom.registration.refinement import OUTLIER_DENSITY, STAGES
from wayloom.registration.scene import CELL_M, GROUND, Scene

FloatArray = NDArray[np.float64]
ELSEWHERE_M: Final = (-12.0, -9.0, -7.0, -5.0, -3.0, 3.0, 5.0, 7.0, 9.0, 12.0)
"""Shifts along the street: beyond the reach of a point's fit, and unevenly spaced, for facades repeat."""
MOST_POINTS: Final = 1500


def distinctness(a: Scene, b: Scene, T_a_b: FloatArray, covariance: FloatArray) -> float:
    """Mean log likelihood ratio of the points above the ground, less its mean elsewhere along the street; the worse of both ways.

    The street's direction is the level one in which the pose is known least: covariance (6, 6) of its left perturbation.
    """
    along = np.linalg.eigh(covariance[:2, :2])[1][:, 1]
    standing_a, standing_b = _standing(a), _standing(b)
    here = np.array(_fits(a, b, standing_a, standing_b, T_a_b))
    elsewhere = []
    for shift_m in ELSEWHERE_M:
        T = T_a_b.copy()
        T[:2, 3] += shift_m * along
        elsewhere.append(_fits(a, b, standing_a, standing_b, T))
    return float((here - np.mean(elsewhere, axis=0)).min())


def _standing(scene: Scene) -> tuple[Any, ...]:
    """The points above the ground as the fitting kernel takes them, at most MOST_POINTS, evenly chosen."""
    rows = np.flatnonzero(scene.group != GROUND)
    rows = rows[:: max(1, -(-len(rows) // MOST_POINTS))]
    return tuple(np.ascontiguousarray(array[rows]) for array in scene.points())


def _fits(a: Scene, b: Scene, standing_a: tuple[Any, ...], standing_b: tuple[Any, ...], T_a_b: FloatArray) -> tuple[float, float]:
    """Mean log likelihood ratio of b's points in a, and of a's in b."""
    reach_m, spread_m = min(STAGES[-1][0], CELL_M), STAGES[-1][1]
    out = []
    for fixed, moved, T in ((a, standing_b, T_a_b), (b, standing_a, se3.inverse(T_a_b))):
        _, _, cost, _ = fit_equations(fixed.points(), moved, fixed.cells.arrays(), T, reach_m, spread_m, OUTLIER_DENSITY)
        out.append(-cost / max(len(moved[0]), 1))
    return out[0], out[1]
