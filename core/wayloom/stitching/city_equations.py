"""Normal equations of a part of the city graph: chains of drives and meetings between them.

Poses are perturbed on the right, T <- T exp(xi). With e_k = log(T0_k^-1 T_k), what a submap is off its drive's own place, a link
of a drive's chain has the error e_k - A_k e_{k-1} (`wayloom.stitching.drive_chain`), a chain's begin e_k; a meeting has that of an
edge of a pose graph (`wayloom.mapping.kernels.spatial_edges`). A drive moved as a whole by exp(xi) has e_k = Ad(T0_k^-1) xi
exactly, however far, so that only what bends it costs.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.mapping.block_cholesky import BlockPattern, block_pattern
from wayloom.mapping.kernels import normal_equations, spatial_edges
from wayloom.mapping.pose_graph_equations import block_slots

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class CityEquations:
    """N submaps and the world as node N, which is held; N links, one to each submap, and then M meetings.

    first, second (N + M,); a link comes from the submap before it, or from the world
    T0 (N + 1, 4, 4); ahead (N, 6, 6) A of each link; T_first_second (M, 4, 4); information (N + M, 6, 6) of the errors
    """

    first: IntArray
    second: IntArray
    T0: FloatArray
    ahead: FloatArray
    T_first_second: FloatArray
    information: FloatArray
    slot: IntArray
    pairs: int
    pattern: BlockPattern

    @property
    def block(self) -> int:
        """Unknowns of a node."""
        return 6

    @property
    def links(self) -> int:
        """N."""
        return len(self.ahead)

    def errors(self, state: FloatArray) -> FloatArray:
        """(N + M, 6) at poses (N + 1, 4, 4), the world last."""
        n, out = self.links, np.empty((len(self.first), 6))
        e = self._off(state)
        out[:n] = e[:n] - (self.ahead @ e[self.first[:n], :, None])[:, :, 0]
        spatial_edges.fill_errors(state, self.first[n:], self.second[n:], self.T_first_second, out[n:])
        return out

    def chi2(self, errors: FloatArray) -> FloatArray:
        """(N + M,) of the errors."""
        out = np.empty(len(errors))
        normal_equations.fill_costs(errors, self.information, out)
        return out

    def normal(self, state: FloatArray, errors: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Diagonal (N + 1, 6, 6), blocks (pairs, 6, 6) and gradient (N + 1, 6) of half of the chi-square weighted by (N + M,)."""
        n = self.links
        by_first, by_second = np.zeros((2, len(self.first), 6, 6))
        world, own = np.full(n, n), np.arange(n)
        turned, slope = np.empty((n, 6, 6)), np.zeros((n + 1, 6, 6))
        spatial_edges.fill_jacobians(state, world, own, self.T0, self._off(state), turned, slope[:n])
        by_first[:n], by_second[:n] = -self.ahead @ slope[self.first[:n]], slope[:n]
        meeting = slice(n, len(self.first))
        spatial_edges.fill_jacobians(
            state,
            self.first[meeting],
            self.second[meeting],
            self.T_first_second,
            errors[meeting],
            by_first[meeting],
            by_second[meeting],
        )
        diagonal, blocks, gradient = np.zeros((n + 1, 6, 6)), np.zeros((self.pairs, 6, 6)), np.zeros((n + 1, 6))
        normal_equations.add_edges(
            self.first, self.second, errors, self.information, weight, by_first, by_second, self.slot, diagonal, blocks, gradient
        )
        diagonal[n], gradient[n] = np.eye(6), 0.0
        return diagonal, blocks, gradient

    def moved(self, state: FloatArray, step: FloatArray) -> FloatArray:
        """The poses after a step (N + 1, 6)."""
        return np.asarray(state @ se3.exp(step))

    def _off(self, state: FloatArray) -> FloatArray:
        """(N + 1, 6) e of each submap; 0 of the world."""
        n = self.links
        out = np.zeros((n + 1, 6))
        spatial_edges.fill_errors(state, np.full(n, n), np.arange(n), self.T0, out[:n])
        return out


def city_equations(
    before: IntArray,
    T0: FloatArray,
    ahead: FloatArray,
    information: FloatArray,
    ends: IntArray,
    T_a_b: FloatArray,
    covariance: FloatArray,
) -> CityEquations:
    """Of N submaps and M meetings.

    before      (N,) row of the submap before each in its chain, or -1 where a chain begins
    T0          (N, 4, 4); ahead and information (N, 6, 6) of the links
    ends        (M, 2) rows of the submaps that meet; T_a_b (M, 4, 4), covariance (M, 6, 6) of its left perturbation
    """
    n = len(before)
    first = np.concatenate([np.where(before < 0, n, before), ends[:, 0]]).astype(np.int64)
    second = np.concatenate([np.arange(n), ends[:, 1]]).astype(np.int64)
    held = np.arange(n + 1) == n
    rows, columns, slot = block_slots(first, second, held)
    Ad = se3.adjoint(T_a_b)
    meeting = np.swapaxes(Ad, 1, 2) @ np.linalg.inv(covariance) @ Ad
    return CityEquations(
        first,
        second,
        np.concatenate([T0, np.eye(4)[None]]),
        np.where((before < 0)[:, None, None], 0.0, ahead),
        np.ascontiguousarray(T_a_b),
        np.ascontiguousarray(np.concatenate([information, 0.5 * (meeting + np.swapaxes(meeting, 1, 2))])),
        slot,
        len(rows),
        block_pattern(n + 1, rows, columns),
    )
