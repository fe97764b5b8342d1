"""Smoothing of votes over neighbours in space: against a slow, obvious twin, and its invariants."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_drive import even_images, made_drive, random_images, still_drive, texture

from wayloom.labelling.neighbours import MAX_NEIGHBOURS, OWN_WEIGHT, Neighbours, NeighbourSearch, nearest, smoothed, smoothed_labels
from wayloom.labelling.settings import LabellingSettings
from wayloom.labelling.tcl import label_points
from wayloom.labelling.types import PointLabels, SparseVotes
from wayloom.odometry.types import OdometryResult

FEW = settings(max_examples=30, deadline=None)
ALONE = LabellingSettings(votes="hard", spread=0.0)
TOGETHER = LabellingSettings(votes="hard", spread=0.05)
FAR = LabellingSettings(votes="hard", spread=0.2)


def neighbours(drive: OdometryResult, spread: float) -> Neighbours:
    return NeighbourSearch(drive, spread).of(0, len(drive.points))


def random_votes(rng: np.random.Generator, count: int) -> SparseVotes:
    """Up to three classes a point; some points have none."""
    of_each = [np.sort(rng.choice(19, rng.integers(0, 4), replace=False)).astype(np.uint8) for _ in range(count)]
    start = np.concatenate([[0], np.cumsum([len(c) for c in of_each])]).astype(np.int64)
    return SparseVotes(start, np.concatenate(of_each), rng.uniform(0.1, 2, start[-1]).astype(np.float32))


def naive_smoothed(drive: OdometryResult, votes: SparseVotes, spread: float, p: int) -> np.ndarray:
    """The votes of one point: its own sum, shared as its nearest ones of the same segment vote on the mean."""
    world, segment = drive.points_world(), drive.keyframes.segment[drive.points.host]
    dense = np.zeros((len(world), 19))
    for q in range(len(world)):
        for m in range(votes.start[q], votes.start[q + 1]):
            dense[q, votes.classes[m]] = votes.weights[m]
    sigma = spread / float(drive.points.inverse_depth[p])
    near = sorted((float(np.linalg.norm(world[q] - world[p])), q) for q in range(len(world)) if segment[q] == segment[p])
    mean, of_all = np.zeros(19), 0.0
    for r, q in near[: MAX_NEIGHBOURS + 1]:
        if r <= 3 * sigma and dense[q].any():
            weight = np.exp(-(r**2) / (2 * sigma**2)) * (OWN_WEIGHT if q == p else 1)
            mean += weight * dense[q] / dense[q].sum()
            of_all += weight
    return dense[p].sum() * mean / of_all if dense[p].any() else np.zeros(19)


@FEW
@given(seed=st.integers(0, 10_000), spread=st.floats(0.01, 0.2))
def test_smoothed_votes_are_those_of_the_naive_twin(seed: int, spread: float) -> None:
    rng = np.random.default_rng(seed)
    drive = made_drive(seed, points=40)
    drive = replace(drive, keyframes=replace(drive.keyframes, segment=np.array([0, 0, 0, 1, 1], np.int32)))
    votes, baseline = random_votes(rng, 40), rng.integers(0, 19, 40).astype(np.uint8)
    labels, found = smoothed(votes, NeighbourSearch(drive, spread), baseline, 0.0)
    for p in range(40):
        expected = naive_smoothed(drive, votes, spread, p)
        dense = np.zeros(19)
        part = slice(found.start[p], found.start[p + 1])
        dense[found.classes[part]] = found.weights[part]
        assert dense == pytest.approx(expected, rel=1e-5, abs=1e-6)
        assert expected[labels[p]] == pytest.approx(expected.max(), rel=1e-6) if expected.any() else labels[p] == baseline[p]


def weights_of(labels: PointLabels) -> np.ndarray:
    return np.add.reduceat(np.append(labels.vote_weight, 0).astype(np.float64), labels.vote_start[:-1])


def test_the_sum_of_a_points_votes_stays() -> None:
    drive, images = made_drive(4, points=200), random_images(4)
    images.smalls = [texture(4)] * 5
    alone, together = label_points(drive, images, ALONE), label_points(drive, images, FAR)
    voted = np.diff(alone.vote_start) > 0
    assert np.array_equal(voted, np.diff(together.vote_start) > 0)
    # Classes with less than 1 % of a point's votes are not kept.
    assert weights_of(together)[voted] == pytest.approx(weights_of(alone)[voted], rel=0.05)
    assert (alone.stereo != together.stereo).any()


def test_a_point_takes_the_label_of_those_beside_it_and_not_of_those_behind_it_in_the_image() -> None:
    drive = still_drive(points=10)
    images = even_images(2)
    images.smalls = [texture(0)] * 5
    for image in images.lefts[:1]:
        image[28:31, 47:53] = 13
    uv = np.array([[50, 29], [48, 29], [52, 29], [51, 30], [49, 30], [49, 28], [46, 29], [54, 29], [50, 27], [50, 31]], np.float32)
    depth = np.array([8, 8, 8, 8, 8, 8, 30, 30, 30, 30])
    images.lefts[0][29, 50] = 2  # the network errs at the first point
    points = replace(drive.points, uv_host=uv, inverse_depth=(1 / depth).astype(np.float32))
    drive = replace(drive, points=points)
    asked = {"reach": 0, "ncc_power": 0.0}
    assert label_points(drive, images, ALONE.model_copy(update=asked)).stereo.tolist() == [2] + [13] * 5 + [2] * 4
    assert label_points(drive, images, TOGETHER.model_copy(update=asked)).stereo.tolist() == [13] * 6 + [2] * 4


def test_points_of_another_segment_are_no_neighbours() -> None:
    drive = still_drive(points=2)
    points = replace(drive.points, uv_host=np.full((2, 2), 40, np.float32), host=np.array([0, 4], np.int32))
    together = neighbours(replace(drive, points=points), 0.05)
    apart = neighbours(
        replace(drive, points=points, keyframes=replace(drive.keyframes, segment=np.array([0, 0, 1, 1, 1], np.int32))), 0.05
    )
    assert together.weights.sum() == 2 * OWN_WEIGHT + 2
    assert apart.weights.sum() == 2 * OWN_WEIGHT
    assert (apart.rows[apart.weights > 0] == [0, 1]).all()


def test_a_point_without_a_depth_keeps_its_own_votes() -> None:
    drive = still_drive(points=3)
    points = replace(drive.points, inverse_depth=np.array([0.1, np.nan, -0.2], np.float32))
    search = NeighbourSearch(replace(drive, points=points), 0.05)
    near = search.of(0, 3)
    assert near.weights[1:].sum() == 2
    assert (near.rows[1:, 0] == [1, 2]).all()
    votes = SparseVotes(np.array([0, 1, 2, 3]), np.array([4, 5, 6], np.uint8), np.ones(3, np.float32))
    assert smoothed(votes, search, np.zeros(3, np.uint8), 0.0)[0].tolist() == [4, 5, 6]


def test_the_labels_do_not_depend_on_how_many_points_are_counted_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(1)
    votes, search = random_votes(rng, 150), NeighbourSearch(made_drive(1, points=150), 0.1)
    whole = smoothed(votes, search, np.zeros(150, np.uint8), 0.01)
    monkeypatch.setattr("wayloom.labelling.neighbours.POINTS_AT_ONCE", 40)
    parts = smoothed(votes, search, np.zeros(150, np.uint8), 0.01)
    assert np.array_equal(whole[0], parts[0])
    assert np.array_equal(whole[0], smoothed_labels(votes, search, np.zeros(150, np.uint8)))
    assert np.array_equal(whole[1].start, parts[1].start)
    assert np.array_equal(whole[1].weights, parts[1].weights)


def test_of_many_points_at_one_place_each_stays_its_own_neighbour() -> None:
    drive = made_drive(1, points=40)
    points = drive.points
    alike = replace(
        points, host=np.zeros_like(points.host), uv_host=np.tile(points.uv_host[:1], (40, 1)),
        inverse_depth=np.full_like(points.inverse_depth, 0.1),
    )  # fmt: skip
    near = neighbours(replace(drive, points=alike), 0.05)
    own = near.rows == np.arange(40)[:, None]
    assert own.any(axis=1).all()
    np.testing.assert_allclose(near.weights[own], OWN_WEIGHT)


@pytest.mark.parametrize("count", [1, 7, 40, 700])
def test_the_nearest_are_those_of_comparing_all_with_all(count: int) -> None:
    rng = np.random.default_rng(count)
    places = rng.normal(0, [20, 3, 1], (count, 3))
    places[::5] = np.round(places[::5])  # some at one place, some in one plane
    radius = rng.uniform(0.0, 8.0, count)
    rows, distance2 = nearest(places, radius, 9)
    for p in range(count):
        r2 = ((places - places[p]) ** 2).sum(axis=1)
        expected = [q for q in sorted(range(count), key=lambda q: (r2[q], q)) if r2[q] <= radius[p] ** 2][:9]
        found = rows[p][rows[p] >= 0].tolist()
        assert found == expected
        assert np.isinf(distance2[p, len(found) :]).all()
        np.testing.assert_allclose(distance2[p, : len(found)], r2[expected])


def test_neighbours_of_a_long_drive_take_little_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """An hour of driving has five million points: of each, its place and its number in the tree are held, and a few more for a
    while; its neighbours are never there for all points at once."""
    for name in ("labelling.neighbours.POINTS_AT_ONCE", "odometry.types.POINTS_AT_ONCE"):
        monkeypatch.setattr(f"wayloom.{name}", 512)
    peaks, counts = [], (4_000, 24_000)
    for count in counts:
        drive, votes = made_drive(3, points=count), random_votes(np.random.default_rng(0), count)
        smoothed_labels(votes, NeighbourSearch(drive, 0.05), np.zeros(count, np.uint8))
        tracemalloc.start()
        smoothed_labels(votes, NeighbourSearch(drive, 0.05), np.zeros(count, np.uint8))
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert (peaks[1] - peaks[0]) / (counts[1] - counts[0]) < 60
