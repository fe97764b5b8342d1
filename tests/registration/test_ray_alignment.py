"""Alignment along rays of made views from both ends of a street."""

import numpy as np

from registration.made_streets import Street, view_of
from wayloom.config.classes import CLASS_ID
from wayloom.geometry import se3
from wayloom.registration.ray_alignment import REACH_M, SPREAD_M, aligned_along_rays, both_ways, ray_points
from wayloom.registration.refinement import refine
from wayloom.registration.scene import GROUND, Scene, prepare
from wayloom.registration.settings import RegistrationSettings

POINTS = 4000
SETTINGS = RegistrationSettings()


def street_of_walls(seed: int) -> Street:
    """Houses without gaps on both sides, each stepping back from the last: nothing else tells the place along the street."""
    rng = np.random.default_rng(seed)
    low, high = [], []
    for side in (-1.0, 1.0):
        y = 0.0
        while y < 240.0:
            width, front = rng.uniform(8.0, 16.0), rng.uniform(7.0, 9.0)
            near, far = sorted((side * front, side * (front + 8.0)))
            low.append([near, y, 0.0])
            high.append([far, y + width, 8.0])
            y += width
    return Street(np.array(low), np.array(high), np.full(len(low), CLASS_ID["building"], np.uint8))


def opposite_views(seed: int) -> tuple[Scene, Scene, np.ndarray]:
    """Prepared views from both ends and their true T_a_b."""
    street = street_of_walls(seed)
    (one, T_a), (other, T_b) = view_of(street, 120.0, seed, count=6000), view_of(street, 122.0, seed + 500, False, count=6000)
    return prepare(one, SETTINGS), prepare(other, SETTINGS), se3.inverse(T_a) @ T_b


def test_opposite_views_of_walls_pull_less_on_each_other_along_the_street() -> None:
    """The root mean square over four streets, from the true pose."""
    plain, rays = [], []
    for seed in range(4):
        a, b, T = opposite_views(seed)
        plain.append(refine(a, b, T, ((REACH_M, SPREAD_M, 15),), POINTS).T_a_b[1, 3] - T[1, 3])
        rays.append(aligned_along_rays(a, b, T, POINTS).T_a_b[1, 3] - T[1, 3])
    assert np.linalg.norm(rays) < 0.8 * np.linalg.norm(plain)


def test_which_view_comes_first_changes_nothing_but_the_way_round() -> None:
    a, b, T = opposite_views(0)
    points = ray_points(a, 400), ray_points(b, 400)
    H, g, cost = both_ways(a, b, *points, T)
    _, g_back, cost_back = both_ways(b, a, *points[::-1], se3.inverse(T))
    Ad = se3.adjoint(se3.inverse(T))
    # The weak prior of level frames says that b's up is a's, of either view in its own axes.
    np.testing.assert_allclose(cost_back, cost, rtol=1e-6)
    np.testing.assert_allclose(-Ad.T @ g_back, g, atol=1e-3 * np.sqrt(np.diag(H)).max())


def test_rays_graze_the_ground_and_are_not_followed_there() -> None:
    a, _, _ = opposite_views(0)
    half_m = ray_points(a, POINTS).half_m
    ground = a.group[:: max(1, -(-len(a) // POINTS))] == GROUND
    assert ground.any()
    assert (half_m[ground] == 0.0).all()
    assert (half_m[~ground] >= 0.4).all()
