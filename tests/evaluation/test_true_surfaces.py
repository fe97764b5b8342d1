import numpy as np

from wayloom.evaluation.kernels.triangles import distance2
from wayloom.evaluation.true_surfaces import MOST_M, sorted_triangles


def brute(p, corners, steps=200):
    """The least distance to a fine sampling of the triangle, m."""
    i, j = np.mgrid[0 : steps + 1, 0 : steps + 1].reshape(2, -1)
    i, j = i[i + j <= steps] / steps, j[i + j <= steps] / steps
    samples = (1 - i - j)[:, None] * corners[0] + i[:, None] * corners[1] + j[:, None] * corners[2]
    return np.linalg.norm(samples - p, axis=1).min()


def test_the_distance_to_a_triangle_is_that_to_its_nearest_point():
    rng = np.random.default_rng(0)
    for _ in range(60):
        corners, p = rng.normal(size=(3, 3)), rng.normal(size=3) * 2.0
        assert abs(np.sqrt(distance2(p, *corners)) - brute(p, corners)) < 0.02


def test_a_flat_triangle_has_a_distance():
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])
    assert distance2(np.array([0.5, 1.0, 0]), *corners) == 1.0


def test_the_nearest_of_many_triangles_is_found_and_nothing_is_further_off_than_the_limit():
    rng = np.random.default_rng(1)
    corners = rng.uniform(-10, 10, (40, 1, 3)) + rng.normal(size=(40, 3, 3))
    points = rng.uniform(-14, 14, (200, 3))
    expected = [min(MOST_M, min(np.sqrt(distance2(p, *t)) for t in corners)) for p in points]
    assert np.allclose(sorted_triangles(corners).distance(points), expected)
