"""Pairwise consistency of neighbouring loops along the chain of trusted edges.

Two loops whose ends lie a few steps apart close a short cycle: i -> j by the one, j -> j' along the chain, j' -> i' by
the other, and back. What the cycle fails to close by is judged by the covariances of its four parts (Mangelson et al.,
Pairwise Consistent Measurement Set Maximization, ICRA 2018, eq. 6), of neighbours only: their cycles are short, so that
drift hides nothing. A loop that agrees with a neighbour has its vote. A short loop may also agree with the chain itself.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from wayloom.geometry import se3
from wayloom.geometry.probability import chi_square_quantile
from wayloom.mapping.block_cholesky import NotPositiveDefiniteError, block_factor
from wayloom.mapping.kernels import spatial_edges
from wayloom.mapping.pose_graph_equations import GraphEquations
from wayloom.mapping.pose_graph_types import PLANAR_ROWS

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
REACH = 12  # steps of the chain in a cycle, at most
NEIGHBOURS = 8
FEW = 30  # loops: fewer tell no scale
MARGIN = 10.0  # of chi-square: sigmas up to three times too large are taken as they are
ROUNDING = 1e-12  # of an information matrix's largest entry


@dataclass(frozen=True, slots=True)
class Chain:
    """Poses along the trusted edges k -> k + 1, and how uncertain they are.

    T_world_node (N, 4, 4) dead reckoning
    part         (N,) which unbroken chain a pose is on
    covariance   (N, 6, 6) of the left perturbation of T_world_node from the first pose on; differences are those between two poses
    length       (N,) uncertainty along the chain from the first pose on, as `lengths` of its steps
    """

    T_world_node: FloatArray
    part: IntArray
    covariance: FloatArray
    length: FloatArray


def agreeing(equations: GraphEquations, loops: BoolArray, c2: float) -> BoolArray:
    """(E + P,) those of the loops (E + P,) that close a short cycle within c2, or within less where most do far better."""
    rows, out = np.flatnonzero(loops), np.zeros(len(loops), np.bool_)
    if len(rows) == 0:
        return out
    chi2 = cycle_chi2(equations, rows)
    limit = min(c2, scaled_limit(chi2[np.isfinite(chi2)], c2, equations.block, 0.5))
    out[rows[chi2 <= limit]] = True
    return out


def scaled_limit(chi2: FloatArray, c2: float, block: int, quantile: float = 0.99) -> float:
    """Where loops are truncated when those of chi-square (L,), agreed to be right, have sigmas of another scale than they state.

    A false loop within sigmas a hundred times too large would be taken for right, and a few of them bend everything.
    """
    return MARGIN * c2 * float(np.quantile(chi2, quantile) / chi_square_quantile(quantile, block)) if len(chi2) >= FEW else c2


def plausible(equations: GraphEquations, solved: GraphEquations, state: FloatArray, c2: float) -> BoolArray:
    """(E + P,) edges that may lie within c2 of a state that some of the edges were solved for, by the covariance of its poses.

    The covariance of a difference is at most twice the sum of both poses', whatever their correlation: none is turned
    down that the exact one would let in.
    """
    errors = solved.errors(state)
    diagonal, blocks, _ = solved.normal(state, errors, np.ones(len(errors)))
    try:
        own = block_factor(solved.pattern, diagonal, blocks).diagonal_of_inverse()
    except NotPositiveDefiniteError:  # where information is indefinite there is no covariance
        return np.asarray(equations.chi2(equations.errors(state)) <= c2)
    own[solved.held] = 0.0
    T = np.concatenate([equations.poses(state), np.eye(4)[None]])
    axes = np.array(PLANAR_ROWS) if equations.planar else np.arange(6)
    Ad = se3.adjoint(se3.inverse(T[equations.second]) @ T[equations.first])[:, axes[:, None], axes]
    spread = 2.0 * (own[equations.second] + Ad @ own[equations.first] @ np.swapaxes(Ad, 1, 2))
    e = equations.errors(state)[:, :, None]
    omega_e = equations.information @ e
    inner = np.eye(equations.block) + equations.information @ spread
    d2 = (e * np.linalg.solve(inner, omega_e)).sum(axis=(1, 2))  # (C + S)^-1 = (I + Omega S)^-1 Omega
    return np.asarray(d2 <= c2)


def cycle_chi2(equations: GraphEquations, loops: IntArray) -> FloatArray:
    """(L,) least chi-square of the cycles that loops, rows (L,) of edges, close with a neighbour or the chain; inf if none."""
    covariance = left_covariances_of_edges(equations)
    chain = chain_of(equations, covariance, loops)
    first, second = equations.first[loops], equations.second[loops]
    Z, own = ahead(equations.T_first_second[loops], covariance[loops], first > second)
    ends = np.stack([np.minimum(first, second), np.maximum(first, second)], axis=1)
    best = np.full(len(loops), np.inf)
    short = np.flatnonzero((ends[:, 1] - ends[:, 0] <= REACH) & (chain.part[ends[:, 0]] == chain.part[ends[:, 1]]))
    step, step_covariance = along(chain, ends[short, 0], ends[short, 1])
    best[short] = mahalanobis2(Z[short] @ se3.inverse(step), own[short] + step_covariance, equations.planar)
    for a, b in _pairs(ends):
        keep = (chain.part[ends[a]] == chain.part[ends[b]]).all(axis=1)
        a, b = a[keep], b[keep]
        near, near_covariance = along(chain, ends[a, 0], ends[b, 0])
        far, far_covariance = along(chain, ends[a, 1], ends[b, 1])
        around = Z[a] @ far @ se3.inverse(Z[b]) @ se3.inverse(near)
        total = own[a] + moved(Z[a], far_covariance) + moved(near, own[b]) + near_covariance
        np.minimum.at(best, a, mahalanobis2(around, total, equations.planar))
    return best


def left_covariances_of_edges(equations: GraphEquations) -> FloatArray:
    """(E + P, 6, 6) of the left perturbation of what was measured."""
    omega = equations.information
    slack = ROUNDING * np.abs(omega).max(axis=(1, 2), initial=np.finfo(float).tiny)
    axes = np.array(PLANAR_ROWS) if equations.planar else np.arange(6)
    right = np.zeros((len(omega), 6, 6))
    right[:, axes[:, None], axes] = np.linalg.inv(omega + slack[:, None, None] * np.eye(equations.block))
    return moved(equations.T_first_second, right)


def chain_of(equations: GraphEquations, covariance: FloatArray, loops: IntArray) -> Chain:
    nodes = len(equations.held) - 1
    trusted = np.ones(len(equations.first), np.bool_)
    trusted[loops] = False
    low, high = np.minimum(equations.first, equations.second), np.maximum(equations.first, equations.second)
    steps = np.flatnonzero(trusted & (high == low + 1) & (high < nodes))
    edge = np.full(nodes - 1, -1)
    steps = steps[np.lexsort((lengths(covariance)[steps], low[steps]))]
    i, surest = np.unique(low[steps], return_index=True)
    edge[i] = steps[surest]
    told = np.flatnonzero(edge >= 0)
    step, spread = ahead(equations.T_first_second[edge[told]], covariance[edge[told]], equations.first[edge[told]] > told)
    T, C = np.tile(np.eye(4), (nodes, 1, 1)), np.zeros((nodes, 6, 6))
    for k, T_step in zip(told.tolist(), step, strict=True):
        T[k + 1] = T[k] @ T_step
    C[told + 1] = moved(T[told], spread)
    length = np.zeros(nodes)
    length[told + 1] = lengths(covariance)[edge[told]]
    return Chain(T, np.concatenate([[0], np.cumsum(edge < 0)]), np.cumsum(C, axis=0), np.cumsum(length))


def ahead(T: FloatArray, covariance: FloatArray, turned: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Steps (E, 4, 4) and covariances (E, 6, 6) of their left perturbations, inverted where turned (E,)."""
    Z = np.where(turned[:, None, None], se3.inverse(T), T)
    return Z, np.where(turned[:, None, None], moved(Z, covariance), covariance)


