"""Errors of GNSS fixes that come and go without a jump: Rao's score test of their courses.

A burst that grows from nothing is no jump, and odometry denies it as well as it holds a length and a heading over the time of its
growth. For each window of time and each share of it that is a ramp, the believed witnesses are tested for an error B beta of that
course, B (3W, 3) known, beta (3,) unknown. At the minimum, with e = antenna - fix, its Jacobian J, covariance R of the witnesses,
S = J H^-1 J^T (`wayloom.mapping.linear_beliefs`), Q = R^-1 - R^-1 S R^-1, and C (3W, 3W) by which the noise of different witnesses
is correlated over time,
    g = B^T R^-1 e,   M = B^T Q B,   N = M + B^T Q C Q B:
g has the covariance N where there is no such error, so that g^T N^-1 g is chi-square of three degrees (C. R. Rao 1948; the term of
C is H. White's correction, 1982). The error is beta = -M^-1 g, and it has moved the unknowns by H^-1 J^T R^-1 B beta.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from wayloom.mapping.linear_beliefs import LinearBeliefs
from wayloom.mapping.witness_graph import WitnessGraph

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
LENGTHS_S = (6.0, 8.0, 11.0, 16.0, 22.0, 32.0, 45.0)
STEP = 0.15
"""Lengths of the windows; each begins that share of its length after the one before."""
RAMPS = (0.2, 0.4)
"""Share of a window over which its error grows, and over which it goes."""
AXES = np.arange(3)
FORGOTTEN = 5.0
"""Correlation times over which noise has anything in common."""
LEAST_CHANGE = 0.5
"""Of a course's height, that must lie within the drive: an error that is there all the time is none that comes and goes, and how
large it would be hangs on the little by which it changes."""
LEAST_CONTROL = 1e-6
"""Share of the witnesses' information that all else must confirm for their error to be told at all."""


@dataclass(frozen=True, slots=True)
class BiasCourse:
    """An error of believed fixes: chi2 (3 degrees) of its test, the witnesses (w,) that have it, and the share (w,) of beta_m (3,)
    that each has."""

    chi2: float
    witnesses: IntArray
    share: FloatArray
    beta_m: FloatArray


def bias_courses(graph: WitnessGraph, linear: LinearBeliefs) -> list[BiasCourse]:
    """All courses that are tested, at the minimum of a choice."""
    rows = np.flatnonzero(linear.believed)
    R_inverse, t_s = np.linalg.inv(linear.covariance[rows]), graph.fixes.t_s[rows]
    g, C = np.einsum("nij,nj->ni", R_inverse, linear.error[rows]), _correlations(graph, rows)
    found: dict[int, BiasCourse] = {}
    in_passing = sorted(enumerate(_windows(graph.fixes.t_s)), key=lambda numbered: numbered[1].begin_s)  # S is solved for once
    for number, window in in_passing:
        of_rows = window.share(t_s)
        inside = np.flatnonzero(of_rows)
        if not len(inside) or np.ptp(of_rows) < LEAST_CHANGE:
            continue
        s = of_rows[inside]
        of_all = _controlled(linear, R_inverse, rows, inside, s)
        M_s = np.einsum("a,aij->ij", s, of_all[inside])
        alone = np.einsum("a,aij->ij", s**2, R_inverse[inside])
        if np.linalg.eigvalsh(M_s)[0] > LEAST_CONTROL * np.trace(alone):
            score, flat = np.einsum("a,ai->i", s, g[inside]), of_all.reshape(-1, 3)
            N_s = M_s + np.einsum("ni,nj->ij", flat, C @ flat)
            chi2, beta = float(score @ np.linalg.solve(N_s, score)), -np.linalg.solve(M_s, score)
            found[number] = BiasCourse(chi2, rows[inside], s, beta)
    return [found[number] for number in sorted(found)]


def moved_by(linear: LinearBeliefs, course: BiasCourse) -> FloatArray:
    """(K, 6) left perturbation (v, omega) of every node that frees the drive of an error of its fixes."""
    error = course.share[:, None] * course.beta_m
    pull = np.linalg.solve(linear.covariance[course.witnesses], error[:, :, None])
    return linear.moved(course.witnesses, pull.ravel())


@dataclass(frozen=True, slots=True)
class _Window:
    """A trapezoid over time: it grows and goes within a share `ramp` of its length."""

    begin_s: float
    length_s: float
    ramp: float

    def share(self, t_s: FloatArray) -> FloatArray:
        """Its height (n,) at times (n,)."""
        from_ends = np.minimum(t_s - self.begin_s, self.begin_s + self.length_s - t_s)
        return np.asarray(np.clip(from_ends / (self.ramp * self.length_s), 0.0, 1.0))


def _windows(t_s: FloatArray) -> list[_Window]:
    """Of all lengths, half of the first and last ones beyond the ends of a drive with witnesses at t_s (W,)."""
    found: list[_Window] = []
    for length in LENGTHS_S:
        for begin in np.arange(t_s[0] - 0.5 * length, t_s[-1] - 0.5 * length, STEP * length).tolist():
            found += [_Window(begin, length, ramp) for ramp in RAMPS]
    return found


def _controlled(linear: LinearBeliefs, R_inverse: FloatArray, rows: IntArray, inside: IntArray, share: FloatArray) -> FloatArray:
    """(w, 3, 3) Q B of the believed witnesses, rows (w,), for the course in which those `inside` (n,) have these shares (n,)."""
    moved = np.zeros((3 * len(linear.covariance), 3))
    for a, s in zip(inside.tolist(), share.tolist(), strict=True):
        moved += linear.columns(int(rows[a])) @ (s * R_inverse[a])
    out = -R_inverse @ moved.reshape(-1, 3, 3)[rows]
    out[inside] += share[:, None, None] * R_inverse[inside]
    return np.asarray(out)


def _correlations(graph: WitnessGraph, rows: IntArray) -> csr_array:
    """(3w, 3w) m^2 C: what the fixes' slow noise has in common at different witnesses, over some correlation times."""
    fixes, noise = graph.fixes.take(rows), graph.noise
    i, j = _near_in_time(fixes.t_s, FORGOTTEN * noise.correlation_s)
    variance = np.maximum(np.diagonal(fixes.covariance, axis1=1, axis2=2) - noise.gate_floor_m**2, 0.0)
    sigma = np.sqrt((1.0 - fixes.white_share[:, None] ** 2) * variance)
    values = sigma[i] * sigma[j] * np.exp(-np.abs(fixes.t_s[i] - fixes.t_s[j]) / noise.correlation_s)[:, None]
    where = (3 * i[:, None] + AXES).ravel(), (3 * j[:, None] + AXES).ravel()
    return csr_array((values.ravel(), where), shape=(3 * len(rows), 3 * len(rows)))


def _near_in_time(t_s: FloatArray, reach_s: float) -> tuple[IntArray, IntArray]:
    """Pairs (p,), (p,) of different ones of the times (w,), both ways round, that are less than reach_s apart."""
    order = np.argsort(t_s, kind="stable")
    sorted_s = t_s[order]
    first, behind = (np.searchsorted(sorted_s, sorted_s + side * reach_s, "right" if side < 0 else "left") for side in (-1, 1))
    count = behind - first
    i = np.repeat(np.arange(len(t_s)), count)
    j = np.arange(len(i)) - np.repeat(np.cumsum(count) - count - first, count)
    others = i != j
    return order[i[others]], order[j[others]]
