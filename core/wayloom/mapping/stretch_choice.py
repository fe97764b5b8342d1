"""Choice of the stretches of GNSS fixes that a drive believes, and the rival choices that the evidence does not rule out.

Fixes are wrong from a jump to a jump. A stretch ends at a jump or because it has grown long; belief that turns where nothing but
length parts two stretches costs TURN_PRICE. The lowest truncated squares (`wayloom.mapping.truncated_squares`) are compared with
their neighbours, runs between jumps or turns believed the other way round, one or two at a time: their costs are predicted
(`wayloom.mapping.linear_beliefs`), and the most promising are solved. A cost is a negative logarithm of a likelihood: neighbours
that cost little more than the best keep their share of the belief (Bayesian model averaging about the best model).
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayloom.mapping.drive_equations import DriveState
from wayloom.mapping.linear_beliefs import MOST_TURNED, LinearBeliefs
from wayloom.mapping.truncated_squares import FIRST_SOLVES, minima
from wayloom.mapping.witness_graph import WitnessGraph

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]
TURN_PRICE = 10.0
"""As much as one wild fix."""
ROUNDS, SOLVED = 8, 3
"""Turns of the search for a cheaper neighbour, and how many neighbours are solved in each."""
NEAR_RUNS = 8
"""Two runs are turned over together where no more than so many lie between them."""
LEAST_GAIN = 0.1
LEAST_SHARE = 1e-5
"""Of the belief, under which a rival moves nothing."""


@dataclass(frozen=True, slots=True)
class Choice:
    """Which stretches and visits are believed (B + V,), the state with them, and its cost."""

    believed: BoolArray
    state: DriveState
    cost: float


@dataclass(frozen=True, slots=True)
class Rivals:
    """Other choices: share (H,) of the belief, and moved (H, K, 6), the left perturbation (v, omega) of every node of the graph by
    which they differ from the best."""

    share: FloatArray
    moved: FloatArray


def choose(graph: WitnessGraph, T_enu_node: FloatArray) -> Choice:
    """The cheapest choice that is found from a first guess T_enu_node (K, 4, 4) of all nodes."""
    ends = [(weight > 0.5, state) for weight, state in minima(graph, T_enu_node)]
    choices = [Choice(believed, state, cost(graph, believed, state)) for believed, state in ends]
    best = min(choices, key=lambda choice: choice.cost)
    tried = {choice.believed.tobytes() for choice in choices}
    for _ in range(ROUNDS):
        cheaper = _cheapest_neighbour(graph, best, tried)
        if cheaper is best:
            break
        best = cheaper
    return best


def _cheapest_neighbour(graph: WitnessGraph, best: Choice, tried: set[bytes]) -> Choice:
    """The best or a neighbour that costs less, of those that promise it."""
    stretches, visits = np.split(best.believed, [len(graph.witnesses)])
    if not stretches.any():
        return best
    linear = LinearBeliefs(graph, stretches[graph.witnesses.stretch], visits, best.state)
    promising = [(gain, other) for gain, other, _ in _predicted(graph, best, linear) if gain < -LEAST_GAIN]
    promising = [(gain, other) for gain, other in promising if other.tobytes() not in tried]
    found = [best]
    for _, other in sorted(promising, key=lambda pair: pair[0])[:SOLVED]:
        tried.add(other.tobytes())
        state = graph.solve(np.where(other, 1.0, 0.0), best.state, FIRST_SOLVES)
        found.append(Choice(other, state, cost(graph, other, state)))
    return min(found, key=lambda choice: choice.cost)


def rivals(graph: WitnessGraph, choice: Choice, linear: LinearBeliefs) -> Rivals:
    """The neighbours of a choice that keep a share of the belief, by its equations at their minimum. What counts by a share only
    (`Witnesses.importance`) costs that share: its odds are those of the whole."""
    count = len(graph.witnesses)
    near = [*_predicted(graph, choice, linear), *_between_alike(graph, choice, linear)]
    least = [float(graph.importance[:count][(other != choice.believed)[:count]].min()) for _, other, _ in near]
    weight = np.exp(-np.maximum(np.array([gain for gain, _, _ in near]), 0.0) / np.array(least))
    share = weight / (1.0 + weight.sum())
    kept = np.flatnonzero(share > LEAST_SHARE).tolist()
    moved = [linear.moved(near[k][2], linear.turned(near[k][2])[1]) for k in kept]
    return Rivals(share[kept], np.array(moved).reshape(len(kept), len(graph.nodes), 6))


def _predicted(graph: WitnessGraph, choice: Choice, linear: LinearBeliefs) -> list[tuple[float, BoolArray, IntArray]]:
    """By how much more each neighbour of a choice costs, its belief (B + V,), and the witnesses that it turns over."""
    count, cut = len(graph.witnesses), graph.witnesses.cut
    before, found = _priced(graph, choice.believed), []
    for runs in _neighbours(choice.believed[:count], cut):
        other = choice.believed.copy()
        for run in runs:
            other[run] = ~other[run]
        if other[:count].any():
            turned = (other != choice.believed)[:count][graph.witnesses.stretch]
            witnesses = np.flatnonzero(turned & (linear.believed == choice.believed[:count][graph.witnesses.stretch]))
            if len(witnesses) > MOST_TURNED:
                continue
            found.append((linear.turned(witnesses)[0] + _priced(graph, other) - before, other, witnesses))
    return found


def _between_alike(graph: WitnessGraph, choice: Choice, linear: LinearBeliefs) -> list[tuple[float, BoolArray, IntArray]]:
    """As `_predicted`, of believed runs the other way round with the two that are left out beside them, and without any price:
    where those two agree with each other, they deny what stands between as much as it denies them, however long it is."""
    count, found = len(graph.witnesses), []
    believed = choice.believed[:count]
    runs = _runs(believed, graph.witnesses.cut)
    for before, run, after in zip(runs, runs[1:], runs[2:], strict=False):
        if believed[before].any() or not believed[run].all() or believed[after].any():
            continue
        other = choice.believed.copy()
        other[before], other[run], other[after] = True, False, True
        turned = (other != choice.believed)[:count][graph.witnesses.stretch]
        witnesses = np.flatnonzero(turned & (linear.believed == believed[graph.witnesses.stretch]))
        if len(witnesses) <= MOST_TURNED:
            found.append((linear.turned(witnesses)[0], other, witnesses))
    return found


def _runs(believed: BoolArray, cut: BoolArray) -> list[slice]:
    """Runs of stretches between jumps or turns."""
    edges = np.flatnonzero(np.append(True, ~cut[1:] | (believed[1:] != believed[:-1])))
    return [slice(a, b) for a, b in zip(edges.tolist(), [*edges[1:].tolist(), len(believed)], strict=True)]


def _neighbours(believed: BoolArray, cut: BoolArray) -> Iterator[tuple[slice, ...]]:
    """Runs of stretches between jumps or turns, each alone and each two that are near each other."""
    runs = _runs(believed, cut)
    for i, run in enumerate(runs):
        yield (run,)
        for other in runs[i + 1 : i + 2 + NEAR_RUNS]:
            yield run, other


def cost(graph: WitnessGraph, believed: BoolArray, at: DriveState) -> float:
    """Half the squares of the parts that are believed (B + V,), the price of the others, that of every turn which no jump explains,
    and what all else costs."""
    distance2 = graph.distance2(at)
    others = graph.equations(np.ones(len(believed))).cost(at) - 0.5 * float(graph.importance @ distance2)
    return others + 0.5 * float(graph.importance @ np.where(believed, distance2, 0.0)) + _priced(graph, believed)


def _priced(graph: WitnessGraph, believed: BoolArray) -> float:
    """The price of what is left out, and of every turn."""
    of_stretches, cut = believed[: len(graph.witnesses)], graph.witnesses.cut
    turns = int((cut[1:] & (of_stretches[1:] != of_stretches[:-1])).sum())
    return 0.5 * float(graph.importance @ np.where(believed, 0.0, graph.price)) + TURN_PRICE * turns
