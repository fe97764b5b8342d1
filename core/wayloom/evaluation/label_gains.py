"""Gain of mIoU over the single image with its bootstrap interval, and an upper bound for any weighting of the votes.

The errors of neighbouring points are correlated, so the bootstrap resamples blocks: pieces of street, not points. A point that no
image labels correctly cannot be corrected by a vote over images: `some_vote_is_right` bounds every weighting of the same votes.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_COUNT, VOID
from wayloom.labelling.types import PointLabels
from wayloom.odometry.types import OdometryResult

Labels = NDArray[np.uint8]
Numbers = NDArray[np.int64]

PIECE_M: Final = 10.0
"""Length of a piece of street."""
RESAMPLES: Final = 2000
SHARE: Final = 95.0
"""Percent of the resamples that lie in the interval."""


@dataclass(frozen=True, slots=True)
class Tally:
    """By piece of street and class, (U, 19) each: points rightly labelled, points of the class, points that got the class."""

    hits: Numbers
    of_class: Numbers
    found: Numbers


@dataclass(frozen=True, slots=True)
class Gain:
    """mIoU less the single image's, percent; low, high: where it lies in 95 % of resamples of the pieces of street."""

    miou: float
    low: float
    high: float


def pieces(odometry: OdometryResult) -> Numbers:
    """(P,) the piece of street of each point: its host's way along the drive in steps of 10 m."""
    places = odometry.keyframes.T_world_cam[:, :3, 3]
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1))])
    return np.asarray((way // PIECE_M)[odometry.points.host], np.int64)


def tally(truth: Labels, found: Labels, piece: Numbers) -> Tally:
    """Counts of points (N,) whose truth is known. piece : (N,) from 0."""
    count, known = int(piece.max(initial=-1)) + 1, truth != VOID

    def counted(rows: NDArray[np.bool_], classes: Labels) -> Numbers:
        places = piece[rows] * CLASS_COUNT + classes[rows]
        return np.bincount(places, minlength=count * CLASS_COUNT).reshape(count, CLASS_COUNT)

    hits = known & (truth == found)
    return Tally(counted(hits, truth), counted(known, truth), counted(known & (found < CLASS_COUNT), found))


def pooled(tallies: list[Tally]) -> Tally:
    """The pieces of several drives."""
    return Tally(*(np.concatenate([getattr(one, name) for one in tallies]) for name in ("hits", "of_class", "found")))


def gain(row: Tally, baseline: Tally) -> Gain:
    """Of a row over the single image, on the same pieces. The same at every call."""
    count = len(row.hits)
    times = np.random.default_rng(0).multinomial(count, np.full(count, 1.0 / count), RESAMPLES) if count else np.zeros((0, 0), int)
    gains = _miou(times, row) - _miou(times, baseline)
    whole = np.ones((1, count), np.int64)
    edges = np.nanpercentile(gains, [50 - SHARE / 2, 50 + SHARE / 2]) if np.isfinite(gains).any() else [np.nan, np.nan]
    return Gain(float((_miou(whole, row) - _miou(whole, baseline))[0]), float(edges[0]), float(edges[1]))


def _miou(times: Numbers, counts: Tally) -> NDArray[np.float64]:
    """(R,) percent, when piece u counts times[r, u] times; NaN where no point is left."""
    hits, of_class, found = (times @ part for part in (counts.hits, counts.of_class, counts.found))
    there = of_class > 0
    iou = np.where(there, hits / np.maximum(of_class + found - hits, 1), 0.0)
    with np.errstate(invalid="ignore"):
        return np.asarray(100.0 * iou.sum(axis=1) / there.sum(axis=1))


def some_vote_is_right(labels: PointLabels, truth: Labels) -> NDArray[np.bool_]:
    """(P,) whether the true class is among a point's votes. labels : of hard votes, not shared with neighbours; truth : (P,)."""
    of_vote = np.repeat(np.arange(len(labels)), np.diff(labels.vote_start))
    found = np.zeros(len(labels), bool)
    found[of_vote[labels.vote_class == truth[of_vote]]] = True
    return found


def share_of_right_votes(labels: PointLabels, truth: Labels) -> NDArray[np.float64]:
    """(P,) the true class's share of a point's votes, 0 to 1; NaN where nothing voted. As `some_vote_is_right`."""
    of_vote = np.repeat(np.arange(len(labels)), np.diff(labels.vote_start))
    right = labels.vote_class == truth[of_vote]
    total = np.bincount(of_vote, labels.vote_weight, len(labels))
    with np.errstate(invalid="ignore"):
        return np.asarray(np.bincount(of_vote[right], labels.vote_weight[right], len(labels)) / total)
