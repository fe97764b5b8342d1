"""Screening of GNSS fixes: how much they scatter, where they jump, and which stretches of them lie apart from the drive.

GNSS errors come in stretches (a reflected signal, a wrong integer), not fix by fix; so fixes are judged by *stretches*, runs
without a jump of at most STRETCH_S. Odometry is good to millimetres from fix to fix: a jump between two fixes that it does not
show begins a new stretch.

1. Scatter: the differences of neighbouring fixes against the odometry's say how much a receiver's fixes really scatter. Where that
   is more than white noise of the claimed covariance, the covariance is inflated by it (median: up to half of the fixes may be
   wild).
2. Jumps: differences beyond the gate of the noise so found cut the fixes into stretches, and each stretch into *witnesses*, the
   means of few fixes near its ends and of more inside: a jump is only seen where both sides are near by, as the odometry's scale
   may explain the same distance over a hundred metres.
3. Stretches: truncated least squares with one weight a stretch, on a graph of the odometry with its slowly varying scale, the
   receiver's time offset and lever arm, by graduated non-convexity (Yang et al., RA-L 2020). A stretch is left out for a price: the
   quantile of chi-square of its witnesses, and PRICE_S for each second, so that of two parts that contradict each other the longer
   is believed. It starts at the first guess; a second descent, which begins by leaving out what the guess itself denies, competes
   with it, and the lower cost wins (`truncated_squares`): the result is never worse than what the first guess says.
4. Loop closures are judged in the same squares, each visit's against a price of their own: they unmask stretches that lie apart,
   and those that contradict odometry and fixes are left out.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from wayloom.geometry import se3
from wayloom.mapping.drive_equations import DriveEquations, DriveState, IndependentFixes
from wayloom.mapping.drive_types import AntennaFixes, DriveNoise, OdometryChain, ShiftedFixes
from wayloom.mapping.evidence import Evidence
from wayloom.mapping.gnss_factors import RECEIVER
from wayloom.mapping.loop_factors import LoopTerms
from wayloom.mapping.odometry_links import links_of
from wayloom.mapping.truncated_squares import LEAST_WEIGHT, lowest

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]
STRETCH_S = 20.0
WITNESS_S = (0.4, 0.8, 1.6, 3.2)
"""Durations of the witnesses from each end of a stretch inwards, s; the last one repeats."""
PRICE_S = 1.0
"""Added to the price of a stretch for each second that it lasts: of two parts the longer is believed."""
IMPORTANT_S, LEAST_IMPORTANCE = 2.0, 0.05
"""A stretch counts in full from this duration on; a fix that is alone between two jumps counts the least share."""
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
LEAST_DOUBT = 0.25
"""Share of the fixes' duration under which a part that lies apart at an end is no rival."""


@dataclass(frozen=True, slots=True)
class Screening:
    """fixes as they really scatter; inlier (M,); noise_ratio by kind; shifted stretches; T_enu_node
    (K, 4, 4) of all nodes and receiver (4,) at the end of it; unconfirmed_m: see `DriveSolution`; closed (V,) visits whose
    closures are believed."""

    fixes: AntennaFixes
    inlier: BoolArray
    noise_ratio: dict[int, float]
    shifted: tuple[ShiftedFixes, ...]
    T_enu_node: FloatArray
    receiver: FloatArray
    unconfirmed_m: float
    closed: BoolArray


@dataclass(frozen=True, slots=True)
class Witnesses:
    """W means of neighbouring fixes, in time order, and the B stretches that they belong to.

    fixes        the middle fix of each witness with the mean of all, and the covariance of that
    stretch      (W,) row of the stretch
    first, last  (B,) rows of the fixes of each stretch, inclusive
    price        (B,) twice what leaving it out costs; duration_s (B,)
    importance   (B,) 0 to 1: share of its information that counts: a fix that is alone between two jumps is no witness of a second
    """

    fixes: AntennaFixes
    stretch: IntArray
    first: IntArray
    last: IntArray
    price: FloatArray
    duration_s: FloatArray
    importance: FloatArray

    def __len__(self) -> int:
        return len(self.first)

    def sums(self, of_witness: FloatArray) -> FloatArray:
        """(B,) sums over the witnesses (W,) of each stretch."""
        return np.asarray(np.bincount(self.stretch, of_witness, len(self.first)), np.float64)

    def means(self, of_witness: FloatArray) -> FloatArray:
        """(B, 3) means over the witnesses (W, 3) of each stretch."""
        count = np.bincount(self.stretch, minlength=len(self.first))
        return np.stack([self.sums(column) / count for column in of_witness.T], axis=1)


