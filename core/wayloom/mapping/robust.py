"""Loops that may be wrong: graduated non-convexity with truncated least squares (Yang et al., RA-L 2020).

A loop costs its chi-square r^2, but c^2 at most. Descended as it is, that keeps whatever the first guess agrees
with; so it is approached through
surrogates, from almost convex (mu -> 0) to itself (mu -> infinity). At a given mu the weight of a loop is 1 below
r^2 = c^2 mu / (mu + 1), 0
above c^2 (mu + 1) / mu, and c / r sqrt(mu (mu + 1)) - mu between (their eq. 14); weights and poses are found in turn.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wayloom.mapping.descent import Equations, descend

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
GROWTH = 1.4  # of mu, as in the paper
LATE_GROWTH = 4.0  # from a state near the solution
STEPS_EACH, MOST_LEVELS = 2, 120
ROUGHLY = 1e-6  # share of the cost that a descent within a level may leave
MOST_REVISIONS = 10


@dataclass(frozen=True, slots=True)
class Weighed:
    """A state, weights (E + P,) of 0 or 1, the truncated cost, and linear systems solved on the way."""

    state: FloatArray
    weight: FloatArray
    cost: float
    iterations: int


def truncated_weights(chi2: FloatArray, c2: float, mu: float) -> FloatArray:
    """Weights 0 … 1 of loops with chi-square (L,), c2 where they are truncated."""
    r = np.sqrt(np.maximum(chi2, np.finfo(float).tiny) / c2)
    return np.asarray(np.clip(np.sqrt(mu * (mu + 1.0)) / r - mu, 0.0, 1.0))


def graduate(equations: Equations, state: FloatArray, loops: BoolArray, c2: float, least_mu: float = 0.0) -> tuple[FloatArray, int]:
    """Where the surrogates lead from a state, and linear systems solved; loops (E + P,): the edges that are weighed.

    least_mu: where a state is near the solution already, surrogates far from the truncated cost would lead away again
    """
    weight, systems = np.ones(len(loops)), 0
    r2 = equations.chi2(equations.errors(state))[loops]
    mu = max(least_mu, c2 / max(2.0 * float(r2.max()) - c2, c2))
    for _ in range(MOST_LEVELS):
        weight[loops] = truncated_weights(r2, c2, mu)
        moved = descend(equations, state, weight, STEPS_EACH, ROUGHLY)
        state, systems = moved.state, systems + moved.iterations
        if np.isin(weight, (0.0, 1.0)).all():
            break
        r2 = equations.chi2(equations.errors(state))[loops]
        mu *= LATE_GROWTH if least_mu > 0.0 else GROWTH
    return state, systems


def settle(equations: Equations, state: FloatArray, loops: BoolArray, c2: float, most: int, converged: float) -> Weighed:
    """Truncated least squares near a state: loops below c2 count in full, others not at all, until none changes sides."""
    weight, systems = sides(equations, state, loops, c2), 0
    for _ in range(MOST_REVISIONS):
        moved = descend(equations, state, weight, most, converged)
        state, systems, before = moved.state, systems + moved.iterations, weight
        weight = sides(equations, state, loops, c2)
        if (weight == before).all():
            break
    return replace(weighed(equations, state, loops, c2, systems), weight=weight)


def weighed(equations: Equations, state: FloatArray, loops: BoolArray, c2: float, systems: int) -> Weighed:
    """A state, what counts there, and what it costs."""
    chi2 = equations.chi2(equations.errors(state))
    cost = 0.5 * float(chi2[~loops].sum() + np.minimum(chi2[loops], c2).sum())
    return Weighed(state, sides(equations, state, loops, c2), cost, systems)


def sides(equations: Equations, state: FloatArray, loops: BoolArray, c2: float) -> FloatArray:
    """(E + P,) weights of 1 for loops that count at a state, and for all that is trusted, else 0."""
    chi2 = equations.chi2(equations.errors(state))
    return np.where(loops & (chi2 > c2), 0.0, 1.0)
