"""Fine alignment of two views by surfaces, where no local features tell more: nearer points, and things that both sides share.

The two sides of a tree's crown are not one surface: a drive sees the side that faces it. Views from other directions are therefore
aligned without vegetation, at last by where their points lie along their rays, and without local features, which match by chance
there.
"""

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.registration.ray_alignment import RayFit, aligned_along_rays
from wayloom.registration.refinement import Fit, refine
from wayloom.registration.register import FINE_POINTS, covariance_of, yaw_of
from wayloom.registration.scene import VEGETATION, Scene, cells_of
from wayloom.registration.settings import RegistrationSettings
from wayloom.registration.types import Registration

FloatArray = NDArray[np.float64]
STAGES: Final = ((1.2, 0.15, 6), (0.8, 0.05, 8))
"""Reach in m, added spread in m, most steps."""
POINTS: Final = 4000
SAME_SIDE_RAD: Final = float(np.deg2rad(60.0))
"""Views that differ less see the same sides of things."""
MOST_SIGMAS2: Final = 22.5
"""Chi-square, 6 degrees of freedom, 999 of 1000: a pose that moves further than its covariance allows is left as it was."""


def finely_aligned(a: Scene, b: Scene, found: Registration, settings: RegistrationSettings) -> Registration:
    """The registration with a finer pose and its covariance; unchanged where features know it, or where it would move too far."""
    other_sides = abs(yaw_of(found.T_a_b)) > SAME_SIDE_RAD
    if other_sides:
        a, b = without_vegetation(a), without_vegetation(b)
    elif found.evidence["inliers"] >= settings.min_matches:
        return found
    if min(len(a), len(b)) < settings.min_points:
        return found
    fit: Fit | RayFit = refine(a, b, found.T_a_b, STAGES, POINTS)
    if other_sides:
        fit = aligned_along_rays(a, b, fit.T_a_b, POINTS)
    moved = se3.log(fit.T_a_b @ se3.inverse(found.T_a_b))
    if moved @ np.linalg.solve(found.covariance, moved) > MOST_SIGMAS2:
        return found
    # The covariance counts on FINE_POINTS points that share their errors; more of them know no more.
    taken = len(b) / max(1, -(-len(b) // POINTS))
    H = fit.H * min(1.0, FINE_POINTS / max(taken, 1.0))
    return replace(found, T_a_b=fit.T_a_b, covariance=covariance_of(fit.T_a_b, H, np.zeros((6, 6))))


def without_vegetation(scene: Scene) -> Scene:
    """The scene's points of other groups; its voxels stay."""
    rows = np.flatnonzero(scene.group != VEGETATION)
    xyz = np.ascontiguousarray(scene.xyz[rows])
    surface = np.ascontiguousarray(scene.surface[rows])
    return replace(
        scene,
        xyz=xyz,
        group=scene.group[rows],
        surface=surface,
        sigma_m=scene.sigma_m[rows],
        rays=scene.rays[rows],
        cells=cells_of(xyz),
    )
