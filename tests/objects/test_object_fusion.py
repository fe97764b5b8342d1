"""Fusion of sightings: order of arrival, doubles, drives that looked and saw nothing, covariance."""

import itertools
from dataclasses import astuple

import numpy as np
import pytest

from objects.made_sightings import of_drives, placed, some_sightings
from wayloom.geometry import se3
from wayloom.objects.fusion import fuse, robust_mean
from wayloom.objects.settings import ObjectFusionSettings
from wayloom.objects.types import LIGHT, POLE, SIGN, TRUNK, MapObject


def told(objects: list[MapObject]) -> list[tuple[object, ...]]:
    """The objects' values, arrays as bytes."""
    return [tuple(v.tobytes() if isinstance(v, np.ndarray) else v for v in astuple(one)) for one in objects]


def scattered(count: int, seed: int = 1) -> np.ndarray:
    """(count, 3) places at least 3 m apart."""
    grid = np.array(list(itertools.product(range(-5, 6), range(-5, 6))), float)
    rng = np.random.default_rng(seed)
    return np.column_stack([3.5 * rng.permutation(grid)[:count] + rng.uniform(-0.2, 0.2, (count, 2)), rng.uniform(0, 1, count)])


def test_every_order_of_arrival_gives_the_same_bits() -> None:
    sightings = of_drives(scattered(20), 4, 0.05)
    first = told(fuse(sightings))
    assert len(first) == 20
    for order in itertools.permutations(range(4)):
        assert told(fuse([sightings[k] for k in order])) == first


def test_sightings_that_come_twice_count_once() -> None:
    sightings = of_drives(scattered(5), 2, 0.05)
    assert told(fuse([*sightings, *sightings])) == told(fuse(sightings))


def test_nothing_gives_nothing() -> None:
    assert fuse([]) == []
    assert fuse([placed(some_sightings(np.zeros((0, 3))), "a")]) == []


def test_errors_are_what_the_covariance_tells() -> None:
    points = scattered(100)
    found = np.array([one.position for one in fuse(of_drives(points, 3, 0.06))])
    sigma2 = np.array([one.covariance[0, 0] for one in fuse(of_drives(points, 3, 0.06))])
    gap = np.linalg.norm(found[:, None] - points[None], axis=2)
    errors = found - points[gap.argmin(axis=1)]
    assert len(found) == 100
    # 300 numbers of mean square 1: their mean lies within 1 +- 3 sqrt(2 / 300)
    assert np.mean(errors**2 / sigma2[:, None]) == pytest.approx(1.0, abs=0.3)


def test_what_is_common_to_a_drives_place_does_not_average_away_within_the_drive() -> None:
    place = np.diag([0.25, 0.25, 0.25, 0.0, 0.0, 0.0])
    parts = [placed(some_sightings([[1.0, 2.0, 0.0]], name=str(k)), "a", covariance=place) for k in range(5)]
    (one,) = fuse(parts)
    assert one.covariance[0, 0] == pytest.approx(0.25, rel=0.02)
    assert one.drives == ("a",)
    assert one.looks == 25


def test_drives_that_looked_and_saw_nothing_take_an_object_out() -> None:
    saw = placed(some_sightings([[1.0, 2.0, 0.0]], evidence=2.0), "a")
    passed = [placed(some_sightings(np.zeros((0, 3)), name=str(k)), f"b{k}") for k in range(3)]
    elsewhere = [placed(some_sightings(np.zeros((0, 3)), looked=0, name=str(k)), f"c{k}") for k in range(2)]
    (alone,) = fuse([saw])
    (with_one,) = fuse([saw, passed[0]])
    assert with_one.confidence < alone.confidence
    assert fuse([saw, *passed]) == []
    assert fuse([saw, *elsewhere])[0].confidence == alone.confidence


def test_views_against_it_lower_the_confidence() -> None:
    sure, doubted = (fuse([placed(some_sightings([[0.0, 0.0, 0.0]], against=a), "a")])[0].confidence for a in (0.0, 1.0))
    assert sure == pytest.approx(1.0 / (1.0 + np.exp(-2.0)), abs=1e-6)
    assert doubted == pytest.approx(1.0 / (1.0 + np.exp(-1.0)), abs=1e-6)