def screen(
    chain: OdometryChain, fixes: AntennaFixes, T_enu_node: FloatArray, noise: DriveNoise, evidence: Evidence = Evidence()
) -> Screening:
    """Judge the fixes and closures of a drive against its odometry, from a first guess T_enu_node (K, 4, 4)."""
    steps = _steps(chain, fixes, T_enu_node)
    fixes, ratios = _as_scattered(fixes, steps)
    jump = _jumps(fixes, steps)
    witnesses = _witnesses(fixes, jump, T_enu_node, noise)
    graph = _WitnessGraph(chain, witnesses, noise, evidence)
    weight, state = lowest(graph, T_enu_node)
    good, closed = np.split(weight > 0.5, [len(witnesses)])
    if not good.any():  # nothing agrees with the odometry: believe the fixes
        good[:] = True
    inlier = np.zeros(len(fixes), bool)
    for first, last in zip(witnesses.first[good], witnesses.last[good], strict=True):
        inlier[first : last + 1] = True
    offset = witnesses.means(graph.fixes.residuals(state.T_enu_node, state.receiver))
    shifted = _shifted(witnesses, good, jump, offset)
    T = carried(chain, graph.nodes, state.T_enu_node)
    return Screening(fixes, inlier, ratios, shifted, T, state.receiver, _unconfirmed_m(witnesses, good, offset), closed)


def carried(chain: OdometryChain, nodes: IntArray, T_enu_coarse: FloatArray) -> FloatArray:
    """(K, 4, 4) all nodes, each carried by the last of `nodes` before it."""
    before = np.searchsorted(nodes, np.arange(len(chain.T_world_node)), side="right") - 1
    T_enu_world = T_enu_coarse @ se3.inverse(chain.T_world_node[nodes])
    return np.asarray(T_enu_world[before] @ chain.T_world_node)


