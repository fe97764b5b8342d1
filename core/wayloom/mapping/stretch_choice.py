"""Choice of the stretches of GNSS fixes that a drive believes: truncated least squares with one weight a stretch.

Graduated non-convexity (Yang et al., RA-L 2020) starts at the first guess; a second descent, which begins by leaving out what the
guess itself denies, competes with it, and so do the neighbours of the cheaper one where belief turns without a jump in the fixes.
The lowest cost wins: the result is never worse than what the first guess says.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from wayloom.mapping.drive_equations import DriveEquations, DriveState, IndependentFixes
from wayloom.mapping.drive_types import DriveNoise, OdometryChain
from wayloom.mapping.fix_witnesses import Witnesses
from wayloom.mapping.odometry_links import links_of

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]
STEPS, SOLVES, FIRST_SOLVES, GROWTH, ALTERNATIONS = 40, 2, 6, 2.0, 10
"""Steps of the graduation with growth of its parameter; Gauss-Newton iterations in each, and at a start; turns until all settle."""
LEAST_WEIGHT = 1e-6
"""Of a stretch that is left out: its nodes stay determined."""
TURN_PRICE = 10.0
"""Of fixes that are believed up to a moment at which they do not jump, or from it on: as much as one wild fix."""
NEIGHBOUR_ROUNDS, MOST_TURNS = 3, 4


@dataclass(frozen=True, slots=True)
class Choice:
    """Which stretches are believed (B,), the state with them, and its cost."""

    believed: BoolArray
    state: DriveState
    cost: float


class WitnessGraph:
    """Witnesses and odometry over the nodes that witnesses are seen from."""

    def __init__(self, chain: OdometryChain, witnesses: Witnesses, noise: DriveNoise) -> None:
        ends, lost = np.array([0, len(chain.T_world_node) - 1], np.int64), np.flatnonzero(~chain.connected)
        self.chain, self.witnesses, self.noise = chain, witnesses, noise
        self.nodes = np.unique(np.concatenate([ends, witnesses.fixes.node, lost, lost + 1, chain.level]))
        self.coarse = coarse_chain(chain, self.nodes)
        self.links = links_of(self.coarse, noise)
        self.fixes = replace(witnesses.fixes, node=np.searchsorted(self.nodes, witnesses.fixes.node))

    def equations(self, weight: FloatArray) -> DriveEquations:
        """With each stretch's weight (B,), 0 to 1, of its information."""
        terms = IndependentFixes(self.fixes, (np.maximum(weight, LEAST_WEIGHT) * self.witnesses.importance)[self.witnesses.stretch])
        return DriveEquations(self.coarse, self.links, terms, self.noise)

    def solve(self, weight: FloatArray, start: DriveState, solves: int) -> DriveState:
        """Descend from a state."""
        return self.equations(weight).descend(start, solves)

    def distance2(self, at: DriveState) -> FloatArray:
        """(B,) sum of the squared distances of each stretch's witnesses from the antenna, in their sigmas."""
        residual = self.fixes.residuals(at.T_enu_node, at.receiver)
        of_witness = np.einsum("ni,ni->n", residual, np.linalg.solve(self.fixes.covariance, residual[:, :, None])[:, :, 0])
        return self.witnesses.sums(of_witness)

    def cost(self, believed: BoolArray, at: DriveState) -> float:
        """Half the squares of the stretches that are believed (B,), the price of the others, that of every turn which no jump
        explains, and what all else costs."""
        distance2, importance = self.distance2(at), self.witnesses.importance
        others = self.equations(np.ones(len(believed))).cost(at) - 0.5 * float(importance @ distance2)
        turns = int((self.witnesses.cut[1:] & (believed[1:] != believed[:-1])).sum())
        return others + 0.5 * float(importance @ np.where(believed, distance2, self.witnesses.price)) + TURN_PRICE * turns


