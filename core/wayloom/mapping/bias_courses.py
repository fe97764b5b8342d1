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
    t_s, rows = graph.fixes.t_s, np.flatnonzero(linear.believed)
    R_inverse = np.linalg.inv(linear.covariance[rows])
    g = np.einsum("nij,nj->ni", R_inverse, linear.error[rows])
    Q, C = _control(linear, R_inverse, rows), _correlations(graph, rows)
    found = []
    for share in _shares(t_s):
        of_rows = share[rows]
        if np.ptp(of_rows) < LEAST_CHANGE:
            continue
        inside = np.flatnonzero(of_rows)
        s = of_rows[inside]
        of_all = np.einsum("aibj,b->aij", Q[:, :, inside], s)
        M_s = np.einsum("a,aij->ij", s, of_all[inside])
        alone = np.einsum("a,aij->ij", s**2, R_inverse[inside])
        if len(inside) and np.linalg.eigvalsh(M_s)[0] > LEAST_CONTROL * np.trace(alone):
            score, flat = np.einsum("a,ai->i", s, g[inside]), of_all.reshape(-1, 3)
            N_s = M_s + np.einsum("ni,nj->ij", flat, C @ flat)
            chi2, beta = float(score @ np.linalg.solve(N_s, score)), -np.linalg.solve(M_s, score)
            found.append(BiasCourse(chi2, rows[inside], s, beta))
    return found


def moved_by(linear: LinearBeliefs, course: BiasCourse) -> FloatArray:
    """(K, 6) left perturbation (v, omega) of every node that frees the drive of an error of its fixes."""
    error = course.share[:, None] * course.beta_m
    pull = np.linalg.solve(linear.covariance[course.witnesses], error[:, :, None])
    return linear.moved(course.witnesses, pull.ravel())


def _shares(t_s: FloatArray) -> list[FloatArray]:
    """(W,) each: trapezoids over time, half of the first and last windows beyond the drive's ends."""
    found = []
    for length in LENGTHS_S:
        for begin in np.arange(t_s[0] - 0.5 * length, t_s[-1] - 0.5 * length, STEP * length).tolist():
            from_ends = np.minimum(t_s - begin, begin + length - t_s)
            found += [np.clip(from_ends / (ramp * length), 0.0, 1.0) for ramp in RAMPS]
    return found


def _control(linear: LinearBeliefs, R_inverse: FloatArray, rows: IntArray) -> FloatArray:
    """(w, 3, w, 3) Q of the believed witnesses, rows (w,)."""
    count = len(linear.covariance)
    S = linear.S.reshape(count, 3, count, 3)[rows][:, :, rows]
    Q = -np.einsum("aij,ajbk->aibk", R_inverse, np.einsum("ajbk,bkl->ajbl", S, R_inverse))
    each = np.arange(len(rows))
    Q[each, :, each, :] += R_inverse
    return np.asarray(Q)


def _correlations(graph: WitnessGraph, rows: IntArray) -> csr_array:
    """(3w, 3w) m^2 C: what the fixes' slow noise has in common at different witnesses, over some correlation times."""
    fixes, noise = graph.fixes.take(rows), graph.noise
    apart_s = np.abs(fixes.t_s[:, None] - fixes.t_s)
    i, j = np.nonzero((apart_s < FORGOTTEN * noise.correlation_s) & ~np.eye(len(rows), dtype=bool))
    variance = np.maximum(np.diagonal(fixes.covariance, axis1=1, axis2=2) - noise.gate_floor_m**2, 0.0)
    sigma = np.sqrt((1.0 - fixes.white_share[:, None] ** 2) * variance)
    values = sigma[i] * sigma[j] * np.exp(-apart_s[i, j] / noise.correlation_s)[:, None]
    where = (3 * i[:, None] + AXES).ravel(), (3 * j[:, None] + AXES).ravel()
    return csr_array((values.ravel(), where), shape=(3 * len(rows), 3 * len(rows)))
