"""Priors of loops, cycles of closures, and sets that agree."""

from dataclasses import replace

import numpy as np
import pytest

from wayloom.geometry import se3
from wayloom.loops.consistency import consistent, neighbours
from wayloom.loops.priors import Closure, around, by_odometry, cycle_chi2, drift_covariance
from wayloom.loops.settings import LoopSettings

SETTINGS = LoopSettings()
COUNT = 40


def circle() -> tuple[np.ndarray, np.ndarray]:
    """(K, 4, 4) cameras twice around a circle of 40 steps, 4 m each, and the road (K,)."""
    T = [np.eye(4)]
    for _ in range(2 * COUNT - 1):
        T.append(T[-1] @ se3.exp(np.array([0.0, 0.0, 4.0, 0.0, 2 * np.pi / COUNT, 0.0])))
    return np.array(T), 4.0 * np.arange(2 * COUNT)


def true_closure(i: int, shift_m: float = 0.0) -> Closure:
    """Of keyframe i and the one a round later, moved along the road."""
    T = np.eye(4)
    T[2, 3] = shift_m
    return Closure(i, i + COUNT, T, np.diag([0.05**2] * 3 + [0.003**2] * 3))


def alias(i: int) -> Closure:
    """As `true_closure`, two steps further: aliases agree among themselves."""
    return replace(true_closure(i), second=i + COUNT + 2)


def test_the_prior_around_a_closure_is_the_product_of_the_ways() -> None:
    T, road = circle()
    prior = around(true_closure(4), T, road, (6, 5 + COUNT), SETTINGS)
    np.testing.assert_allclose(prior.T_a_b, se3.inverse(T[6]) @ T[5], atol=1e-9)


def test_the_prior_around_a_closure_is_surer_than_the_odometrys() -> None:
    T, road = circle()
    one, other = around(true_closure(4), T, road, (6, 6 + COUNT), SETTINGS), by_odometry(T, road, 6, 6 + COUNT, SETTINGS)
    assert np.trace(one.covariance[:3, :3]) < 0.1 * np.trace(other.covariance[:3, :3])


def test_the_drifts_covariance_is_that_of_an_error_at_the_far_end() -> None:
    """Errors of place and attitude drawn at the far end, moved to the left by the adjoint."""
    T = se3.exp(np.array([3.0, 1.0, 40.0, 0.0, 0.3, 0.0]))
    rng = np.random.default_rng(0)
    place = 0.05 + SETTINGS.drift_share * 50.0
    angle = np.deg2rad(0.2) + np.deg2rad(SETTINGS.drift_deg_per_sqrt_m) * np.sqrt(50.0)
    xi = []
    for _ in range(4000):
        moved = T.copy()
        moved[:3, :3] = se3.exp(np.concatenate([np.zeros(3), angle * rng.normal(size=3)]))[:3, :3] @ T[:3, :3]
        moved[:3, 3] += place * rng.normal(size=3)
        xi.append(se3.log(moved @ se3.inverse(T)))
    sampled = np.cov(np.array(xi).T)
    scale = np.sqrt(np.diag(drift_covariance(50.0, T, SETTINGS)))
    np.testing.assert_allclose(
        sampled / np.outer(scale, scale), drift_covariance(50.0, T, SETTINGS) / np.outer(scale, scale), atol=0.1
    )


def test_a_cycle_of_true_closures_closes_and_one_of_a_false_one_does_not() -> None:
    T, road = circle()
    assert cycle_chi2(true_closure(4), true_closure(7), T, road, SETTINGS) == pytest.approx(0.0, abs=1e-9)
    assert cycle_chi2(true_closure(4), true_closure(7, 2.0), T, road, SETTINGS) > SETTINGS.max_cycle_chi2


def test_the_cycle_is_the_same_from_either_closure() -> None:
    T, road = circle()
    one, other = true_closure(4), true_closure(7, 0.2)
    there, back = cycle_chi2(one, other, T, road, SETTINGS), cycle_chi2(other, one, T, road, SETTINGS)
    assert there == pytest.approx(back, rel=0.3)  # linearised at different ends of 12 m


def test_closures_that_agree_are_kept_and_the_odd_one_is_not() -> None:
    T, road = circle()
    closures = [true_closure(i) for i in (2, 4, 6, 8)] + [true_closure(5, 3.0)]
    np.testing.assert_array_equal(consistent(closures, T, road, SETTINGS), [True, True, True, True, False])


def test_two_are_no_set_and_one_far_away_is_no_neighbour() -> None:
    T, road = circle()
    closures = [true_closure(2), true_closure(4), true_closure(30)]
    assert not neighbours(closures, road, SETTINGS)[0, 2]
    assert not consistent(closures, T, road, SETTINGS).any()


def test_where_two_sets_deny_each_other_both_go() -> None:
    """Nothing tells which of them is the alias."""
    T, road = circle()
    closures = [true_closure(i) for i in (2, 4, 6)] + [alias(i) for i in (3, 5, 7)]
    assert not consistent(closures, T, road, SETTINGS).any()


def test_a_set_stands_against_one_of_less_than_half_its_size() -> None:
    T, road = circle()
    closures = [true_closure(i) for i in (1, 2, 3, 4, 5, 6, 7)] + [alias(i) for i in (3, 5, 7)]
    np.testing.assert_array_equal(consistent(closures, T, road, SETTINGS), [True] * 7 + [False] * 3)


def test_none_is_kept_of_none() -> None:
    T, road = circle()
    assert consistent([], T, road, SETTINGS).shape == (0,)


def test_one_closure_that_features_alone_know_stands_for_itself() -> None:
    T, road = circle()
    assert not consistent([true_closure(2)], T, road, SETTINGS).any()
    assert consistent([replace(true_closure(2), alone=True)], T, road, SETTINGS).all()


def test_it_does_not_where_the_odometry_denies_it_or_does_not_know_the_place() -> None:
    T, road = circle()
    assert not consistent([replace(true_closure(2, 8.0), alone=True)], T, road, SETTINGS).any()
    unsure = SETTINGS.model_copy(update={"max_prior_sigma_alone_m": 0.5})
    assert not consistent([replace(true_closure(2), alone=True)], T, road, unsure).any()


def test_it_goes_where_a_set_denies_it() -> None:
    T, road = circle()
    closures = [replace(true_closure(4, 3.0), alone=True)] + [true_closure(i) for i in (2, 4, 6)]
    np.testing.assert_array_equal(consistent(closures, T, road, SETTINGS), [False, True, True, True])
