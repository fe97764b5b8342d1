"""Choice of the stretches of GNSS fixes that a drive believes: truncated squares, and turns that no jump explains.

Fixes are wrong from a jump to a jump. A stretch ends at a jump or because it has grown long; belief that turns where nothing but
length parts two stretches costs TURN_PRICE. The lowest truncated squares (`wayloom.mapping.truncated_squares`) are compared with
their neighbours: the runs beside such a turn believed the other way round.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from wayloom.mapping.drive_equations import DriveState
from wayloom.mapping.truncated_squares import FIRST_SOLVES, minima
from wayloom.mapping.witness_graph import WitnessGraph

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
TURN_PRICE = 10.0
"""As much as one wild fix."""
NEIGHBOUR_ROUNDS, MOST_TURNS = 3, 4


@dataclass(frozen=True, slots=True)
class Choice:
    """Which stretches and visits are believed (B + V,), the state with them, and its cost."""

    believed: BoolArray
    state: DriveState
    cost: float


def choose(graph: WitnessGraph, T_enu_node: FloatArray) -> Choice:
    """The cheapest choice that is found from a first guess T_enu_node (K, 4, 4) of all nodes."""
    ends = [(weight > 0.5, state) for weight, state in minima(graph, T_enu_node)]
    choices = [Choice(believed, state, cost(graph, believed, state)) for believed, state in ends]
    best, stretches = min(choices, key=lambda choice: choice.cost), len(graph.witnesses)
    tried = {choice.believed.tobytes() for choice in choices}
    for _ in range(NEIGHBOUR_ROUNDS):
        found = []
        for of_stretches in _neighbours(best.believed[:stretches], graph.witnesses.cut):
            believed = np.concatenate([of_stretches, best.believed[stretches:]])
            if believed.tobytes() not in tried and of_stretches.any():
                tried.add(believed.tobytes())
                state = graph.solve(np.where(believed, 1.0, 0.0), best.state, FIRST_SOLVES)
                found.append(Choice(believed, state, cost(graph, believed, state)))
        cheapest = min([best, *found], key=lambda choice: choice.cost)
        if cheapest is best:
            break
        best = cheapest
    return best


def cost(graph: WitnessGraph, believed: BoolArray, at: DriveState) -> float:
    """Half the squares of the parts that are believed (B + V,), the price of the others, that of every turn which no jump explains,
    and what all else costs."""
    distance2, cut, of_stretches = graph.distance2(at), graph.witnesses.cut, believed[: len(graph.witnesses)]
    others = graph.equations(np.ones(len(believed))).cost(at) - 0.5 * float(graph.importance @ distance2)
    turns = int((cut[1:] & (of_stretches[1:] != of_stretches[:-1])).sum())
    return others + 0.5 * float(graph.importance @ np.where(believed, distance2, graph.price)) + TURN_PRICE * turns


def _neighbours(believed: BoolArray, cut: BoolArray) -> list[BoolArray]:
    """Where belief turns without a jump: each of the two runs up to jumps or turns on either side turned over, and each two."""
    turns = np.flatnonzero(cut[1:] & (believed[1:] != believed[:-1])) + 1
    edges = np.flatnonzero(np.append(True, ~cut[1:] | (believed[1:] != believed[:-1])))
    bounds, found = np.append(edges, len(believed)), []
    for turn in turns[:MOST_TURNS].tolist():
        k = int(np.searchsorted(edges, turn))
        runs = [slice(bounds[j], bounds[j + 1]) for j in range(max(k - 2, 0), min(k + 2, len(edges)))]
        found += [_turned(believed, [run]) for run in runs] + [_turned(believed, pair) for pair in combinations(runs, 2)]
    return found


def _turned(believed: BoolArray, runs: Sequence[slice]) -> BoolArray:
    out = believed.copy()
    for run in runs:
        out[run] = ~out[run]
    return out