def _steps(chain: OdometryChain, fixes: AntennaFixes, T_enu_node: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(M - 1, 3) m by how much each fix differs from the one before more than the odometry does, and (M - 1,) m travelled."""
    antenna = fixes.antenna_enu(T_enu_node, np.zeros(RECEIVER))
    moved = np.diff(antenna, axis=0)
    return np.diff(fixes.position_enu, axis=0) - moved, np.linalg.norm(moved, axis=1)


def _as_scattered(fixes: AntennaFixes, steps: tuple[FloatArray, FloatArray]) -> tuple[AntennaFixes, dict[int, float]]:
    """The fixes with the white share that their differences show, kind by kind, and covariances inflated where even wholly white
    noise of them would differ less. How many times less, by kind."""
    covariance, share, ratios = fixes.covariance.copy(), fixes.white_share.copy(), {}
    distance2 = _scatter2(fixes.covariance, steps[0])
    same = (fixes.kind[2:] == fixes.kind[1:-1]) & (fixes.kind[1:-1] == fixes.kind[:-2])
    for kind in np.unique(fixes.kind).tolist():
        rows = same & (fixes.kind[2:] == kind)
        if rows.sum() < LEAST_FOR_SCATTER:
            continue
        ratio = float(np.sqrt(np.median(distance2[rows]) / chi2.ppf(0.5, 3)))
        share[fixes.kind == kind] = np.clip(ratio, *WHITE_SHARES)
        if ratio > SCATTER_SLACK:
            ratios[kind] = ratio
            covariance[fixes.kind == kind] *= ratio**2
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
    jump[1:] = (fixes.kind[1:] != fixes.kind[:-1]) | (_whitened2(fixes.covariance, steps) > chi2.ppf(JUMP_PROBABILITY, 3))
    return jump


def _witnesses(fixes: AntennaFixes, jump: BoolArray, T_enu_node: FloatArray, noise: DriveNoise) -> Witnesses:
    """Cut the fixes at jumps and every STRETCH_S, and each stretch into witnesses."""
    starts, parts = [0], []
    for k in range(1, len(fixes)):
        if jump[k] or fixes.t_s[k] - fixes.t_s[starts[-1]] > STRETCH_S:
            starts.append(k)
    ends = np.append(np.array(starts[1:], np.int64), len(fixes)) - 1
    for row, (first, last) in enumerate(zip(starts, ends.tolist(), strict=True)):
        parts += [(row, first + a, first + b) for a, b in _cuts(fixes.t_s[first : last + 1])]
    stretch, a, b = np.array(parts, np.int64).reshape(-1, 3).T
    middle, count = (a + b) // 2, (b - a + 1).astype(np.float64)
    residual = fixes.residuals(T_enu_node, np.zeros(RECEIVER))
    offset = np.array([np.median(residual[i : j + 1], axis=0) for i, j in zip(a, b, strict=True)]) - residual[middle]
    white2 = fixes.white_share[middle] ** 2
    share = white2 / count + (1.0 - white2)
    spread = share[:, None, None] * fixes.covariance[middle] + noise.gate_floor_m**2 * np.eye(3)
    taken = fixes.take(middle)
    duration = fixes.t_s[ends] - fixes.t_s[starts]
    price = chi2.ppf(noise.gate_probability, 3 * np.bincount(stretch)) + PRICE_S * duration
    return Witnesses(
        replace(taken, position_enu=taken.position_enu + offset, covariance=spread), stretch, np.array(starts, np.int64), ends,
        price, duration, np.clip(duration / IMPORTANT_S, LEAST_IMPORTANCE, 1.0),
    )  # fmt: skip


def _cuts(t_s: FloatArray) -> list[tuple[int, int]]:
    """First and last (inclusive) of the witnesses of a stretch of fixes at t_s (n,): short ones near both ends."""
    head, tail, low, high = [], [], 0, len(t_s) - 1
    for step in range(len(t_s)):
        width = WITNESS_S[min(step, len(WITNESS_S) - 1)]
        if t_s[high] - t_s[low] <= 2.0 * width:
            break
        to = low + int(np.searchsorted(t_s[low:high], t_s[low] + width))
        back = high - int(np.searchsorted(-t_s[low : high + 1][::-1], -t_s[high] + width)) + 1
        head.append((low, max(to - 1, low)))
        tail.append((min(back, high), high))
        low, high = head[-1][1] + 1, tail[-1][0] - 1
        if low > high:
            break
    return head + ([(low, high)] if low <= high else []) + tail[::-1]


class _WitnessGraph:
    """Witnesses, closures and odometry over the nodes that they are seen from."""

    def __init__(self, chain: OdometryChain, witnesses: Witnesses, noise: DriveNoise, evidence: Evidence) -> None:
        ends, lost = np.array([0, len(chain.T_world_node) - 1], np.int64), np.flatnonzero(~chain.connected)
        self.chain, self.witnesses, self.noise = chain, witnesses, noise
        self.nodes = np.unique(np.concatenate([ends, witnesses.fixes.node, lost, lost + 1, chain.level, evidence.nodes()]))
        self.evidence = evidence.at(self.nodes)
        self.price = np.concatenate([witnesses.price, evidence.loops.price(noise.gate_probability)])
        self.importance = np.concatenate([witnesses.importance, np.ones(evidence.loops.visits)])
        self.heard = np.arange(len(witnesses), len(self.price))
        self.coarse = coarse_chain(chain, self.nodes)
        self.links = links_of(self.coarse, noise)
        self.fixes = replace(witnesses.fixes, node=np.searchsorted(self.nodes, witnesses.fixes.node))

    def equations(self, weight: FloatArray) -> DriveEquations:
        """With the weight (B + V,), 0 to 1, of each stretch's and each visit's information."""
        of_fixes, of_loops = np.split(np.maximum(weight, LEAST_WEIGHT) * self.importance, [len(self.witnesses)])
        fixes = IndependentFixes(self.fixes, of_fixes[self.witnesses.stretch])
        terms = (LoopTerms(self.evidence.loops, of_loops), self.evidence.up)
        return DriveEquations(self.coarse, self.links, fixes, self.noise, terms)

    def solve(self, weight: FloatArray, start: DriveState, solves: int) -> DriveState:
        """Descend from a state."""
        return self.equations(weight).descend(start, solves)

    def distance2(self, at: DriveState) -> FloatArray:
        """(B + V,) of each stretch the sum of its witnesses' squared distances from the antenna, in their sigmas; of each visit its
        own."""
        residual = self.fixes.residuals(at.T_enu_node, at.receiver)
        of_witness = np.einsum("ni,ni->n", residual, np.linalg.solve(self.fixes.covariance, residual[:, :, None])[:, :, 0])
        return np.concatenate([self.witnesses.sums(of_witness), self.evidence.loops.distance2(at.T_enu_node)])

    def rivals(self, part: int) -> list[IntArray]:
        """Of a visit's closures: the stretches of fixes at its earlier end, or those at its later one, may be wrong."""
        loops = self.evidence.loops
        rows = loops.visit == part - len(self.witnesses)
        last = len(self.witnesses.stretch) - 1
        after = [np.searchsorted(self.fixes.node, ends[rows]) for ends in (loops.first, loops.second)]
        return [np.unique(self.witnesses.stretch[np.clip(np.concatenate([k - 1, k]), 0, last)]) for k in after]

    def truncated_cost(self, at: DriveState) -> float:
        """Half the truncated squares of stretches and visits plus what all else costs."""
        distance2 = self.distance2(at)
        others = self.equations(np.ones(len(self.price))).cost(at) - 0.5 * float(self.importance @ distance2)
        return others + 0.5 * float(self.importance @ np.minimum(distance2, self.price))


def coarse_chain(chain: OdometryChain, nodes: IntArray) -> OdometryChain:
    """The chain over some of its nodes, both ends among them."""
    road = np.concatenate([[0.0], np.cumsum(chain.length_m)])
    breaks = np.concatenate([[0], np.cumsum(~chain.connected)])
    level = np.flatnonzero(np.isin(nodes, chain.level))
    return OdometryChain(chain.T_world_node[nodes], np.diff(road[nodes]), np.diff(breaks[nodes]) == 0, level)


def _shifted(witnesses: Witnesses, good: BoolArray, jump: BoolArray, offset: FloatArray) -> tuple[ShiftedFixes, ...]:
    """The stretches of fixes that lie apart, joined where no jump stands between them."""
    found: list[list[int]] = []
    for b in np.flatnonzero(~good).tolist():
        if found and found[-1][-1] == b - 1 and not jump[witnesses.first[b]]:
            found[-1].append(b)
        else:
            found.append([b])
    return tuple(
        ShiftedFixes(int(witnesses.first[rows[0]]), int(witnesses.last[rows[-1]]), np.median(offset[rows], axis=0))
        for rows in found
    )


def _unconfirmed_m(witnesses: Witnesses, good: BoolArray, offset: FloatArray) -> float:
    """How far the drive would lie elsewhere if the lesser part of its fixes were right, m, root of the expected square.

    Where good fixes stand on both sides of a shifted stretch, the place is confirmed: the shift came and went. Where the fixes
    changed once and for all, the greater part is believed, but the lesser may be right in proportion to its duration.
    """
    rows = np.flatnonzero(good)
    outside = np.ones(len(good), bool)
    outside[rows[0] : rows[-1] + 1] = False
    if not outside.any():
        return 0.0
    believed, lesser = float(witnesses.duration_s[good].sum()), float(witnesses.duration_s[outside].sum())
    share = lesser / max(believed + lesser, 1e-9)
    if share <= LEAST_DOUBT:
        return 0.0
    return float(np.sqrt(share * (np.linalg.norm(offset[outside], axis=1) ** 2).max()))
