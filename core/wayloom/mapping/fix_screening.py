"""Screening of GNSS fixes: how much they scatter, where they jump, and which stretches of them lie apart from the drive.

GNSS errors come in stretches (a reflected signal, a wrong integer), not fix by fix; so fixes are judged by *stretches*
(`wayloom.mapping.fix_witnesses`), runs without a jump. Odometry is good to millimetres from fix to fix: a jump between two fixes
that it does not show begins a new stretch.

0. Wild ones: single fixes far from their neighbours are left out at once (`wayloom.mapping.wild_fixes`).
1. Scatter: the differences of neighbouring fixes against the odometry's say how much a receiver's fixes really scatter. Where that
   is more than white noise of the claimed covariance, the covariance is inflated by it (median: up to half of the fixes may be
   wild).
2. Jumps: differences beyond the gate of the noise so found cut the fixes into stretches, and each stretch into *witnesses*, the
   means of few fixes near its ends and of more inside: a jump is only seen where both sides are near by, as the odometry's scale
   may explain the same distance over a hundred metres.
3. Ramps: where fixes leave the odometry within a second without a jump, or by many, each of them stands alone, and neighbours that
   all stand alone are one stretch.
4. Stretches: truncated least squares with one weight a stretch, on a graph of the odometry with its slowly varying scale, the
   receiver's time offset and lever arm (`wayloom.mapping.stretch_choice`). A stretch is left out for a price: the quantile of
   chi-square of its witnesses, and PRICE_S for each second, so that of two parts that contradict each other the longer is believed.
5. Loop closures are judged in the same squares, each visit's against a price of their own: they unmask stretches that lie apart,
   and those that contradict odometry and fixes are left out.
6. Bursts that come or go without a jump take their feet with them (`wayloom.mapping.burst_feet`), and stretches whose heights alone
   lie apart come back with a height datum of their own (`wayloom.mapping.height_datums`).
7. Where hardly any stretch agrees with the odometry, the receiver is wrong everywhere: `wayloom.mapping.heavy_tails`.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry.probability import chi_square_quantile
from wayloom.mapping.belief_doubts import Examined, examine, spread_doubts
from wayloom.mapping.burst_feet import Belief, without_feet
from wayloom.mapping.drive_types import AntennaFixes, DriveNoise, OdometryChain, ShiftedFixes
from wayloom.mapping.evidence import Evidence
from wayloom.mapping.fix_witnesses import Witnesses, witnesses_of
from wayloom.mapping.gnss_factors import RECEIVER
from wayloom.mapping.heavy_tails import heavy_tailed
from wayloom.mapping.height_datums import height_datums
from wayloom.mapping.linear_beliefs import LinearBeliefs
from wayloom.mapping.stretch_choice import choose
from wayloom.mapping.wild_fixes import wild_fixes
from wayloom.mapping.witness_graph import WitnessGraph, carried

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]
LEAST_FOR_SCATTER = 20
"""Second differences of one kind of fix from which its scatter is judged."""
WHITE_SHARES = (0.1, 0.95)
"""Bounds of the estimated white share."""
SCATTER_SLACK = 1.3
"""Times the claimed scatter from which a receiver is said to understate it."""
HEADING_RAD = 0.03
"""What the first guess's heading may be off by when neighbouring fixes are compared."""
JUMP_PROBABILITY = 1.0 - 1e-5
"""Quantile of chi-square of a difference beyond which it is a jump: a cut too many costs nothing."""
RAMP_S, RAMP_HEADING_RAD = 1.0, 0.01
"""Over how long fixes may leave the odometry without a jump, and what the first guess's heading may be off by then."""
GUARD_S = 1.0
"""Fixes so near to such ones are judged with them."""
RESTLESS_JUMPS = 3
"""Jumps within RAMP_S from which on they are one error that changes, and no coming and going."""
MAJORITY = 0.25
"""Share of the fixes' duration that must agree with the odometry for the others to be called bursts."""
LEAST_DOUBT = 0.25
"""Share of the fixes' duration under which a part that lies apart at an end is no rival."""


