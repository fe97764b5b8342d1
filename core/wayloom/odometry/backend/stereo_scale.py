"""Scale of the window's motion by static stereo: whether what the window takes for the street moves itself.

A lorry beside the car fills half of the image, and the window follows it: from one keyframe to the next the points of the street
disagree by less than a pixel, their depths give way, and one after the other is closed as an outlier. What the pair of one keyframe
alone says of their depths does not give way. Some metres on the lorry, which is near, is out of that keyframe's view, and the
street is still in it.

With T_target_host = (R, t) of the window and (R, (1 + s) t) of the street, a point of inverse depth rho by the host's own pair is
seen in the target where the window expects one of
    rho' = (1 + s) rho.
So log(rho' / rho) is log(1 + s) at every point of the street, and 0 at those that move as the window says. It is searched along the
epipolar lines, and the points vote. A third of them is asked first, and the others only where those find something amiss.
docs/decisions/0079 has what that finds.
"""

import math
from dataclasses import dataclass, field
from functools import reduce
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.odometry.backend.window import Window, chosen, joined
from wayloom.odometry.kernels.arrays import PointColumns, Rig, Robust
from wayloom.odometry.kernels.tracing import TRACED, trace_points

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
SEARCHED = 1.7
"""Times a point's inverse depth, and its inverse, between which it is searched."""
SCALES: Final = np.linspace(-math.log(SEARCHED), math.log(SEARCHED), 107)
UNIQUENESS, MAX_LENGTH_PX = 3.0, 80.0
"""As of `points.immature`."""
DISPARITY_SIGMA_PX = 0.15
VOTE_SIGMA = 0.03
"""Of a vote, at least: a few near points must not outvote a street."""
SHORTEST_M = 2.0
"""Way over which points are compared, at least."""
LEAST_VOTES = 12
FEWEST_BACK, MOST_BACK = 2, 6
"""Keyframes between which a host lies before the newest: what is near has then left its view, and the street not yet."""
SIGMAS, LEAST_SIGMA = 4.0, 0.012
"""The scale is off from so many sigmas on, of the votes and of what all of a span err in common."""
SAMPLED, AMISS_SIGMAS = 3, 1.5
"""Every so many-th point is asked first; all are where the scale is off by so many sigmas of those."""
HUBER, OUTLIER, ROUNDS = 2.0, 6.0, 10


@dataclass(frozen=True, slots=True)
class SpanScale:
    """What the street says of the window's motion over a span of keyframes that ends with the newest.

    first, last  rows of the span's keyframes in the result
    way_m        the window's way over it, along the keyframes
    log_scale    log of true way over that of the window, and sigma of it as far as the votes know; votes: how many points voted
    """

    first: int
    last: int
    way_m: float
    log_scale: float
    sigma: float
    votes: int

    def is_off(self, sigmas: float = SIGMAS) -> bool:
        """Whether the street denies the window's motion."""
        return abs(self.log_scale) > sigmas * math.hypot(self.sigma, LEAST_SIGMA)

    @property
    def step_variance(self) -> float:
        """m^2 along its way of each of the span's steps, taken for independent, by which together they err as much as it says."""
        return (math.expm1(abs(self.log_scale)) * self.way_m) ** 2 / (self.last - self.first)


@dataclass(slots=True)
class StereoScale:
    """The points that each keyframe of the window got from its own pair, by the keyframe's row in the result."""

    points: dict[int, PointColumns] = field(default_factory=dict)

    def add(self, keyframe: int, points: PointColumns) -> None:
        """points : of the keyframe, their inverse depths by static stereo alone"""
        self.points[keyframe] = points

    def measure(self, window: Window, rig: Rig, robust: Robust) -> SpanScale | None:
        """The scale over the longest span of the window; None where it is short or too few points vote."""
        self.points = {row: points for row, points in self.points.items() if row in window.keyframe}
        centres = -np.einsum("fji,fj->fi", window.frames.T_cam_world[:, :3, :3], window.frames.T_cam_world[:, :3, 3])
        back, rows = np.linalg.norm(centres - centres[-1], axis=1), window.keyframe[-1] - window.keyframe
        near = (rows >= FEWEST_BACK) & (rows <= MOST_BACK) & (back > SHORTEST_M)
        hosts = [f for f in np.flatnonzero(near).tolist() if int(window.keyframe[f]) in self.points]
        if not hosts:
            return None
        points = reduce(joined, (self._hosted(int(window.keyframe[f]), f) for f in hosts))
        way_m = float(np.linalg.norm(np.diff(centres[hosts[0] :], axis=0), axis=1).sum())
        first, last, span = int(window.keyframe[hosts[0]]), int(window.keyframe[-1]), None
        for some in (np.arange(0, len(points.rho), SAMPLED), np.arange(len(points.rho))):
            votes, sigma = _votes(window, chosen(points, some), rig, robust)
            span = SpanScale(first, last, way_m, *strongest_vote(votes, sigma), len(votes)) if len(votes) >= LEAST_VOTES else None
            if span is not None and not span.is_off(AMISS_SIGMAS):
                break
        return span

    def _hosted(self, keyframe: int, f: int) -> PointColumns:
        """The points of a keyframe that is frame f of the window now."""
        points = self.points[keyframe]
        return points._replace(host=np.full(len(points.rho), f, np.int64))


def _votes(window: Window, points: PointColumns, rig: Rig, robust: Robust) -> tuple[FloatArray, FloatArray]:
    """(n,) log(rho' / rho) of the points that are found in the newest keyframe, and (n,) their sigmas."""
    rho = points.rho
    points = points._replace(rho=rho.copy())
    low, high, state = rho / SEARCHED, rho * SEARCHED, np.zeros(len(rho), np.int64)
    trace_points(
        window.images, rig, window.frames, points, np.arange(len(rho)), len(window) - 1, low, high, UNIQUENESS,
        MAX_LENGTH_PX, robust, state,
    )  # fmt: skip
    found = np.flatnonzero(state == TRACED)
    seen = points.rho[found]
    matched = 0.5 * (high[found] - low[found]) / seen
    stereo = DISPARITY_SIGMA_PX / (-rig.fx * rig.tx * rho[found])
    return np.log(seen / rho[found]), np.hypot(matched, stereo)


def strongest_vote(votes: FloatArray, sigma: FloatArray) -> tuple[float, float]:
    """The scale that most of the votes (n,) of these sigmas (n,) support, and its sigma, that of their own scatter where that is
    larger.

    Votes of the street and of what moves are far apart, and some are wrong: the search begins where they are densest, and is a mean
    by Huber's weights from there.
    """
    sigma = np.maximum(sigma, VOTE_SIGMA)
    support = np.exp(-0.5 * ((SCALES[:, None] - votes) / sigma) ** 2).sum(axis=1)
    mean = float(SCALES[support.argmax()])
    for _ in range(ROUNDS):
        off = np.abs(votes - mean) / sigma
        weight = np.where(off < HUBER, 1.0, HUBER / np.maximum(off, HUBER)) * (off < OUTLIER) / sigma**2
        mean = float((weight * votes).sum() / weight.sum())
    scatter = float((weight * off**2).sum() / weight.sum())
    return mean, math.sqrt(max(scatter, 1.0) / float(weight.sum()))
