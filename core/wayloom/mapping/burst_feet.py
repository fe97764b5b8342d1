"""Feet of ramps: fixes beside a burst that begins or ends without a jump, and that look good because its error is small there.

Where the fixes of a burst leave the drive with a slope b (3,) m/s and no step, they did not begin to do so where somebody noticed.
With x the time by which they began earlier, the believed fixes near the edge have the error c_x(t) = b max(x - |t - edge|, 0), and
that costs more than no error by (`wayloom.mapping.linear_beliefs`; e, R, Q as in `wayloom.mapping.bias_courses`)
    D(x) = c_x^T R^-1 e + 1/2 c_x^T Q c_x.
So x has the posterior exp -D(x) over a flat prior, and the fixes up to its SURE quantile are left out: an online change point of a
slope (R. P. Adams and D. J. C. MacKay 2007, arXiv 0710.3742, with one change and known slope). No foot is longer than its burst,
and none is looked for where a burst has good fixes on one side only: there nothing tells the drive's own way from a slope of the
fixes.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.mapping.drive_equations import DriveState
from wayloom.mapping.drive_types import AntennaFixes, OdometryChain
from wayloom.mapping.evidence import Evidence
from wayloom.mapping.fix_witnesses import witnesses_of
from wayloom.mapping.linear_beliefs import LinearBeliefs
from wayloom.mapping.stretch_choice import Choice, cost
from wayloom.mapping.truncated_squares import FIRST_SOLVES
from wayloom.mapping.witness_graph import WitnessGraph, carried

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]
SLOPE_S: Final = 1.5
"""Of the burst beside its edge, from which its slope is taken."""
LEAST_FOR_SLOPE: Final = 3
STEP_S: Final = 1.0
"""An error at the edge that its slope needs longer to reach is a jump."""
LEAST_SLOPE_M_S: Final = 0.06
"""Slope under which odometry and noise change as much."""
NEAR_S: Final = 0.5
"""Half of the shortest witness: its middle may lie so far beyond the last fix."""
EARLIER_S: Final = np.arange(0.0, 8.01, 0.1)
SURE: Final = 0.95
ROUNDS: Final = 3
"""How often feet are looked for: without the first the drive lies elsewhere."""


@dataclass(frozen=True, slots=True)
class Belief:
    """inlier (M,) of the fixes, closed (V,) of the visits, and the state of a graph with them."""

    inlier: BoolArray
    closed: BoolArray
    state: DriveState


@dataclass(frozen=True, slots=True)
class SmoothEdge:
    """A believed fix next to a burst that leaves the drive by slope (3,) m/s from there and without a step; side 1: it comes after
    the fix, -1: it was before."""

    fix: int
    side: int
    slope_m_s: FloatArray


def smooth_edges(t_s: FloatArray, inlier: BoolArray, offset: FloatArray) -> list[SmoothEdge]:
    """Where belief in fixes at t_s (M,) ends without a jump; inlier (M,), offset (M, 3) m fix minus antenna."""
    ends = [(k, 1) for k in np.flatnonzero(inlier[:-1] & ~inlier[1:]).tolist()]
    ends += [(k + 1, -1) for k in np.flatnonzero(~inlier[:-1] & inlier[1:]).tolist()]
    found = []
    for fix, side in ends:
        into_s = side * (t_s - t_s[fix])
        beside = np.flatnonzero(~inlier & (into_s > 0.0) & (into_s <= SLOPE_S))
        if len(beside) < LEAST_FOR_SLOPE:
            continue
        at_edge, slope = _line(into_s[beside], offset[beside])
        steep = float(np.linalg.norm(slope))
        if steep >= LEAST_SLOPE_M_S and np.linalg.norm(at_edge) <= STEP_S * steep:
            found.append(SmoothEdge(fix, side, slope))
    return found


def foot(t_s: FloatArray, edge: SmoothEdge, linear: LinearBeliefs, witness_t_s: FloatArray) -> BoolArray:
    """(M,) the fixes at t_s (M,) that lie in the foot of a burst at one of its edges.

    linear : the equations of what is believed, witness_t_s : (W,) s of its witnesses
    """
    before_s = -edge.side * (witness_t_s - t_s[edge.fix])
    near = (before_s > -NEAR_S) & linear.believed
    errors = [np.where(near, np.maximum(x - np.maximum(before_s, 0.0), 0.0), 0.0)[:, None] * edge.slope_m_s for x in EARLIER_S]
    cost = np.array([linear.with_errors(error) for error in errors])
    posterior = np.exp(cost.min() - cost)
    earlier = float(EARLIER_S[np.searchsorted(np.cumsum(posterior) / posterior.sum(), SURE)])
    into_s = edge.side * (t_s - t_s[edge.fix])
    return np.asarray((into_s <= 0.0) & (into_s > -earlier))


def within_reach(t_s: FloatArray, inlier: BoolArray) -> BoolArray:
    """(M,) the fixes at t_s (M,) that are no further from a burst than it is long; inlier (M,): bursts are what lies between."""
    reach = np.zeros(len(t_s), bool)
    good = np.flatnonzero(inlier)
    for last, first in pairwise(good.tolist()):
        if first > last + 1:
            length_s = t_s[first] - t_s[last]
            reach |= (t_s > t_s[last] - length_s) & (t_s < t_s[first] + length_s)
    return reach


def without_feet(
    chain: OdometryChain, fixes: AntennaFixes, jump: BoolArray, graph: WitnessGraph, evidence: Evidence, belief: Belief
) -> tuple[WitnessGraph, Choice] | None:
    """The choice without the feet of bursts that come or go smoothly, in a graph of stretches that end there; None where there are
    no feet."""
    inlier, state, reach = belief.inlier, belief.state, within_reach(fixes.t_s, belief.inlier)
    for _ in range(ROUNDS):
        T = carried(chain, graph.nodes, state.T_enu_node)
        edges = smooth_edges(fixes.t_s, inlier, fixes.residuals(T, state.receiver))
        if not edges:
            break
        graph, choice = _cut_at_edges(chain, fixes, jump, graph, evidence, Belief(inlier, belief.closed, state))
        state, witnesses = choice.state, graph.witnesses
        good = choice.believed[: len(witnesses)]
        if not good.any():
            return None
        linear = LinearBeliefs(graph, good[witnesses.stretch], belief.closed, state)
        feet = inlier & reach & np.any([foot(fixes.t_s, edge, linear, witnesses.fixes.t_s) for edge in edges], axis=0)
        if not feet.any() or feet.sum() == inlier.sum():
            break
        inlier = inlier & ~feet
    if (inlier == belief.inlier).all():
        return None
    graph, choice = _cut_at_edges(chain, fixes, jump, graph, evidence, Belief(inlier, belief.closed, state))
    return (graph, choice) if choice.believed[: len(graph.witnesses)].any() else None


def _cut_at_edges(
    chain: OdometryChain, fixes: AntennaFixes, jump: BoolArray, graph: WitnessGraph, evidence: Evidence, belief: Belief
) -> tuple[WitnessGraph, Choice]:
    """A graph of stretches that end where good fixes do, and the choice of those in which all are good: among nothing but jumps
    neighbours stay one stretch."""
    T = carried(chain, graph.nodes, belief.state.T_enu_node)
    cut = jump.copy()
    cut[1:] |= belief.inlier[1:] != belief.inlier[:-1]
    finer = WitnessGraph(chain, witnesses_of(fixes, cut, T, graph.noise), graph.noise, evidence)
    outside = np.concatenate([[0], np.cumsum(~belief.inlier)])
    good = outside[finer.witnesses.last + 1] == outside[finer.witnesses.first]
    believed = np.concatenate([good, belief.closed])
    weight = np.where(believed, 1.0, 0.0)
    start = finer.equations(weight).first_state(T[finer.nodes], belief.state.receiver)
    state = finer.solve(weight, start, FIRST_SOLVES)
    return finer, Choice(believed, state, cost(finer, believed, state))


def _line(t_s: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(3,) value at zero and (3,) slope of the line through values (n, 3) at t_s (n,)."""
    A = np.column_stack([np.ones(len(t_s)), t_s])
    start, slope = np.linalg.lstsq(A, values, rcond=None)[0]
    return start, slope