def lengths(covariance: FloatArray) -> FloatArray:
    """(E,) how uncertain edges are, by covariances (E, 6, 6): the mean of their variances, each in units of its median."""
    variance = np.diagonal(covariance, axis1=1, axis2=2)
    return np.asarray((variance / np.maximum(np.median(variance, axis=0), np.finfo(float).tiny)).mean(axis=1))


def along(chain: Chain, i: IntArray, j: IntArray) -> tuple[FloatArray, FloatArray]:
    """Steps (L, 4, 4) from poses i to j (L,) of one part, and covariances (L, 6, 6) of their left perturbations."""
    back = se3.inverse(chain.T_world_node[i])
    between = chain.covariance[np.maximum(i, j)] - chain.covariance[np.minimum(i, j)]
    return np.asarray(back @ chain.T_world_node[j]), moved(back, between)


def moved(T: FloatArray, covariance: FloatArray) -> FloatArray:
    Ad = se3.adjoint(T)
    return np.asarray(Ad @ covariance @ np.swapaxes(Ad, 1, 2))


def _pairs(ends: IntArray) -> list[tuple[IntArray, IntArray]]:
    """Loops and their nearest others, by the steps of the chain between their ends (L, 2), the nearest first."""
    k = min(NEIGHBOURS + 1, len(ends))
    steps, other = cKDTree(ends).query(ends, k=np.arange(1, k + 1), p=1, distance_upper_bound=REACH + 0.5)
    row = np.arange(len(ends))
    taken = np.isfinite(steps) & (other != row[:, None])
    return [(row[taken[:, c]], other[taken[:, c], c].astype(np.int64)) for c in range(k)]


def mahalanobis2(around: FloatArray, covariance: FloatArray, planar: bool) -> FloatArray:
    """(L,) of what cycles (L, 4, 4) fail to close by."""
    axes = np.array(PLANAR_ROWS) if planar else np.arange(6)
    rows, origin = np.arange(len(around)), np.eye(4)[None]
    xi = np.empty((len(around), 6))
    spatial_edges.fill_errors(np.concatenate([origin, around]), 0 * rows, rows + 1, np.tile(origin, (len(rows), 1, 1)), xi)
    xi = np.ascontiguousarray(xi[:, axes])
    return np.asarray((xi * np.linalg.solve(covariance[:, axes[:, None], axes], xi[:, :, None])[:, :, 0]).sum(axis=1))
