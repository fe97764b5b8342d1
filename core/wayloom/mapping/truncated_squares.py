"""Truncated least squares over parts of a drive's evidence, each believed or left out as a whole, by graduated non-convexity.

Minimised is the sum of all that stays and of min(distance2, price) of each part. It has many minima; two descents compete, one
graduated from the convex problem, one from what the first guess itself denies, and the cheaper one is the answer, after parts that
were left out have been heard once more. H. Yang, P. Antonante, V. Tzoumas, L. Carlone: Graduated Non-Convexity for Robust Spatial
Perception, RA-L 2020.
"""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from wayloom.mapping.drive_equations import DriveEquations, DriveState

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
STEPS, SOLVES, FIRST_SOLVES, GROWTH, ALTERNATIONS = 40, 2, 6, 2.0, 10
"""Steps of the graduation with growth of its parameter; Gauss-Newton iterations in each, and at a start; turns until all settle."""
LEAST_WEIGHT = 1e-6
"""Of a stretch that is left out: its nodes stay determined."""
HEARINGS = 5
"""How many refused parts are heard again."""


class JudgedGraph(Protocol):
    """Equations of a drive of which N parts, each with a price, may be left out.

    nodes  rows of the drive's nodes that it stands on
    price  (N,) squared distance beyond which a part is worth leaving out
    heard  rows of the parts that get a second hearing
    """

    nodes: IntArray
    price: FloatArray
    heard: IntArray

    def equations(self, weight: FloatArray) -> DriveEquations: ...

    def solve(self, weight: FloatArray, start: DriveState, solves: int) -> DriveState: ...

    def distance2(self, at: DriveState) -> FloatArray: ...

    def rivals(self, part: int) -> list[IntArray]:
        """Sets of parts each of which may be wrong instead of a part of `heard`."""
        ...

    def truncated_cost(self, at: DriveState) -> float: ...


def lowest(graph: JudgedGraph, T_enu_node: FloatArray) -> tuple[FloatArray, DriveState]:
    """Weights (N,) and state of the cheaper of two descents: graduated from convex, and from what the first guess itself denies."""
    return minima(graph, T_enu_node)[0]


def minima(graph: JudgedGraph, T_enu_node: FloatArray) -> list[tuple[FloatArray, DriveState]]:
    """Weights (N,) and state of both descents, the cheaper first."""
    start = graph.equations(np.ones(len(graph.price))).first_state(T_enu_node[graph.nodes])
    ends = sorted([_graduated(graph, start), _alternated(graph, start)], key=lambda end: graph.truncated_cost(end[1]))
    return [_heard(graph, *ends[0]), ends[1]]


def _graduated(graph: JudgedGraph, start: DriveState) -> tuple[FloatArray, DriveState]:
    """Truncated least squares by graduated non-convexity (Yang et al. 2020, eqs. 12 to 14)."""
    price = graph.price
    weight = np.ones(len(price))
    state = graph.solve(weight, start, FIRST_SOLVES)
    ratio = graph.distance2(state) / price
    mu = 1.0 / max(2.0 * float(ratio.max()) - 1.0, 1.0)
    for _ in range(STEPS):
        low, high = mu / (mu + 1.0), (mu + 1.0) / mu
        middle = np.sqrt(mu * (mu + 1.0) / np.maximum(ratio, 1e-12)) - mu
        weight = np.where(ratio <= low, 1.0, np.where(ratio >= high, 0.0, middle))
        if ((weight < 0.001) | (weight > 0.999)).all() and mu > 1.0:
            break
        state = graph.solve(weight, state, SOLVES)
        ratio = graph.distance2(state) / price
        mu *= GROWTH
    return _settled(graph, state)


def _alternated(graph: JudgedGraph, start: DriveState) -> tuple[FloatArray, DriveState]:
    """Leave out the half that the first guess fits worst, then what the others deny."""
    ratio = graph.distance2(start) / graph.price
    weight = np.where(ratio <= max(1.0, float(np.median(ratio))), 1.0, 0.0)
    return _settled(graph, graph.solve(weight, start, FIRST_SOLVES))


def _settled(graph: JudgedGraph, state: DriveState) -> tuple[FloatArray, DriveState]:
    """Parts worth their price and the poses that go with them, in turn, until neither changes."""
    weight = np.where(graph.distance2(state) <= graph.price, 1.0, 0.0)
    for _ in range(ALTERNATIONS):
        state = graph.solve(weight, state, FIRST_SOLVES)
        again = np.where(graph.distance2(state) <= graph.price, 1.0, 0.0)
        if (again == weight).all():
            break
        weight = again
    return weight, state


def _heard(graph: JudgedGraph, weight: FloatArray, state: DriveState) -> tuple[FloatArray, DriveState]:
    """The refused parts that may be heard again, the nearest first: one comes in, in turn for each of its rivals, and all settle.

    Of two parts that contradict each other the softer one is always the first to leave, be it right or wrong.
    """
    cost = graph.truncated_cost(state)
    ratio = (graph.distance2(state) / graph.price)[graph.heard]
    nearest = graph.heard[np.argsort(ratio, kind="stable")]
    for part in nearest[weight[nearest] < 0.5][:HEARINGS].tolist():
        for rivals in graph.rivals(part):
            other = weight.copy()
            other[rivals], other[part] = 0.0, 1.0
            alone = graph.solve(other, state, FIRST_SOLVES)
            if other.sum() == 1.0 and _least_cost(graph, alone, part) >= cost:
                break  # what is not judged denies it: no choice of the others makes up for that
            settled, there = _settled(graph, alone)
            lower = graph.truncated_cost(there)
            if lower < cost:
                weight, state, cost = settled, there, lower
    return weight, state


def _least_cost(graph: JudgedGraph, at: DriveState, part: int) -> float:
    """What a part costs, believed, where no other counts, `at` the poses that suit it best: with others it costs no less."""
    others = np.delete(np.minimum(graph.distance2(at), graph.price), part)
    return graph.truncated_cost(at) - 0.5 * float(others.sum())
