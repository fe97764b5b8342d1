"""One part of the city graph solved by itself: meetings voted on, the most likely poses, their covariance.

A meeting is judged twice. First, before anything is solved, by the surest way between its ends over the drives, the world and
meetings that are believed already, shortest ways first (`wayloom.mapping.loop_paths`): a cycle that does not close refuses it. Then
by the solution: truncated least squares (`wayloom.mapping.robust`) keep what lies within the limit of chi-square.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.geometry.probability import chi_square_quantile
from wayloom.mapping.block_cholesky import block_factor
from wayloom.mapping.descent import descend
from wayloom.mapping.loop_paths import REFUSED, Steps, believed
from wayloom.mapping.robust import settle
from wayloom.stitching.city_equations import CityEquations, city_equations

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
MOST_STEPS, CONVERGED = 50, 1e-12
ARM_M = 10.0
"""At this distance a turn counts as a way is measured."""


@dataclass(frozen=True, slots=True)
class Window:
    """N submaps and M meetings between them; shapes as `city_equations` takes them.

    alone   (N, 6, 6) information of each submap's marginal
    around  (N, 6, 6) covariance of the left perturbation about its own place, by all that is known before meetings are joined
    step    (N, 6, 6) covariance of the left perturbation of T_before_this; NaN where submaps between the two are not of the window
    """

    before: IntArray
    T0: FloatArray
    ahead: FloatArray
    information: FloatArray
    alone: FloatArray
    around: FloatArray
    step: FloatArray
    ends: IntArray
    T_a_b: FloatArray
    covariance: FloatArray


@dataclass(frozen=True, slots=True)
class Solved:
    """T_map_submap (N, 4, 4), covariance (N, 6, 6) of its left perturbation; of meetings used (M,), chi2 (M,), cycle_chi2 (M,)."""

    T_map_submap: FloatArray
    covariance: FloatArray
    used: BoolArray
    chi2: FloatArray
    cycle_chi2: FloatArray


def solve_window(window: Window, confidence: float) -> Solved:
    """The most likely poses. Inside, the origin is moved to the window's first submap, so that numbers stay small."""
    centre = np.round(window.T0[0, :3, 3])
    T0 = window.T0.copy()
    T0[:, :3, 3] -= centre
    information = np.where((window.before < 0)[:, None, None], window.alone, window.information)
    equations = city_equations(window.before, T0, window.ahead, information, window.ends, window.T_a_b, window.covariance)
    c2 = float(chi_square_quantile(confidence, 6))
    verdict, cycle_chi2 = vote(window, T0, c2)
    meetings = np.arange(len(equations.first)) >= len(T0)
    weight = np.ones(len(meetings))
    weight[meetings] = verdict != REFUSED
    first = descend(equations, equations.T0, weight, MOST_STEPS, CONVERGED)
    end = settle(equations, first.state, meetings, c2, MOST_STEPS, CONVERGED)
    T, covariance = end.state[:-1].copy(), _left_covariances(equations, end.state, end.weight)
    T[:, :3, 3] += centre
    back = se3.adjoint(se3.from_rotation_translation(np.eye(3), centre))
    covariance = back @ covariance @ back.T
    chi2 = equations.chi2(equations.errors(end.state))[meetings]
    return Solved(T, 0.5 * (covariance + np.swapaxes(covariance, 1, 2)), end.weight[meetings] > 0.0, chi2, cycle_chi2)


def vote(window: Window, T0: FloatArray, c2: float) -> tuple[IntArray, FloatArray]:
    """Verdict (M,) of the surest ways on each meeting, and chi-square (M,) of its cycle; T0 (N, 4, 4) in the window's origin."""
    n, follows = len(T0), np.flatnonzero((window.before >= 0) & np.isfinite(window.step[:, 0, 0]))
    before = window.before[follows]
    place = se3.adjoint(se3.from_rotation_translation(np.tile(np.eye(3), (n, 1, 1)), T0[:, :3, 3]))
    world = Steps(np.full(n, n), np.arange(n), T0, place @ window.around @ np.swapaxes(place, 1, 2), _length(window.around))
    chains = Steps(before, follows, se3.inverse(T0[before]) @ T0[follows], window.step[follows], _length(window.step[follows]))
    a, b = window.ends.T
    meetings = Steps(a, b, window.T_a_b, window.covariance, _length(window.covariance))
    unit = float(np.median(meetings.length)) if len(a) else 1.0
    return believed(_scaled(world.and_of(chains), unit), _scaled(meetings, unit), n + 1, c2)


def _scaled(steps: Steps, unit: float) -> Steps:
    return Steps(steps.first, steps.second, steps.T_first_second, steps.covariance, steps.length / unit)


def _length(covariance: FloatArray) -> FloatArray:
    """(k,) m^2 of covariances (k, 6, 6): of the place, and of turns at ARM_M."""
    variance = np.diagonal(covariance, axis1=1, axis2=2)
    return np.asarray(variance[:, :3].sum(axis=1) + ARM_M**2 * variance[:, 3:].sum(axis=1))


def _left_covariances(equations: CityEquations, state: FloatArray, weight: FloatArray) -> FloatArray:
    """(N, 6, 6) at a solution."""
    diagonal, blocks, _ = equations.normal(state, equations.errors(state), weight)
    right = block_factor(equations.pattern, diagonal, blocks).diagonal_of_inverse()[:-1]
    Ad = se3.adjoint(state[:-1])
    return np.asarray(Ad @ right @ np.swapaxes(Ad, 1, 2))