@dataclass(frozen=True, slots=True)
class Screening:
    """fixes as they really scatter; inlier (M,); noise_ratio by kind; shifted stretches; T_enu_node (K, 4, 4) of all nodes and
    receiver (4,) at the end of it; unconfirmed_m, unconfirmed_height_m: see `DriveSolution`; doubts (H, K, 6)
    left perturbations of the nodes by what may be wrong beside, one sigma each (`wayloom.mapping.belief_doubts`); excess: of the
    squares over their expectation; closed (V,) visits whose closures are believed."""

    fixes: AntennaFixes
    inlier: BoolArray
    noise_ratio: dict[int, float]
    shifted: tuple[ShiftedFixes, ...]
    T_enu_node: FloatArray
    receiver: FloatArray
    unconfirmed_m: float
    unconfirmed_height_m: float
    doubts: FloatArray
    excess: float
    closed: BoolArray


def screen(
    chain: OdometryChain, fixes: AntennaFixes, T_enu_node: FloatArray, noise: DriveNoise, evidence: Evidence = Evidence()
) -> Screening:
    """Judge the fixes and closures of a drive against its odometry, from a first guess T_enu_node (K, 4, 4)."""
    calm = np.flatnonzero(~wild_fixes(fixes, T_enu_node))
    screened = _of_calm(chain, fixes.take(calm), T_enu_node, noise, evidence)
    return screened if len(calm) == len(fixes) else _among_all(screened, fixes, calm)


def _among_all(screened: Screening, fixes: AntennaFixes, calm: IntArray) -> Screening:
    """The screening of the fixes in the rows calm (m,) as one of all: the others are left out."""
    covariance, share, datum = fixes.covariance.copy(), fixes.white_share.copy(), np.zeros(len(fixes), np.int64)
    covariance[calm], share[calm], datum[calm] = screened.fixes.covariance, screened.fixes.white_share, screened.fixes.datum
    inlier = np.zeros(len(fixes), bool)
    inlier[calm] = screened.inlier
    shifted = tuple(replace(part, first=int(calm[part.first]), last=int(calm[part.last])) for part in screened.shifted)
    return replace(
        screened, fixes=replace(fixes, covariance=covariance, white_share=share, datum=datum), inlier=inlier, shifted=shifted
    )


def _of_calm(chain: OdometryChain, fixes: AntennaFixes, T_enu_node: FloatArray, noise: DriveNoise, evidence: Evidence) -> Screening:
    """Judge fixes none of which is wild."""
    steps = _steps(chain, fixes, T_enu_node)
    fixes, ratios = _as_scattered(fixes, steps)
    jump = _jumps(fixes, steps)
    jump |= _ramps(chain, fixes, jump, T_enu_node, noise)
    witnesses = witnesses_of(fixes, jump, T_enu_node, noise)
    graph = WitnessGraph(chain, witnesses, noise, evidence)
    choice = choose(graph, T_enu_node)
    good, closed = np.split(choice.believed, [len(witnesses)])
    if witnesses.duration_s[good].sum() < MAJORITY * witnesses.duration_s.sum() or not good.any():
        return _of_heavy_tails(chain, fixes, T_enu_node, noise, ratios, closed)
    examined = examine(graph, choice)
    belief = Belief(witnesses.members(examined.believed, len(fixes)), closed, examined.state)
    shorter = without_feet(chain, fixes, jump, graph, evidence, belief)
    if shorter is not None:
        graph, choice = shorter
        examined, witnesses = examine(graph, choice), graph.witnesses
        good = choice.believed[: len(witnesses)]
    return _screening(chain, fixes, jump, graph, examined, good, closed, ratios)


def _screening(
    chain: OdometryChain,
    fixes: AntennaFixes,
    jump: BoolArray,
    graph: WitnessGraph,
    examined: Examined,
    good: BoolArray,
    closed: BoolArray,
    ratios: dict[int, float],
) -> Screening:
    """What an examined choice says of the fixes; good (B,) the stretches that it began with."""
    state, believed, witnesses = examined.state, examined.believed, graph.witnesses
    datum = _datums(graph, examined, jump, closed)
    offset = graph.fixes.residuals(state.T_enu_node, state.receiver)
    counted = believed | (datum[witnesses.stretch] > 0)
    T = carried(chain, graph.nodes, state.T_enu_node)
    means = witnesses.means(offset)
    lifted = np.zeros(len(fixes), np.int64)
    for first, last, number in zip(witnesses.first, witnesses.last, datum, strict=True):
        lifted[first : last + 1] = number
    return Screening(
        replace(fixes, datum=lifted),
        witnesses.members(counted, len(fixes)),
        ratios,
        _shifted(witnesses, counted, jump, offset),
        T,
        state.receiver,
        _unconfirmed_m(witnesses, good | (datum > 0), means),
        _unconfirmed_m(witnesses, good, means * [0.0, 0.0, 1.0]) if datum.any() else 0.0,
        spread_doubts(graph.nodes, examined.moved, len(T)),
        examined.excess,
        closed,
    )


