"""Stretches of GNSS fixes between jumps, and the witnesses in them: means of neighbouring fixes."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry.probability import chi_square_quantile
from wayloom.mapping.drive_types import AntennaFixes, DriveNoise
from wayloom.mapping.gnss_factors import RECEIVER

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]
STRETCH_S = 20.0
RESTLESS_S = 2.0
"""Neighbouring stretches that are all shorter than this are one: a reflected signal that wanders jumps again and again."""
WITNESS_S = (0.4, 0.8, 1.6, 3.2)
"""Durations of the witnesses from each end of a stretch inwards, s; the last one repeats."""
PRICE_S = 1.0
"""Added to the price of a stretch for each second that it lasts: of two parts the longer is believed."""
IMPORTANT_S, LEAST_IMPORTANCE = 2.0, 0.05
"""A stretch counts in full from this duration on; a fix that is alone between two jumps counts the least share."""


@dataclass(frozen=True, slots=True)
class Witnesses:
    """W means of neighbouring fixes, in time order, and the B stretches that they belong to.

    fixes        the middle fix of each witness with the mean of all, and the covariance of that
    stretch      (W,) row of the stretch
    head, tail   (W,) rows of the fixes of each witness, inclusive
    first, last  (B,) rows of the fixes of each stretch, inclusive
    cut          (B,) whether nothing but its length parts the stretch from the one before: no jump
    price        (B,) twice what leaving it out costs; duration_s (B,)
    importance   (B,) 0 to 1: share of its information that counts: a fix that is alone between two jumps is no witness of a second
    """

    fixes: AntennaFixes
    stretch: IntArray
    head: IntArray
    tail: IntArray
    first: IntArray
    last: IntArray
    cut: BoolArray
    price: FloatArray
    duration_s: FloatArray
    importance: FloatArray

    def __len__(self) -> int:
        return len(self.first)

    def sums(self, of_witness: FloatArray) -> FloatArray:
        """(B,) sums over the witnesses (W,) of each stretch."""
        return np.asarray(np.bincount(self.stretch, of_witness, len(self.first)), np.float64)

    def members(self, of_witness: BoolArray, count: int) -> BoolArray:
        """(count,) of all fixes, those of the witnesses (W,) that are true."""
        out = np.zeros(count, bool)
        for head, tail in zip(self.head[of_witness], self.tail[of_witness], strict=True):
            out[head : tail + 1] = True
        return out

    def means(self, of_witness: FloatArray) -> FloatArray:
        """(B, 3) means over the witnesses (W, 3) of each stretch."""
        count = np.bincount(self.stretch, minlength=len(self.first))
        return np.stack([self.sums(column) / count for column in of_witness.T], axis=1)


def witnesses_of(fixes: AntennaFixes, jump: BoolArray, T_enu_node: FloatArray, noise: DriveNoise) -> Witnesses:
    """Cut the fixes at jumps and every STRETCH_S, and each stretch into witnesses."""
    starts, parts = _starts(fixes, jump), []
    ends = np.append(starts[1:], len(fixes)) - 1
    for row, (first, last) in enumerate(zip(starts.tolist(), ends.tolist(), strict=True)):
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
    price = chi_square_quantile(noise.gate_probability, 3 * np.bincount(stretch)) + PRICE_S * duration
    return Witnesses(
        replace(taken, position_enu=taken.position_enu + offset, covariance=spread), stretch, a, b, starts, ends,
        ~jump[starts], price, duration, np.clip(duration / IMPORTANT_S, LEAST_IMPORTANCE, 1.0),
    )  # fmt: skip


def _starts(fixes: AntennaFixes, jump: BoolArray) -> IntArray:
    """(B,) the first fix of each stretch: at jumps, but for those among nothing but jumps, and where the stretch grows too long."""
    jumps, t_s = np.flatnonzero(jump), fixes.t_s
    restless = t_s[np.append(jumps[1:], len(t_s)) - 1] - t_s[jumps] < RESTLESS_S
    alike = fixes.kind[jumps[1:]] == fixes.kind[jumps[:-1]]
    begins = set(jumps[np.append(True, ~(restless[1:] & restless[:-1] & alike))].tolist())
    starts = [0]
    for k in range(1, len(t_s)):
        if k in begins or t_s[k] - t_s[starts[-1]] > STRETCH_S:
            starts.append(k)
    return np.array(starts, np.int64)


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
