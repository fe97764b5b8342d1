"""How sure a gain is, and what bounds it: against slow twins, and made cases with known answers."""

from dataclasses import replace

import numpy as np
import pytest

from wayloom.evaluation.label_gains import Tally, gain, pieces, pooled, share_of_right_votes, some_vote_is_right, tally
from wayloom.evaluation.label_scores import count, scores
from wayloom.geometry.camera import PinholeCamera, StereoRig
from wayloom.labelling.types import PointLabels
from wayloom.odometry.types import Keyframes, OdometryResult, Points, Trajectory

RNG = np.random.default_rng(3)
TRUTH = RNG.choice([0, 1, 2, 8, 13, 255], 400).astype(np.uint8)
FIRST = np.where(RNG.random(400) < 0.7, TRUTH, RNG.choice([0, 2, 13, 255], 400)).astype(np.uint8)
BETTER = np.where(RNG.random(400) < 0.6, TRUTH, FIRST).astype(np.uint8)
PIECE = RNG.integers(0, 9, 400)


def drive_along(x: list[float], host: list[int]) -> OdometryResult:
    """Keyframes at these places along a line, a point in each of these hosts."""
    T = np.tile(np.eye(4), (len(x), 1, 1))
    T[:, 0, 3] = x
    n, k = len(host), len(x)
    points = Points(
        np.array(host, np.int32), np.zeros((n, 2), np.float32), np.ones(n, np.float32), np.ones(n, np.float32),
        np.zeros(n, np.uint8), np.zeros(n + 1, np.int64), np.zeros(0, np.int32), np.zeros(0, bool), np.zeros(n, bool),
    )  # fmt: skip
    trajectory = Trajectory(np.arange(k), T, np.ones(k, bool), np.zeros(k, np.int32))
    keyframes = Keyframes(np.arange(k, dtype=np.int32), T, np.zeros((k, 4)), np.zeros(k, np.int32))
    rig = StereoRig(PinholeCamera(90.0, 90.0, 50.0, 30.0, 100, 60), (-0.5, 0.0, 0.0))
    return OdometryResult(rig, trajectory, keyframes, points, 0.0, np.zeros(3))


def test_a_piece_of_street_is_10_metres_of_way_there_and_back() -> None:
    drive = drive_along([0, 4, 9.6, 10.4, 24, 16], [0, 1, 2, 3, 4, 5, 5])
    assert pieces(drive).tolist() == [0, 0, 0, 1, 2, 3, 3]


def test_the_gain_of_all_pieces_is_that_of_the_table() -> None:
    found = gain(tally(TRUTH, BETTER, PIECE), tally(TRUTH, FIRST, PIECE))
    assert found.miou == pytest.approx(scores(count(TRUTH, BETTER)).miou - scores(count(TRUTH, FIRST)).miou)
    assert found.low < found.miou < found.high


def test_the_interval_is_that_of_a_slow_twin() -> None:
    found = gain(tally(TRUTH, BETTER, PIECE), tally(TRUTH, FIRST, PIECE))
    rng, gains = np.random.default_rng(11), []
    for _ in range(400):
        rows = np.concatenate([np.flatnonzero(u == PIECE) for u in rng.integers(0, 9, 9)])
        one, other = (scores(count(TRUTH[rows], labels[rows])).miou for labels in (BETTER, FIRST))
        gains.append(one - other)
    # 400 draws give an edge of the interval to about a tenth of its width.
    width = found.high - found.low
    assert np.percentile(gains, [2.5, 97.5]) == pytest.approx([found.low, found.high], abs=0.2 * width)


def test_what_is_the_same_everywhere_is_sure() -> None:
    same = np.tile(np.array([0, 0, 1, 1], np.uint8), 5)
    wrong = np.tile(np.array([0, 1, 1, 1], np.uint8), 5)
    piece = np.repeat(np.arange(5), 4)
    found = gain(tally(same, same, piece), tally(same, wrong, piece))
    assert found.low == pytest.approx(found.miou)
    assert found.high == pytest.approx(found.miou)
    assert found.miou == pytest.approx(100 - 100 * (1 / 2 + 2 / 3) / 2)


def test_drives_are_pooled_piece_by_piece_and_nothing_judged_is_not_defined() -> None:
    one, other = tally(TRUTH, FIRST, PIECE), tally(TRUTH[:50], FIRST[:50], PIECE[:50])
    both = pooled([one, other])
    assert len(both.hits) == len(one.hits) + len(other.hits)
    assert both.found.sum() == one.found.sum() + other.found.sum()
    nothing = tally(TRUTH[:0], FIRST[:0], PIECE[:0])
    assert isinstance(nothing, Tally)
    assert np.isnan(gain(nothing, nothing).miou)


def test_the_bound_asks_for_one_right_vote_and_the_share_for_how_many() -> None:
    labels = PointLabels(
        *(np.zeros(4, np.uint8),) * 3, np.array([0, 2, 3, 3, 5]), np.array([1, 8, 2, 0, 13], np.uint8),
        np.array([0.3, 0.1, 0.2, 0.5, 0.5], np.float32),
    )  # fmt: skip
    truth = np.array([8, 1, 2, 0], np.uint8)
    assert some_vote_is_right(labels, truth).tolist() == [True, False, False, True]
    assert share_of_right_votes(labels, truth) == pytest.approx([0.25, 0.0, np.nan, 0.5], nan_ok=True)
    assert not some_vote_is_right(replace(labels, vote_class=np.full(5, 3, np.uint8)), truth).any()