def test_a_sign_and_the_pole_that_carries_it_are_two_objects() -> None:
    both = some_sightings([[0.0, 0.0, 0.0], [0.05, 0.0, 2.4]], kind=[POLE, SIGN])
    assert [one.kind for one in fuse([placed(both, "a"), placed(both, "b")])] == ["pole", "traffic_sign"]


def test_a_thing_that_is_taken_for_two_kinds_is_the_likelier_one() -> None:
    both = [some_sightings([[0.0, 0.0, 0.0]], kind=kind, evidence=e) for kind, e in ((POLE, 1.0), (TRUNK, 2.0))]
    (one,) = fuse([placed(part, f"d{k}") for k, part in enumerate(both)])
    assert one.kind == "trunk"


def test_signs_one_above_the_other_stay_two() -> None:
    found = fuse([placed(some_sightings([[0.0, 0.0, 1.8], [0.0, 0.0, 2.6]], kind=SIGN), "a")])
    assert len(found) == 2
    assert len({one.id for one in found}) == 2


def test_lights_seen_half_a_metre_apart_by_unsure_drives_are_one() -> None:
    parts = [placed(some_sightings([[x, 0.0, 3.0]], kind=LIGHT, sigma=0.2), f"d{x}") for x in (0.0, 0.5)]
    (one,) = fuse(parts)
    assert one.position[0] == pytest.approx(0.25, abs=1e-6)
    assert one.drives == ("d0.0", "d0.5")


def test_two_poles_of_one_submap_that_stand_apart_are_two() -> None:
    sightings = some_sightings([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0]], sigma=0.3)
    assert len(fuse([placed(sightings, "a")])) == 2


def test_a_sign_faces_where_most_drives_saw_its_face() -> None:
    parts = [placed(some_sightings([[0.0, 0.0, 2.0]], kind=SIGN, facing=f, name=str(f)), str(f)) for f in
             ([0.0, -1.0, 0.0], [0.1, -1.0, 0.0], [0.0, 1.0, 0.0])]  # fmt: skip
    (one,) = fuse(parts)
    assert one.facing_rad == pytest.approx(np.pi - 0.033, abs=0.01)
    assert one.facing_sigma_rad is not None
    assert 0.02 <= one.facing_sigma_rad < 0.1


def test_ids_stay_when_another_drive_moves_an_object_a_little() -> None:
    before = fuse([placed(some_sightings([[0.1, 0.1, 0.1]]), "a")])
    after = fuse([placed(some_sightings([[x, 0.1, 0.1]]), f"d{x}") for x in (0.1, 0.12)])
    assert before[0].id == after[0].id


def test_a_map_with_a_turned_submap_has_turned_covariances() -> None:
    T = se3.exp(np.array([10.0, 0.0, 0.0, 0.0, 0.0, np.pi / 2]))
    sightings = some_sightings([[0.0, 5.0, 0.0]])
    sightings.covariance[0] = np.diag([0.01, 0.0004, 0.0001]).astype(np.float32)
    (one,) = fuse([placed(sightings, "a", T)])
    np.testing.assert_allclose(np.diag(one.covariance), [0.0004, 0.01, 0.0001], rtol=0.02)


def test_a_mean_of_places_that_contradict_each_other_is_unsure() -> None:
    covariances = np.tile(0.0001 * np.eye(3), (2, 1, 1))
    near, far = (robust_mean(np.array([[0.0, 0, 0], [x, 0, 0]]), covariances)[1][0, 0] for x in (0.01, 0.2))
    assert near == pytest.approx(0.00005, rel=0.2)
    assert far > 0.0002


def test_a_confidence_below_the_least_is_left_out() -> None:
    weak = placed(some_sightings([[0.0, 0.0, 0.0]], evidence=0.5), "a")
    assert fuse([weak], ObjectFusionSettings(least_confidence=0.7)) == []
    assert len(fuse([weak], ObjectFusionSettings(least_confidence=0.6))) == 1