def coarse_chain(chain: OdometryChain, nodes: IntArray) -> OdometryChain:
    """The chain over some of its nodes, both ends among them."""
    road = np.concatenate([[0.0], np.cumsum(chain.length_m)])
    breaks = np.concatenate([[0], np.cumsum(~chain.connected)])
    level = np.flatnonzero(np.isin(nodes, chain.level))
    return OdometryChain(chain.T_world_node[nodes], np.diff(road[nodes]), np.diff(breaks[nodes]) == 0, level)


def choose(graph: WitnessGraph, T_enu_node: FloatArray) -> Choice:
    """The cheapest of the descents, graduated from convex and from what the first guess itself denies, and of their neighbours."""
    start = graph.equations(np.ones(len(graph.witnesses))).first_state(T_enu_node[graph.nodes])
    tried: dict[bytes, Choice] = {}
    for weight, state in (_graduated(graph, start), _alternated(graph, start)):
        believed = weight > 0.5
        tried.setdefault(believed.tobytes(), Choice(believed, state, graph.cost(believed, state)))
    best = min(tried.values(), key=lambda choice: choice.cost)
    for _ in range(NEIGHBOUR_ROUNDS):
        for believed in _neighbours(best.believed, graph.witnesses.cut):
            if believed.tobytes() not in tried and believed.any():
                state = graph.solve(np.where(believed, 1.0, 0.0), best.state, FIRST_SOLVES)
                tried[believed.tobytes()] = Choice(believed, state, graph.cost(believed, state))
        cheapest = min(tried.values(), key=lambda choice: choice.cost)
        if cheapest is best:
            break
        best = cheapest
    return best


def _neighbours(believed: BoolArray, cut: BoolArray) -> list[BoolArray]:
    """Where belief turns without a jump: the run on either side of it turned over, and both, up to the next jump or turn."""
    turns = np.flatnonzero(cut[1:] & (believed[1:] != believed[:-1])) + 1
    edges = np.flatnonzero(np.append(True, ~cut[1:] | (believed[1:] != believed[:-1])))
    bounds, found = np.append(edges, len(believed)), []
    for turn in turns[:MOST_TURNS].tolist():
        k = int(np.searchsorted(edges, turn))
        runs = [slice(bounds[j], bounds[j + 1]) for j in range(max(k - 2, 0), min(k + 2, len(edges)))]
        found += [_turned(believed, [run]) for run in runs] + [_turned(believed, pair) for pair in pairwise(runs)]
    return found


def _turned(believed: BoolArray, runs: Sequence[slice]) -> BoolArray:
    out = believed.copy()
    for run in runs:
        out[run] = ~out[run]
    return out


def _graduated(graph: WitnessGraph, start: DriveState) -> tuple[FloatArray, DriveState]:
    """Truncated least squares by graduated non-convexity (Yang et al. 2020, eqs. 12 to 14)."""
    price = graph.witnesses.price
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


def _alternated(graph: WitnessGraph, start: DriveState) -> tuple[FloatArray, DriveState]:
    """Leave out the half that the first guess fits worst, then what the others deny."""
    ratio = graph.distance2(start) / graph.witnesses.price
    weight = np.where(ratio <= max(1.0, float(np.median(ratio))), 1.0, 0.0)
    return _settled(graph, graph.solve(weight, start, FIRST_SOLVES))


def _settled(graph: WitnessGraph, state: DriveState) -> tuple[FloatArray, DriveState]:
    """Stretches worth their price and the poses that go with them, in turn, until neither changes."""
    weight = np.where(graph.distance2(state) <= graph.witnesses.price, 1.0, 0.0)
    for _ in range(ALTERNATIONS):
        state = graph.solve(weight, state, FIRST_SOLVES)
        again = np.where(graph.distance2(state) <= graph.witnesses.price, 1.0, 0.0)
        if (again == weight).all():
            break
        weight = again
    return weight, state
