"""Last look at a choice of GNSS fixes: errors without a jump are left out, and what is not ruled out widens the covariance.

Courses of errors (`wayloom.mapping.bias_courses`) that are seen beyond FOUND are left out, the strongest first. One that is seen
less, by its odds, which are even at HINTED, or another choice of stretches that is nearly as likely
(`wayloom.mapping.stretch_choice.rivals`), is kept as a doubt: the second moment of what it would move the drive by, with its share
of the belief.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry.probability import chi_square_quantile
from wayloom.mapping.bias_courses import BiasCourse, bias_courses, moved_by
from wayloom.mapping.drive_equations import DriveEquations, DriveState
from wayloom.mapping.gnss_factors import receiver_covariance
from wayloom.mapping.linear_beliefs import LinearBeliefs
from wayloom.mapping.stretch_choice import LEAST_SHARE, Choice, rivals
from wayloom.mapping.truncated_squares import FIRST_SOLVES, LEAST_WEIGHT
from wayloom.mapping.witness_graph import WitnessGraph

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]
FOUND = 36.0
"""Chi-square of three degrees, six sigmas of one: real odometry errs in more ways than its model, by 16 on the recordings."""
HINTED = float(chi_square_quantile(0.999, 3))
LEAST_BELIEF = 0.05
"""In a course, under which it moves nothing."""
MOST_COURSES = 8
DENIED_SIGMAS = 3.0
"""Of the receiver's prior, beyond which its errors are not looked for in single windows."""
BAND = 0.95
"""Quantile of chi-square beyond which the squares deny the model, and widen the covariance in proportion."""


@dataclass(frozen=True, slots=True)
class Examined:
    """believed (W,) of the witnesses, the state with them, and moved (H, K, 6): left perturbations (v, omega) of every node of the
    graph by which the drive may lie elsewhere, one sigma each; excess: squares over their expectation, where that is denied."""

    believed: BoolArray
    state: DriveState
    moved: FloatArray
    excess: float


def examine(graph: WitnessGraph, choice: Choice) -> Examined:
    """Leave out what comes and goes without a jump, and gather what remains in doubt."""
    stretches, visits = np.split(choice.believed, [len(graph.witnesses)])
    believed, state, moved = stretches[graph.witnesses.stretch], choice.state, []
    for _ in range(MOST_COURSES):
        linear = LinearBeliefs(graph, believed, visits, state)
        courses = sorted(bias_courses(graph, linear), key=lambda course: -course.chi2)
        if not courses or courses[0].chi2 <= FOUND or _receiver_is_denied(graph, state) or not _without(believed, courses[0]).any():
            break
        moved += _instead(linear, courses)
        believed = _without(believed, courses[0])
        state = _equations(graph, believed, visits).descend(state, FIRST_SOLVES)
    others = rivals(graph, choice, linear)
    moved += [np.sqrt(share) * by for share, by in zip(others.share, others.moved, strict=True)]
    moved += [np.sqrt(_belief(course)) * moved_by(linear, course) for course in _hinted(courses)]
    excess = _excess(graph, believed, visits, state)
    return Examined(believed, state, np.array(moved).reshape(-1, len(graph.nodes), 6), excess)


def _receiver_is_denied(graph: WitnessGraph, state: DriveState) -> bool:
    """Whether clock or lever arm are far from what is told of them: that is an error of the whole drive, and no burst."""
    return bool((np.abs(state.receiver) > DENIED_SIGMAS * np.sqrt(np.diag(receiver_covariance(graph.noise)))).any())


def _instead(linear: LinearBeliefs, courses: list[BiasCourse]) -> list[FloatArray]:
    """(K, 6) each: by what the drive would lie elsewhere if another course explained what the first of them does, times the root of
    its share of their likelihoods."""
    weight = np.exp(0.5 * (np.array([course.chi2 for course in courses]) - courses[0].chi2))
    share, first = weight / weight.sum(), moved_by(linear, courses[0])
    return [np.sqrt(share[k]) * (moved_by(linear, courses[k]) - first) for k in np.flatnonzero(share > LEAST_SHARE)[1:].tolist()]


def _without(believed: BoolArray, course: BiasCourse) -> BoolArray:
    """Without the witnesses of a course, and one more on either side: where it begins nobody tells."""
    out = believed.copy()
    out[course.witnesses] = False
    first, last = int(course.witnesses[0]), int(course.witnesses[-1])
    out[max(first - 1, 0) : first], out[last + 1 : last + 2] = False, False
    return out


def _equations(graph: WitnessGraph, believed: BoolArray, visits: BoolArray) -> DriveEquations:
    weight = np.where(believed, 1.0, LEAST_WEIGHT) * graph.importance[graph.witnesses.stretch]
    return graph.weighted(weight, np.where(visits, 1.0, LEAST_WEIGHT))


def _excess(graph: WitnessGraph, believed: BoolArray, visits: BoolArray, state: DriveState) -> float:
    """The squares of what is believed over their expectation (global test of the model: W. Baarda 1968); 1 within the band."""
    loops, up = graph.evidence.loops, graph.evidence.up
    degrees = 3 * int(believed.sum()) + 6 * len(np.unique(loops.group[visits[loops.visit]])) + 2 * len(up)
    squares = 2.0 * _equations(graph, believed, visits).cost(state)
    return squares / degrees if squares > chi_square_quantile(BAND, degrees) else 1.0


def _hinted(courses: list[BiasCourse]) -> list[BiasCourse]:
    """The strongest of those that share no witness, of courses in falling order."""
    taken: set[int] = set()
    found = []
    for course in courses:
        if _belief(course) > LEAST_BELIEF and taken.isdisjoint(course.witnesses.tolist()):
            taken.update(course.witnesses.tolist())
            found.append(course)
    return found


def _belief(course: BiasCourse) -> float:
    """Share of the belief of a course: its likelihood against odds that are even at HINTED."""
    return float(1.0 / (1.0 + np.exp(0.5 * (HINTED - course.chi2))))


def spread_doubts(nodes: IntArray, moved: FloatArray, count: int) -> FloatArray:
    """(H, count, 6) left perturbations of all nodes, by moved (H, K, 6) at `nodes` (K,): between them they change evenly."""
    rows = np.arange(count)
    each = np.array([[np.interp(rows, nodes, column) for column in by.T] for by in moved]).reshape(len(moved), 6, count)
    return np.ascontiguousarray(np.swapaxes(each, 1, 2))


def second_moments(first: FloatArray, second: FloatArray) -> FloatArray:
    """(N, 6, 6) sums over H of the products of left perturbations first (H, N, 6), rows, and second (H, N, 6), columns."""
    return np.asarray(np.einsum("hki,hkj->kij", first, second))
