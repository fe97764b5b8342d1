"""Lane graph: lanes along streets and connecting lanes across crossings, with speed limits from curvature."""

from dataclasses import dataclass
from enum import Enum
from functools import lru_cache

import numpy as np

from wayloom.simulation.city.paths import (
    AVENUE_LANE_M,
    CYCLE_LANE_M,
    LANE_M,
    TRAM_LANE_M,
    TURN_RADIUS_M,
    eased_line,
    rounded_line,
)
from wayloom.simulation.city.streets import (
    CROSSING_LENGTH_M,
    F64,
    ISLAND_M,
    ROUNDABOUT_M,
    Control,
    StreetGraph,
    meeting_point,
)

STOP_BEFORE_M = 0.8
"""From the stop to the zebra."""
TURN_STEP_M = 0.5
STRAIGHT_SINE = 0.1
"""Streets that meet at a smaller angle go straight on."""
RING_M = 0.5 * (ROUNDABOUT_M + ISLAND_M)
RING_JOIN_RAD = 0.66
EASE_M, RING_EASE_M = 4.0, 8.0
"""Over how many metres bends begin and end."""
BODY_STEPS = 6
"""How many steps behind the front of a vehicle its body must come through a bend."""
COMFORT_M_S2, SLOW_DOWN_M_S2, FREE_M_S = 3.3, 1.8, 40.0
STRAIGHT_M_S, SWING_M = 7.0, 0.6
"""A way that may be taken faster than the first has no bend; in one, long vehicles swing out by the second."""
KEPT_ELEMENTS = 4096


ALONG = -1


class Lane(Enum):
    """Lane type of a street."""

    CAR = 0
    CYCLE = 1
    TRAM = 2


Key = tuple[Lane, int, int, int]
HALF_WIDTHS_M = {Lane.CAR: 1.25, Lane.CYCLE: 0.3, Lane.TRAM: 1.25}


@dataclass(frozen=True, slots=True)
class Element:
    """A lane or a path across a crossing: s (N,) m from its start, xy (N, 2) m; limit_m_s (N,) speed limit at each place, from the
    curvature here and behind.

    key: lane, and the nodes that it leads from, to, and on to; the last is ALONG for a lane along a street
    """

    key: Key
    s: F64
    xy: F64
    limit_m_s: F64

    @property
    def length_m(self) -> float:
        """From start to end."""
        return float(self.s[-1])


