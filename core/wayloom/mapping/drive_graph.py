"""Factor graph of one drive: odometry, GNSS and gravity, in the tangent plane of the drive's own place.

Unknowns: the pose T_enu_node of every node, the scale s of every stretch of odometry, the receiver's time offset and lever arm,
and for every fix that is kept the true place g of the antenna at that time.

- Odometry between neighbouring nodes: small white noise, and a scale that varies slowly (`wayloom.mapping.odometry_links`).
  After a loss the link is the constant-motion guess and nearly free, so the segments are held together by GNSS.
- GNSS: correlated noise, time offset and lever arm (`wayloom.mapping.gnss_factors`), held against what is known of them
  (`wayloom.mapping.receiver_knowledge`); stretches of fixes that lie apart are found
  first (`wayloom.mapping.fix_screening`) and left out.
- Loop closures between any two nodes (`wayloom.mapping.loop_factors`), judged together with the fixes, or, where there are none,
  against the odometry alone (`wayloom.mapping.own_frame`).
- Gravity: what accelerometers, streets and walls say of up (`wayloom.mapping.up_factors`), and a camera is roughly level: on a
  straight road GNSS cannot tell the roll about the track.
"""

from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wayloom.mapping.antenna_height import DOWN, antenna_height, held_at, is_loose, without_height
from wayloom.mapping.belief_doubts import second_moments
from wayloom.mapping.clock_drift import clock_drift
from wayloom.mapping.drive_equations import (
    CorrelatedFixes,
    DriveEquations,
    DriveState,
    NoFixes,
    PoseTerms,
)
from wayloom.mapping.drive_types import AntennaFixes, DriveNoise, DriveSolution, OdometryChain, ReceiverTold
from wayloom.mapping.evidence import Evidence
from wayloom.mapping.fix_screening import screen
from wayloom.mapping.gnss_factors import RECEIVER, with_held
from wayloom.mapping.height_datums import datum_heights, without_datums
from wayloom.mapping.loop_factors import LoopTerms
from wayloom.mapping.odometry_links import links_of
from wayloom.mapping.own_frame import StartGauge, closed_in_own_frame
from wayloom.mapping.receiver_knowledge import believed, told_by_drive, with_receiver

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
NO_PAIRS = np.zeros((0, 2), np.int64)
CLOCK_SIGMAS = 8.0
"""How far from zero the drive must see the receiver's clock before an offset is believed. Real odometry errs in more ways than its
model: on a recording whose turns deny any offset the model saw one of five sigmas."""
HINTED_SIGMAS = 3.0
"""How far before an offset that is not believed widens the covariance."""
HELD_CLOCK_S = 1e-6
"""Prior sigma of a clock that is held."""


def optimise_drive(
    chain: OdometryChain,
    fixes: AntennaFixes,
    T_enu_node: FloatArray,
    noise: DriveNoise,
    evidence: Evidence = Evidence(),
    pairs: IntArray = NO_PAIRS,
) -> DriveSolution:
    """The most likely poses of a drive and their covariance.

    T_enu_node : (K, 4, 4) first guess
    pairs      : (P, 2) rows of nodes, the lesser first, whose joint covariance is wanted
    Fixes and closures that are found to lie apart are left out altogether; at least one fix is needed.
    """
    known, noise = noise.receiver, replace(noise, receiver=None)
    screened = screen(chain, fixes, T_enu_node, noise, evidence)
    kept = screened.fixes.take(np.flatnonzero(screened.inlier))
    links = links_of(chain, noise)
    terms = _terms(evidence, screened.closed)
    equations = DriveEquations(chain, links, CorrelatedFixes(kept, noise), noise, terms)
    solved = _solved(equations, equations.first_state(screened.T_enu_node, screened.receiver), pairs)
    told = told_by_drive(solved.receiver, solved.receiver_covariance, noise)
    overruled = (False, False)
    if known is not None:
        prior, overruled = believed(told, known, noise)
        solved = _solved(with_receiver(equations, prior), solved.state, pairs)
    state, receiver_covariance = solved.state, solved.receiver_covariance
    covariance, cross = screened.excess * solved.covariance, screened.excess * solved.cross
    shifts = _shifts(len(covariance))
    beside = [screened.doubts, screened.unconfirmed_m * shifts, screened.unconfirmed_height_m * shifts[2:], solved.by_height]
    drift = clock_drift(solved.equations, state)
    if drift is not None and (noise.clock_drifts or HINTED_SIGMAS < drift.sigmas <= CLOCK_SIGMAS):
        beside.append(max(drift.sigmas, 1.0) * drift.per_sigma[None])
    seen = clock_sigmas(state.receiver[0], receiver_covariance[0, 0], noise)
    if known is None and seen <= CLOCK_SIGMAS:
        hint_s = min(abs(state.receiver[0]), noise.time_offset_s) if seen > HINTED_SIGMAS else 0.0
        beside.append(hint_s * _way_by_the_clock(kept, state))
        state = _with_clock_held(solved.equations, state)
    moved = np.concatenate(beside)
    receiver = state.receiver + solved.receiver - solved.state.receiver
    residual, datum = fixes.residuals(state.T_enu_node, receiver), screened.fixes.datum
    datum_height_m = datum_heights(residual, datum)
    return DriveSolution(
        state.T_enu_node,
        covariance + second_moments(moved, moved),
        cross + second_moments(moved[:, pairs[:, 0]], moved[:, pairs[:, 1]]),
        1.0 + state.scale,
        solved.scale_sigma,
        screened.inlier,
        without_datums(residual, datum, datum_height_m),
        receiver,
        receiver_covariance,
        drift.drift if drift is not None and drift.sigmas > CLOCK_SIGMAS else 0.0,
        told,
        overruled,
        screened.noise_ratio,
        screened.shifted,
        screened.unconfirmed_m,
        screened.unconfirmed_height_m,
        datum,
        datum_height_m,
        screened.closed,
    )


