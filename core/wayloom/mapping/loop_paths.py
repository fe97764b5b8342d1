"""Consistency of loops with the surest way between their ends, over odometry and loops that are believed already.

Loops that agree with their neighbours may still be false all together: two streets that look alike. So they are believed in
rounds, those first between whose ends the surest way is short; what that way and the loop fail to close by is judged by the
covariances of all steps on the cycle. Each loop that is believed shortens other ways, so that nothing is judged by a long way
while a shorter one may still come. Where the cycles of believed loops close far better than their covariances say, these
are too wide, and later loops are judged by less. Compare Y. Latif, C. Cadena, J. Neira: Robust loop closing over time for
pose graph SLAM, IJRR 2013.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.mapping.kernels import shortest_paths
from wayloom.mapping.loop_votes import (
    REACH,
    Chain,
    along,
    chain_of,
    left_covariances_of_edges,
    lengths,
    mahalanobis2,
    moved,
    scaled_limit,
)
from wayloom.mapping.pose_graph_equations import GraphEquations

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
GROWTH = 1.5  # of the longest way, from round to round
SCOUTS = 8  # one loop in so many is judged by long ways
OPEN, BELIEVED, REFUSED = 0, 1, -1


@dataclass(frozen=True, slots=True)
class Steps:
    """S steps between nodes, each to be gone in both directions.

    first, second (S,); T_first_second (S, 4, 4); covariance (S, 6, 6) of its left perturbation; length (S,)
    """

    first: IntArray
    second: IntArray
    T_first_second: FloatArray
    covariance: FloatArray
    length: FloatArray

    def of(self, rows: IntArray) -> "Steps":
        """Some of them."""
        return Steps(self.first[rows], self.second[rows], self.T_first_second[rows], self.covariance[rows], self.length[rows])

    def and_of(self, other: "Steps") -> "Steps":
        """Both."""
        return Steps(*(np.concatenate([getattr(self, name), getattr(other, name)]) for name in Steps.__slots__))


def closing(equations: GraphEquations, loops: BoolArray, candidates: BoolArray, c2: float) -> BoolArray:
    """(E + P,) those of the candidates (E + P,), some of the loops (E + P,), that the surest way closes within c2."""
    rows, out = np.flatnonzero(candidates), np.zeros(len(loops), np.bool_)
    if len(rows) == 0:
        return out
    covariance = left_covariances_of_edges(equations)
    chain = chain_of(equations, covariance, np.flatnonzero(loops))
    node, end = np.unique(np.stack([equations.first[rows], equations.second[rows]]), return_inverse=True)
    odometry = _stretches(chain, node)
    first, second = end.reshape(2, -1)
    steps = Steps(first, second, equations.T_first_second[rows], covariance[rows], lengths(covariance)[rows])
    verdict, _ = believed(odometry, steps, len(node), c2, equations.planar)
    out[rows[verdict != REFUSED]] = True
    return out


def believed(trusted: Steps, loops: Steps, nodes: int, c2: float, planar: bool = False) -> tuple[IntArray, FloatArray]:
    """Verdict (k,) on each of the loops, BELIEVED, REFUSED, or OPEN where no way joins its ends; and chi-square (k,) of its cycle.

    Lengths are in units of a typical step's variance; short ways are GROWTH times REACH of them long. At each greater length one
    loop in SCOUTS is judged; its neighbours follow by the short ways that it opens, which is quicker, and surer. At last all are.
    """
    verdict, chi2 = np.full(len(loops.first), OPEN), np.full(len(loops.first), np.nan)
    near, every = GROWTH * REACH, float(trusted.length.sum() + loops.length.sum())
    longest = near
    while (verdict == OPEN).any():
        for share, most in ((1, near), (1 if longest == np.inf else SCOUTS, longest)):
            left = np.flatnonzero(verdict == OPEN)[::share]
            steps = trusted.and_of(loops.of(np.flatnonzero(verdict == BELIEVED)))
            reached, T, total = _ways(loops.of(left), steps, nodes, most)
            judged = left[reached]
            around = loops.T_first_second[judged] @ se3.inverse(T[reached])
            chi2[judged] = mahalanobis2(around, loops.covariance[judged] + total[reached], planar)
            limit = min(c2, scaled_limit(chi2[chi2 <= c2], c2, 3 if planar else 6, 0.5))
            verdict[judged] = np.where(chi2[judged] <= limit, BELIEVED, REFUSED)
        if longest == np.inf:
            break
        longest = GROWTH * longest if longest < every else np.inf
    return verdict, chi2


def _stretches(chain: Chain, node: IntArray) -> Steps:
    """The odometry between consecutive nodes of one part of the chain, as one step each."""
    joined = np.flatnonzero(chain.part[node[:-1]] == chain.part[node[1:]])
    T, covariance = along(chain, node[joined], node[joined + 1])
    return Steps(joined, joined + 1, T, covariance, chain.length[node[joined + 1]] - chain.length[node[joined]])


def _ways(loops: Steps, steps: Steps, nodes: int, longest: float) -> tuple[BoolArray, FloatArray, FloatArray]:
    """Which of the loops (k,) a way of these steps closes, and along it T_first_second (k, 4, 4) and its covariance (k, 6, 6)."""
    k = len(loops.first)
    tail, head = np.concatenate([steps.first, steps.second]), np.concatenate([steps.second, steps.first])
    back = se3.inverse(steps.T_first_second)
    order = np.argsort(tail, kind="stable")
    reached, T, total = np.zeros(k, np.bool_), np.tile(np.eye(4), (k, 1, 1)), np.zeros((k, 6, 6))
    shortest_paths.fill_paths(
        loops.first,
        loops.second,
        np.searchsorted(tail[order], np.arange(nodes + 1)),
        head[order],
        order,
        np.tile(steps.length, 2),
        np.concatenate([steps.T_first_second, back]),
        np.concatenate([steps.covariance, moved(back, steps.covariance)]),
        longest,
        reached,
        T,
        total,
    )
    return reached, T, total
