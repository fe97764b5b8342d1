"""Registration of made street views: found with its pose and an honest covariance, or refused."""

import numpy as np
import pytest

from registration.made_streets import made_street, view_of
from wayloom.geometry import se3
from wayloom.places.types import PlaceView
from wayloom.registration.register import Prior, register
from wayloom.registration.search import level_pose
from wayloom.registration.settings import RegistrationSettings
from wayloom.registration.types import Registration

LEVEL_PRIOR = np.diag([1.5**2] * 2 + [0.3**2] + [np.deg2rad(1.0) ** 2] * 2 + [np.deg2rad(1.5) ** 2])

FALSE_PRIOR = np.diag([3.0**2] * 2 + [0.5**2] + [np.deg2rad(1.0) ** 2] * 2 + [np.deg2rad(2.0) ** 2])


def pair(seed: int, ahead_m: float, forward: bool = True, alike: bool = False) -> tuple[PlaceView, PlaceView, np.ndarray]:
    """Two views of one street, the second so far ahead of the first, with other noise and other points; and T_a_b."""
    street = made_street(seed, alike=alike)
    a, T_street_a = view_of(street, 90.0, seed)
    b, T_street_b = view_of(street, 90.0 + ahead_m, seed + 500, forward)
    return a, b, se3.inverse(T_street_a) @ T_street_b


def prior_near(T_a_b: np.ndarray, seed: int) -> Prior:
    """As uncertain as its covariance says."""
    xi = np.random.default_rng(seed).multivariate_normal(np.zeros(6), LEVEL_PRIOR)
    return Prior(se3.exp(xi) @ T_a_b, LEVEL_PRIOR)


def error_of(found: Registration, T_a_b: np.ndarray) -> tuple[float, float]:
    """Metres and degrees."""
    turned = se3.log(found.T_a_b @ se3.inverse(T_a_b))[3:]
    return float(np.linalg.norm(found.T_a_b[:3, 3] - T_a_b[:3, 3])), float(np.rad2deg(np.linalg.norm(turned)))


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_street_driven_again_is_found_without_a_prior(seed: int) -> None:
    a, b, T_a_b = pair(seed, 3.0)
    found = register(a, b)
    assert found.refused == ""
    metres, degrees = error_of(found, T_a_b)
    assert metres < 3.0 * found.evidence["sigma_m"]
    assert degrees < 0.3


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_street_driven_the_other_way_is_found_near_the_prior(seed: int) -> None:
    a, b, T_a_b = pair(seed, 2.0, forward=False)
    found = register(a, b, prior_near(T_a_b, seed))
    assert found.refused == ""
    metres, degrees = error_of(found, T_a_b)
    assert metres < 3.0 * found.evidence["sigma_m"]
    assert degrees < 0.5


def test_the_covariance_holds_the_error() -> None:
    """Chi-square with 6 degrees of freedom is under 22.5 in 999 of 1000 cases."""
    for seed in range(3):
        a, b, T_a_b = pair(seed, 2.0, forward=False)
        found = register(a, b, prior_near(T_a_b, seed))
        xi = se3.log(T_a_b @ se3.inverse(found.T_a_b))
        assert xi @ np.linalg.solve(found.covariance, xi) < 22.5


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_two_different_streets_are_refused_in_words_with_numbers(seed: int) -> None:
    a, _ = view_of(made_street(seed), 90.0, seed)
    b, _ = view_of(made_street(seed + 100), 90.0, seed)
    found = register(a, b)
    assert found.refused
    assert {"overlap", "through", "agreement", "score", "inliers", "sigma_m"} <= found.evidence.keys()


@pytest.mark.parametrize(("i", "j"), [(1, 5), (3, 5), (2, 6)])
def test_a_street_that_fits_as_any_street_does_is_refused_near_a_false_prior(i: int, j: int) -> None:
    """All other checks take these: the walls fit, but nothing that tells where along the street it is."""
    a, _ = view_of(made_street(i), 90.0, i)
    b, _ = view_of(made_street(j), 92.0, j + 500)
    prior = Prior(level_pose(0.0, 2.0, 0.0, 0.0), FALSE_PRIOR)
    assert "elsewhere along the street" in register(a, b, prior).refused
    anywhere = RegistrationSettings(min_distinctness=0.0, min_distinctness_same_way=0.0)
    assert not register(a, b, prior, anywhere).refused


def test_blocks_that_look_alike_are_told_apart_by_the_prior_alone() -> None:
    """One block further everything looks the same. Without a prior the alias is taken: one pair alone is no loop."""
    a, b, T_a_b = pair(7, 60.0, alike=True)
    assert register(a, b, prior_near(T_a_b, 1)).refused
    assert not register(a, b, None).refused


def test_a_prior_elsewhere_refuses_the_true_pose() -> None:
    a, b, T_a_b = pair(0, 3.0)
    shifted = T_a_b.copy()
    shifted[1, 3] += 25.0
    assert register(a, b, Prior(shifted, LEVEL_PRIOR)).refused


def test_a_few_metres_in_common_are_refused() -> None:
    a, b, T_a_b = pair(1, 52.0, forward=False)
    assert register(a, b, prior_near(T_a_b, 1)).refused


def test_a_view_without_points_is_refused() -> None:
    a, _ = view_of(made_street(0), 90.0, 0)
    empty, _ = view_of(made_street(0), 90.0, 0, count=20)
    assert "points" in register(a, empty).refused


def test_a_bare_corridor_slides_and_is_refused() -> None:
    """Two endless even walls: nothing says how far along."""
    rng = np.random.default_rng(2)
    a, _ = view_of(made_street(0), 90.0, 0)
    wall = np.column_stack([rng.choice([-7.0, 7.0], 2500), rng.uniform(-45, 45, 2500), rng.uniform(-1.6, 6, 2500)])
    camera = np.argmin(np.abs(a.cameras[None, :, 1] - (wall[:, None, 1] - 12.0)), axis=1).astype(np.int32)

    def corridor(seed: int) -> PlaceView:
        chosen = np.random.default_rng(seed)
        rows = chosen.permutation(2500)[:1800]
        noisy = wall[rows] + chosen.normal(0, 0.02, (1800, 3))
        return PlaceView(
            0, np.eye(4), noisy.astype(np.float32), np.full(1800, 2, np.uint8), np.full(1800, 0.2, np.float32), camera[rows],
            a.cameras, a.features, a.T_level_keyframe,
        )  # fmt: skip

    assert register(corridor(1), corridor(2), prior_near(np.eye(4), 3)).refused


def test_the_same_views_give_the_same_bits() -> None:
    a, b, T_a_b = pair(2, 2.0, forward=False)
    one, other = (register(a, b, prior_near(T_a_b, 2)) for _ in range(2))
    assert one.T_a_b.tobytes() == other.T_a_b.tobytes()
    assert one.covariance.tobytes() == other.covariance.tobytes()
    assert one.evidence == other.evidence
