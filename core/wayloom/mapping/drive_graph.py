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
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from wayloom.mapping.drive_equations import (
    CorrelatedFixes,
    DriveEquations,
    DriveState,
    NoFixes,
    PoseTerms,
    left_covariances,
    marginal,
    scale_sigmas,
)
from wayloom.mapping.drive_types import AntennaFixes, DriveNoise, DriveSolution, OdometryChain, ReceiverTold
from wayloom.mapping.evidence import Evidence
from wayloom.mapping.fix_screening import screen
from wayloom.mapping.gnss_factors import RECEIVER, receiver_key
from wayloom.mapping.loop_factors import LoopTerms
from wayloom.mapping.odometry_links import links_of
from wayloom.mapping.own_frame import StartGauge, closed_in_own_frame
from wayloom.mapping.receiver_knowledge import believed, told_by_drive, with_receiver

FloatArray = NDArray[np.float64]
CLOCK_SIGMAS = 8.0
"""How far from zero the drive must see the receiver's clock before an offset is believed. Real odometry errs in more ways than its
model: on a recording whose turns deny any offset the model saw one of five sigmas."""
HINTED_SIGMAS = 3.0
"""How far before an offset that is not believed widens the covariance."""
HELD_CLOCK_S = 1e-6
"""Prior sigma of a clock that is held."""


def optimise_drive(
    chain: OdometryChain, fixes: AntennaFixes, T_enu_node: FloatArray, noise: DriveNoise, evidence: Evidence = Evidence()
) -> DriveSolution:
    """The most likely poses of a drive and their covariance.

    T_enu_node : (K, 4, 4) first guess
    Fixes and closures that are found to lie apart are left out altogether; at least one fix is needed.
    """
    known, noise = noise.receiver, replace(noise, receiver=None)
    screened = screen(chain, fixes, T_enu_node, noise, evidence)
    kept = screened.fixes.take(np.flatnonzero(screened.inlier))
    links = links_of(chain, noise)
    terms = _terms(evidence, screened.closed)
    equations = DriveEquations(chain, links, CorrelatedFixes(kept, noise), noise, terms)
    state = equations.descend(equations.first_state(screened.T_enu_node, screened.receiver))
    tree = equations.tree(state)
    receiver_covariance = marginal(tree, receiver_key())
    told = told_by_drive(state.receiver, receiver_covariance, noise)
    overruled = (False, False)
    if known is not None:
        prior, overruled = believed(told, known, noise)
        equations = with_receiver(equations, prior)
        state = equations.descend(state)
        tree = equations.tree(state)
        receiver_covariance = marginal(tree, receiver_key())
    covariance = screened.excess * left_covariances(tree, state.T_enu_node)
    covariance[:, :3, :3] += screened.unconfirmed_m**2 * np.eye(3)
    covariance += screened.doubt
    seen = clock_sigmas(state.receiver[0], receiver_covariance[0, 0], noise)
    if known is None and seen <= CLOCK_SIGMAS:
        hint_s = min(abs(state.receiver[0]), noise.time_offset_s) if seen > HINTED_SIGMAS else 0.0
        covariance[:, :3, :3] += _shift_covariance(kept, state, hint_s)
        state = _with_clock_held(equations, state)
    return DriveSolution(
        state.T_enu_node,
        covariance,
        1.0 + state.scale,
        scale_sigmas(tree, links.stretches),
        screened.inlier,
        fixes.residuals(state.T_enu_node, state.receiver),
        state.receiver,
        receiver_covariance,
        told,
        overruled,
        screened.noise_ratio,
        screened.shifted,
        screened.unconfirmed_m,
        screened.closed,
    )


def clock_sigmas(time_offset_s: float, variance_s2: float, noise: DriveNoise) -> float:
    """How many sigmas from zero the drive itself sees the receiver's clock: the score of zero, with the prior taken out again.

    On a straight road at one speed an offset is a shift along the road, which only the prior denies; the estimate is then what
    noise makes of it, and zero is the better guess. What could not be told stays in the covariance either way.
    """
    information = 1.0 / variance_s2 - 1.0 / noise.time_offset_s**2
    return abs(time_offset_s) / variance_s2 / np.sqrt(information) if information > 0.0 else 0.0


def _shift_covariance(fixes: AntennaFixes, state: DriveState, hint_s: float) -> FloatArray:
    """(K, 3, 3) m^2 along the road by an offset that is hinted at and not believed."""
    v_enu = (state.T_enu_node[fixes.node, :3, :3] @ fixes.v_node_gnss[:, :, None])[:, :, 0]
    order = np.argsort(fixes.node, kind="stable")
    rows = np.arange(len(state.T_enu_node))
    shift = np.stack([np.interp(rows, fixes.node[order], v_enu[order, axis]) for axis in range(3)], axis=1)
    shift *= hint_s
    return np.asarray(shift[:, :, None] * shift[:, None, :])


def _with_clock_held(equations: DriveEquations, state: DriveState) -> DriveState:
    """The most likely state with the receiver's stamps as they are."""
    held = copy(equations)
    held.noise = replace(equations.noise, time_offset_s=HELD_CLOCK_S)
    return held.descend(replace(state, receiver=state.receiver * [0.0, 1.0, 1.0, 1.0]))


def optimise_without_fixes(
    chain: OdometryChain, T_enu_node: FloatArray, noise: DriveNoise, evidence: Evidence = Evidence()
) -> DriveSolution:
    """As `optimise_drive` in the drive's own level frame: covariances are relative to its first node.

    T_enu_node : (K, 4, 4) the odometry, levelled; the first node at the origin
    """
    closed, T_closed = closed_in_own_frame(chain, T_enu_node, noise, evidence)
    links = links_of(chain, noise)
    terms = (*_terms(evidence, closed), StartGauge(T_enu_node[0]))
    equations = DriveEquations(chain, links, NoFixes(), noise, terms)
    state = equations.descend(equations.first_state(T_closed))
    tree = equations.tree(state)
    return DriveSolution(
        state.T_enu_node,
        left_covariances(tree, state.T_enu_node),
        1.0 + state.scale,
        scale_sigmas(tree, links.stretches),
        np.zeros(0, bool),
        np.zeros((0, 3)),
        state.receiver,
        marginal(tree, receiver_key()),
        ReceiverTold(np.zeros((RECEIVER, RECEIVER)), np.zeros(RECEIVER)),
        (False, False),
        {},
        (),
        0.0,
        closed,
    )


def _terms(evidence: Evidence, closed: NDArray[np.bool_]) -> tuple[PoseTerms, ...]:
    """The closures of the visits (V,) that are believed, and gravity."""
    loops = evidence.loops.take(closed)
    return LoopTerms(loops, np.ones(loops.visits)), evidence.up