def _datums(graph: WitnessGraph, examined: Examined, jump: BoolArray, closed: BoolArray) -> IntArray:
    """(B,) the height datum of each stretch."""
    witnesses, believed = graph.witnesses, graph.witnesses.sums(examined.believed.astype(np.float64)) > 0.0
    if believed.all():
        return np.zeros(len(believed), np.int64)
    linear = LinearBeliefs(graph, examined.believed, closed, examined.state)
    return height_datums(witnesses, believed, jump, linear, graph.noise.gate_probability)


def _ramps(chain: OdometryChain, fixes: AntennaFixes, jump: BoolArray, T_enu_node: FloatArray, noise: DriveNoise) -> BoolArray:
    """(M,) whether a fix lies within GUARD_S of a time of RAMP_S in which the fixes leave the odometry without a jump or by
    many. Each then stands alone, so that together they are judged as one."""
    first, out = np.arange(len(fixes)), np.zeros(len(fixes), bool)
    last = np.searchsorted(fixes.t_s, fixes.t_s + RAMP_S, side="right") - 1
    so_far = np.cumsum(jump)
    jumps: IntArray = so_far[last] - so_far
    calm, restless = (jumps == 0) & (last > first), jumps >= RESTLESS_JUMPS
    jumps_at = np.flatnonzero(jump)
    of_jumps = jumps_at[so_far[first[restless]]], jumps_at[so_far[last[restless]] - 1]
    first, last = first[calm], last[calm]
    antenna = fixes.antenna_enu(T_enu_node, np.zeros(RECEIVER))
    moved = antenna[last] - antenna[first]
    step = fixes.position_enu[last] - fixes.position_enu[first] - moved
    R = chain.T_world_node[fixes.node, :3, :3]
    turned = np.linalg.norm(R[last] - R[first], axis=(1, 2)) / np.sqrt(2.0)
    length = np.linalg.norm(moved, axis=1)
    loose = (RAMP_HEADING_RAD * length) ** 2 + (turned * (noise.lever_m + noise.time_offset_s * length / RAMP_S)) ** 2
    spread = fixes.covariance[first] + fixes.covariance[last] + loose[:, None, None] * np.eye(3)
    far = np.einsum("ni,ni->n", step, np.linalg.solve(spread, step[:, :, None])[:, :, 0]) > chi_square_quantile(JUMP_PROBABILITY, 3)
    begin = np.append(np.searchsorted(fixes.t_s, fixes.t_s[first[far]] - GUARD_S), of_jumps[0])
    end = np.append(np.searchsorted(fixes.t_s, fixes.t_s[last[far]] + GUARD_S, side="right"), of_jumps[1])
    for a, b in zip(begin.tolist(), end.tolist(), strict=True):
        out[a:b] = True
    return out


def _of_heavy_tails(
    chain: OdometryChain,
    fixes: AntennaFixes,
    T_enu_node: FloatArray,
    noise: DriveNoise,
    ratios: dict[int, float],
    closed: BoolArray,
) -> Screening:
    """No majority agrees with the odometry: every fix counts, with a variance that its residual tells."""
    tails = heavy_tailed(chain, fixes, T_enu_node, noise)
    every = {kind: ratios.get(kind, 1.0) * tails.inflation for kind in np.unique(fixes.kind).tolist()}
    nothing = np.zeros((0, len(T_enu_node), 6))
    all_of_them = np.ones(len(fixes), bool)
    return Screening(tails.fixes, all_of_them, every, (), tails.T_enu_node, tails.receiver, 0.0, 0.0, nothing, 1.0, closed)


