"""Class prior correction: against a naive twin, and what stays as it is."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_drive import even_images, still_drive, texture

from wayloom.labelling.class_prior import PRIOR_EPSILON, class_prior_correction, class_prior_factors
from wayloom.labelling.settings import LabellingSettings
from wayloom.labelling.tcl import label_points
from wayloom.labelling.types import SparseVotes

ALONE = LabellingSettings(votes="hard", spread=0.0, reach=0, ncc_power=0.0, class_prior_power=0.2)


def random_votes(seed: int, count: int = 30) -> SparseVotes:
    """Up to four classes a point; some points have none."""
    rng = np.random.default_rng(seed)
    of_each = [np.sort(rng.choice(19, rng.integers(0, 5), replace=False)).astype(np.uint8) for _ in range(count)]
    start = np.concatenate([[0], np.cumsum([len(c) for c in of_each])]).astype(np.int64)
    return SparseVotes(start, np.concatenate(of_each), rng.uniform(0.1, 2, start[-1]).astype(np.float32))


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000), power=st.floats(0.0, 1.0))
def test_corrected_votes_are_those_of_the_naive_twin(seed: int, power: float) -> None:
    votes = random_votes(seed)
    parts = [slice(votes.start[p], votes.start[p + 1]) for p in range(30)]
    shares = np.zeros(19)
    for part in parts:
        shares[votes.classes[part]] += votes.weights[part] / max(votes.weights[part].sum(), 1e-9)
    shares /= max(sum(part.stop > part.start for part in parts), 1)
    found = class_prior_correction(votes, class_prior_factors(votes, power))
    for part in parts:
        expected = votes.weights[part] * (shares[votes.classes[part]] + PRIOR_EPSILON) ** -power
        expected *= votes.weights[part].sum() / max(expected.sum(), 1e-9)
        np.testing.assert_allclose(found.weights[part], expected, rtol=1e-4)
    assert np.array_equal(found.classes, votes.classes)
    assert np.array_equal(found.start, votes.start)


def test_without_power_and_without_votes_all_stays_as_it_is() -> None:
    votes = random_votes(3)
    np.testing.assert_allclose(class_prior_correction(votes, class_prior_factors(votes, 0.0)).weights, votes.weights, rtol=1e-6)
    none = SparseVotes(np.zeros(4, np.int64), np.zeros(0, np.uint8), np.zeros(0, np.float32))
    assert len(class_prior_correction(none, class_prior_factors(none, 0.5)).weights) == 0


def contested() -> tuple:
    """100 points; one of them has two poles and three walls voting on it, all others walls alone."""
    drive, images = still_drive(points=100), even_images(3)
    images.smalls = [texture(0)] * 5
    uv = np.full((100, 2), 10, np.float32)
    uv[0] = 40, 30
    observers = np.array([0, 1, 3, 4], np.int32)
    points = replace(
        drive.points, uv_host=uv, obs_start=np.append(0, np.full(100, 4)), obs_keyframe=observers, obs_right=np.zeros(4, bool)
    )
    images.lefts = [image.copy() for image in images.lefts]
    for k in (0, 1):
        images.lefts[k][30, 40] = 5
    return replace(drive, points=points), images


def test_a_rare_class_wins_where_it_is_nearly_as_likely_and_the_network_was_not_balanced() -> None:
    drive, images = contested()
    images.is_balanced = False
    assert label_points(drive, images, ALONE).stereo.tolist() == [5] + [3] * 99
    assert label_points(drive, images, ALONE.model_copy(update={"class_prior_power": 0.0})).stereo[0] == 3
    images.is_balanced = True
    assert label_points(drive, images, ALONE).stereo[0] == 3


def test_the_sum_of_a_points_votes_stays_and_its_label_is_the_class_with_most() -> None:
    drive, images = contested()
    images.is_balanced = False
    found, plain = (
        label_points(drive, images, ALONE),
        label_points(drive, images, ALONE.model_copy(update={"class_prior_power": 0.0})),
    )
    assert found.vote_weight[: found.vote_start[1]].sum() == pytest.approx(plain.vote_weight[: plain.vote_start[1]].sum())
    first = slice(0, found.vote_start[1])
    assert found.stereo[0] == found.vote_class[first][found.vote_weight[first].argmax()]
