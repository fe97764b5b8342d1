"""Non-monotone Gauss-Newton with Levenberg-Marquardt where it fails, over the equations of a pose graph."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from wayloom.mapping.block_cholesky import BlockPattern, NotPositiveDefiniteError, block_factor

FloatArray = NDArray[np.float64]
PATIENCE = 3
"""Steps of Gauss-Newton in a row that may end above the lowest cost. Where measurements of very different sigmas
meet, the valley of low cost is
narrow and bent: a long right step leaves it and the next one returns; a method that only descends would creep along it."""
FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-5, 1e-7, 1e6


class Equations(Protocol):
    """Weighted least squares over poses: F errors of d numbers, N nodes; see `wayloom.mapping.pose_graph_equations`."""

    @property
    def pattern(self) -> BlockPattern: ...

    @property
    def block(self) -> int: ...

    def errors(self, state: FloatArray) -> FloatArray: ...

    def chi2(self, errors: FloatArray) -> FloatArray: ...

    def normal(self, state: FloatArray, errors: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]: ...

    def moved(self, state: FloatArray, step: FloatArray) -> FloatArray: ...


@dataclass(frozen=True, slots=True)
class Place:
    """A state, its errors (E + P, d) and half of its weighted chi-square."""

    state: FloatArray
    errors: FloatArray
    cost: float


@dataclass(frozen=True, slots=True)
class Descent:
    """Where a descent ended, and linear systems solved on the way."""

    state: FloatArray
    cost: float
    iterations: int


def descend(equations: Equations, state: FloatArray, weight: FloatArray, most: int, converged: float) -> Descent:
    """The minimum of half of the weighted chi-square near a state; never a higher cost than the state's.

    weight (E + P,). Gauss-Newton with a watchdog (Chamberlain et al., 1982); where PATIENCE steps have not lowered
    the cost, damped steps
    from the best place, the diagonal enlarged ever more until one does. Ends where a step lowers the cost, or
    promises to, by less than a
    share `converged`, or after `most` linear systems.
    """
    best = place_at(equations, state, weight)
    damping, k = 0.0, 0
    while k < most and damping < MOST_DAMPING:
        place, tries = best, PATIENCE if damping == 0.0 else 1
        for _ in range(min(tries, most - k)):
            k += 1
            moved = _step(equations, place, weight, damping)
            if moved is None:
                break
            place, promised = moved
            if place.cost < best.cost or promised <= converged * best.cost:
                break
        if place.cost < best.cost:
            gain, best = best.cost - place.cost, place
            damping = 0.1 * damping if damping > LEAST_DAMPING else 0.0
            if gain <= converged * best.cost and damping == 0.0:
                break
        elif damping == 0.0 and moved is not None and promised <= converged * best.cost:
            break
        else:
            damping = max(FIRST_DAMPING, 10.0 * damping)
    return Descent(best.state, best.cost, k)


def place_at(equations: Equations, state: FloatArray, weight: FloatArray) -> Place:
    """What a state costs."""
    errors = equations.errors(state)
    return Place(state, errors, 0.5 * float(np.dot(weight, equations.chi2(errors))))


def _step(equations: Equations, at: Place, weight: FloatArray, damping: float) -> tuple[Place, float] | None:
    """Where a step leads, and what the quadratic model promises of it; None where the equations are singular."""
    diagonal, blocks, gradient = equations.normal(at.state, at.errors, weight)
    d = equations.block
    diagonal[:, range(d), range(d)] *= 1.0 + damping
    try:
        step = -block_factor(equations.pattern, diagonal, blocks).solve(gradient[:, :, None])[:, :, 0]
    except NotPositiveDefiniteError:
        return None
    place = place_at(equations, equations.moved(at.state, step), weight)
    return (place, -0.5 * float((gradient * step).sum())) if np.isfinite(place.cost) else None