def _steps(chain: OdometryChain, fixes: AntennaFixes, T_enu_node: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(M - 1, 3) m by how much each fix differs from the one before more than the odometry does, and (M - 1,) m travelled."""
    antenna = fixes.antenna_enu(T_enu_node, np.zeros(RECEIVER))
    moved = np.diff(antenna, axis=0)
    return np.diff(fixes.position_enu, axis=0) - moved, np.linalg.norm(moved, axis=1)


def _as_scattered(fixes: AntennaFixes, steps: tuple[FloatArray, FloatArray]) -> tuple[AntennaFixes, dict[int, float]]:
    """The fixes with the white share that their differences show, kind by kind, and covariances inflated where even wholly white
    noise of them would differ less: by as much, over the share that is white by default. How many times, by kind."""
    covariance, share, ratios = fixes.covariance.copy(), fixes.white_share.copy(), {}
    distance2 = _scatter2(fixes.covariance, steps[0])
    same = (fixes.kind[2:] == fixes.kind[1:-1]) & (fixes.kind[1:-1] == fixes.kind[:-2])
    for kind in np.unique(fixes.kind).tolist():
        rows = same & (fixes.kind[2:] == kind)
        if rows.sum() < LEAST_FOR_SCATTER:
            continue
        ratio = float(np.sqrt(np.median(distance2[rows]) / chi_square_quantile(0.5, 3)))
        share[fixes.kind == kind] = np.clip(ratio, *WHITE_SHARES)
        if ratio > SCATTER_SLACK:  # what it says is wrong, and its differences do not tell the part that changes slowly
            share[fixes.kind == kind] = fixes.white_share[fixes.kind == kind]
            inflation = ratio / fixes.white_share[fixes.kind == kind]
            ratios[kind] = float(np.median(inflation))
            covariance[fixes.kind == kind] *= inflation[:, None, None] ** 2
    return replace(fixes, covariance=covariance, white_share=share), ratios


def _scatter2(covariance: FloatArray, step: FloatArray) -> FloatArray:
    """(M - 2,) squared second differences in sigmas, were the fixes' noise white. A heading that is off leaves no second
    difference."""
    bend = np.diff(step, axis=0)
    spread = covariance[2:] + 4.0 * covariance[1:-1] + covariance[:-2]
    return np.asarray(np.einsum("ni,ni->n", bend, np.linalg.solve(spread, bend[:, :, None])[:, :, 0]))


def _whitened2(covariance: FloatArray, steps: tuple[FloatArray, FloatArray]) -> FloatArray:
    """(M - 1,) squared differences in sigmas, were the fixes' noise white and the heading as good as the guess."""
    step, moved = steps
    spread = covariance[1:] + covariance[:-1] + (HEADING_RAD * moved)[:, None, None] ** 2 * np.eye(3)
    return np.asarray(np.einsum("ni,ni->n", step, np.linalg.solve(spread, step[:, :, None])[:, :, 0]))


def _jumps(fixes: AntennaFixes, steps: tuple[FloatArray, FloatArray]) -> BoolArray:
    """(M,) whether a fix begins something new: another kind, or a place that odometry does not lead to; true for the first."""
    jump = np.ones(len(fixes), bool)
    jump[1:] = (fixes.kind[1:] != fixes.kind[:-1]) | (
        _whitened2(fixes.covariance, steps) > chi_square_quantile(JUMP_PROBABILITY, 3)
    )
    return jump


def _shifted(witnesses: Witnesses, believed: BoolArray, jump: BoolArray, offset: FloatArray) -> tuple[ShiftedFixes, ...]:
    """The fixes that lie apart, by witnesses (W,) and their offsets (W, 3) m, joined within a stretch and where no
    jump stands between them."""
    found: list[list[int]] = []
    begins = np.append(True, np.diff(witnesses.stretch) > 0) & jump[witnesses.head]
    for w in np.flatnonzero(~believed).tolist():
        if found and found[-1][-1] == w - 1 and not begins[w]:
            found[-1].append(w)
        else:
            found.append([w])
    return tuple(
        ShiftedFixes(int(witnesses.head[rows[0]]), int(witnesses.tail[rows[-1]]), np.median(offset[rows], axis=0)) for rows in found
    )


def _unconfirmed_m(witnesses: Witnesses, good: BoolArray, offset: FloatArray) -> float:
    """How far the drive would lie elsewhere if the lesser part of its fixes were right, m, root of the expected square.

    Where good fixes stand on both sides of a shifted stretch, the place is confirmed: the shift came and went. Where the fixes
    changed once and for all, or more are left out than believed, the others may be right in proportion to their duration.
    """
    duration_s = witnesses.duration_s
    rows, outside = np.flatnonzero(good), ~good
    if duration_s[good].sum() > duration_s[~good].sum():
        outside[rows[0] : rows[-1] + 1] = False
    if not outside.any():
        return 0.0
    believed, lesser = float(duration_s[good].sum()), float(duration_s[outside].sum())
    share = lesser / max(believed + lesser, 1e-9)
    if share <= LEAST_DOUBT:
        return 0.0
    return float(np.sqrt(share * (np.linalg.norm(offset[outside], axis=1) ** 2).max()))