class LaneGraph:
    """Lane graph of a street graph, built lazily."""

    def __init__(self, graph: StreetGraph) -> None:
        self.graph = graph
        self.along = lru_cache(KEPT_ELEMENTS)(self._along)
        self.across = lru_cache(KEPT_ELEMENTS)(self._across)
        self.conflict = lru_cache(4 * KEPT_ELEMENTS)(self._conflict)
        self.exits = lru_cache(KEPT_ELEMENTS)(self._exits)

    def _exits(self, lane: Lane, a: int, b: int) -> tuple[int, ...]:
        """Nodes that can be reached from the lane from a to b: no outermost streets; trams go straight along their avenue."""
        out = [n for n in self.graph.neighbours(b) if n != a and not self.graph.is_outer(b, n)]
        if lane is Lane.TRAM:
            out = [n for n in out if n - b == b - a]
        if lane is Lane.CYCLE:
            out = [n for n in out if not self.graph.street(b, n).is_avenue]
        return tuple(out)

    def _along(self, lane: Lane, a: int, b: int) -> Element:
        """The lane from behind the crossing at a to the stop line before the one at b."""
        p, q = self.graph.nodes[a], self.graph.nodes[b]
        length = float(np.hypot(*(q - p)))
        d = (q - p) / length
        shift = np.array([d[1], -d[0]]) * offset_m(lane, self.graph.street(a, b).is_avenue)
        start = self.graph.clear_m(a, b) + CROSSING_LENGTH_M
        end = length - self.graph.clear_m(b, a) - CROSSING_LENGTH_M - STOP_BEFORE_M
        return Element(
            (lane, a, b, ALONG),
            np.array([0.0, end - start]),
            np.array([p + d * start + shift, p + d * end + shift]),
            np.full(2, FREE_M_S),
        )

    def _across(self, lane: Lane, a: int, b: int, c: int) -> Element:
        """The path across the crossing at b from the lane a to b into the lane b to c."""
        (before, p), (q, after) = self.along(lane, a, b).xy, self.along(lane, b, c).xy
        d, e = (p - before) / np.hypot(*(p - before)), (after - q) / np.hypot(*(after - q))
        ease = EASE_M
        if self.graph.control(b) is Control.ROUNDABOUT:
            ease = RING_EASE_M
            line = np.vstack([p, p + 0.5 * ease * d, *_ring(self.graph.nodes[b], -d, e, lane), q - 0.5 * ease * e, q])
        elif abs(d[0] * e[1] - d[1] * e[0]) < STRAIGHT_SINE:
            line = np.array([p, p + 0.5 * ease * d, q - 0.5 * ease * e, q])
        else:
            line = rounded_line(np.array([p, meeting_point(p, d, q, e), q]), TURN_RADIUS_M)
        xy = eased_line(line, d, e, TURN_STEP_M, ease)
        s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(xy, axis=0), axis=1))])
        turn = np.unwrap(np.arctan2(*np.diff(xy, axis=0).T[::-1]))
        bend = np.abs(np.convolve(np.pad(np.diff(turn), 3, mode="edge"), np.ones(5) / 5, "valid")) / s[1]
        bend = np.max([np.concatenate([np.full(back, bend[0]), bend[: len(bend) - back]]) for back in range(BODY_STEPS)], axis=0)
        limit = np.sqrt(COMFORT_M_S2 / np.maximum(bend, COMFORT_M_S2 / FREE_M_S**2))
        for k in range(len(limit) - 2, -1, -1):
            limit[k] = min(limit[k], np.sqrt(limit[k + 1] ** 2 + 2 * SLOW_DOWN_M_S2 * (s[k + 1] - s[k])))
        return Element((lane, a, b, c), s, xy, limit)

    def _conflict(self, first: Key, second: Key) -> tuple[float, float] | None:
        """Conflict zone of two paths: from where to where on the first, m, the second one is too close; None where it never is."""
        one, other = self.across(*first), self.across(*second)
        gap = np.linalg.norm(one.xy[:, None] - other.xy[None], axis=2).min(axis=1)
        swing = (
            SWING_M
            if min(one.limit_m_s.min(), other.limit_m_s.min()) < STRAIGHT_M_S and Lane.CYCLE in (first[0], second[0])
            else 0.0
        )
        near = np.nonzero(gap < apart_m(first[0], second[0]) + swing)[0]
        return (float(one.s[near[0]]), float(one.s[near[-1]])) if len(near) else None


def apart_m(first: Lane, second: Lane) -> float:
    """Least distance between the centre lines of two lanes' vehicles, m."""
    both = HALF_WIDTHS_M[first] + HALF_WIDTHS_M[second]
    return both + 0.4 if Lane.CYCLE not in (first, second) else both - 0.05


def offset_m(lane: Lane, avenue: bool) -> float:
    """Lateral offset of a lane to the right of a street's middle, m."""
    if lane is Lane.TRAM:
        return TRAM_LANE_M
    shift = AVENUE_LANE_M - LANE_M if avenue else 0.0
    return shift + (LANE_M if lane is Lane.CAR else CYCLE_LANE_M)


def _ring(node: F64, to_entry: F64, to_exit: F64, lane: Lane) -> F64:
    """(N, 2) counter-clockwise around a roundabout, between the directions (2,) from its node to the streets of entry and exit."""
    radius = RING_M + (CYCLE_LANE_M - LANE_M if lane is Lane.CYCLE else 0.0)
    start = np.arctan2(to_entry[1], to_entry[0]) + RING_JOIN_RAD
    end = np.arctan2(to_exit[1], to_exit[0]) - RING_JOIN_RAD
    angle = start + np.linspace(0, (end - start) % (2 * np.pi), 24)
    return np.asarray(node + radius * np.column_stack([np.cos(angle), np.sin(angle)]))