@dataclass(frozen=True, slots=True)
class Solved:
    """Equations and the state at their minimum; the receiver (4,) that goes with it, as its fixes have it; covariances of left
    perturbations (K, 6, 6), of pairs of nodes (P, 6, 6) and of the receiver (4, 4); sigma (S,) of the scale; by_height (H, K, 6)
    left perturbations by one sigma of how high the antenna stands, where nobody knows that."""

    equations: DriveEquations
    state: DriveState
    receiver: FloatArray
    covariance: FloatArray
    cross: FloatArray
    receiver_covariance: FloatArray
    scale_sigma: FloatArray
    by_height: FloatArray


def _solved(equations: DriveEquations, start: DriveState, pairs: IntArray) -> Solved:
    """The minimum; where nobody knows how high the antenna stands, at the mean of what its height may be."""
    state, by_height = equations.descend(start), np.zeros((0, len(start.T_enu_node), 6))
    height = antenna_height(equations, state) if is_loose(equations) else None
    if height is not None:
        equations = held_at(equations, height.down_m)
        state = equations.descend(replace(state, receiver=without_height(state.receiver)))
        by_height = height.sigma_m * height.nodes_per_m[None]
    known = equations.covariances(state, pairs)
    receiver, of_receiver = state.receiver, known.receiver
    if height is not None:
        receiver = receiver + height.down_m * (np.arange(RECEIVER) == DOWN)
        of_receiver = of_receiver + height.sigma_m**2 * np.outer(height.receiver_per_m, height.receiver_per_m)
    return Solved(equations, state, receiver, known.nodes, known.cross, of_receiver, known.scale_sigma, by_height)


def clock_sigmas(time_offset_s: float, variance_s2: float, noise: DriveNoise) -> float:
    """How many sigmas from zero the drive itself sees the receiver's clock: the score of zero, with the prior taken out again.

    On a straight road at one speed an offset is a shift along the road, which only the prior denies; the estimate is then what
    noise makes of it, and zero is the better guess. What could not be told stays in the covariance either way.
    """
    information = 1.0 / variance_s2 - 1.0 / noise.time_offset_s**2
    return abs(time_offset_s) / variance_s2 / np.sqrt(information) if information > 0.0 else 0.0


def _shifts(count: int) -> FloatArray:
    """(3, count, 6) left perturbations that shift the whole drive by a metre along each axis."""
    return np.broadcast_to(np.eye(3, 6)[:, None], (3, count, 6))


def _way_by_the_clock(fixes: AntennaFixes, state: DriveState) -> FloatArray:
    """(1, K, 6) left perturbation of the nodes along the road, a second of the receiver's clock long."""
    v_enu = (state.T_enu_node[fixes.node, :3, :3] @ fixes.v_node_gnss[:, :, None])[:, :, 0]
    order = np.argsort(fixes.node, kind="stable")
    rows = np.arange(len(state.T_enu_node))
    shift = np.stack([np.interp(rows, fixes.node[order], v_enu[order, axis]) for axis in range(3)], axis=1)
    return np.concatenate([shift, np.zeros_like(shift)], axis=1)[None]


def _with_clock_held(equations: DriveEquations, state: DriveState) -> DriveState:
    """The most likely state with the receiver's stamps as they are."""
    held = copy(equations)
    held.noise = with_held(equations.noise, 0, HELD_CLOCK_S)
    return held.descend(replace(state, receiver=state.receiver * [0.0, 1.0, 1.0, 1.0]))


def optimise_without_fixes(
    chain: OdometryChain, T_enu_node: FloatArray, noise: DriveNoise, evidence: Evidence = Evidence(), pairs: IntArray = NO_PAIRS
) -> DriveSolution:
    """As `optimise_drive` in the drive's own level frame: covariances are relative to its first node.

    T_enu_node : (K, 4, 4) the odometry, levelled; the first node at the origin
    """
    closed, T_closed = closed_in_own_frame(chain, T_enu_node, noise, evidence)
    links = links_of(chain, noise)
    terms = (*_terms(evidence, closed), StartGauge(T_enu_node[0]))
    equations = DriveEquations(chain, links, NoFixes(), noise, terms)
    state = equations.descend(equations.first_state(T_closed))
    known = equations.covariances(state, pairs)
    return DriveSolution(
        state.T_enu_node,
        known.nodes,
        known.cross,
        1.0 + state.scale,
        known.scale_sigma,
        np.zeros(0, bool),
        np.zeros((0, 3)),
        state.receiver,
        known.receiver,
        0.0,
        ReceiverTold(np.zeros((RECEIVER, RECEIVER)), np.zeros(RECEIVER)),
        (False, False),
        {},
        (),
        0.0,
        0.0,
        np.zeros(0, np.int64),
        np.zeros(0),
        closed,
    )


def _terms(evidence: Evidence, closed: NDArray[np.bool_]) -> tuple[PoseTerms, ...]:
    """The closures of the visits (V,) that are believed, and gravity."""
    loops = evidence.loops.take(closed)
    return LoopTerms(loops, np.ones(loops.visits)), evidence.up
