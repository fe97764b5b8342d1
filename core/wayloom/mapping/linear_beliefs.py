"""Linear prediction of what other beliefs in a drive's fixes would cost and how far they would move it: Woodbury's identity.

At the minimum x of a choice, with normal matrix H, let e = antenna - fix (3W,) of the witnesses, J its Jacobian, R the covariance
and S = J H^-1 J^T. Witnesses E are turned over, D = R^-1 of those that come in and -R^-1 of those that leave: to first order the
cost changes by 1/2 e_E^T (D^-1 + S_EE)^-1 e_E and the unknowns by -H^-1 J_E^T (D^-1 + S_EE)^-1 e_E.
"""

from collections import OrderedDict

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array
from scipy.sparse.linalg import splu

from wayloom.geometry import se3
from wayloom.mapping.drive_equations import DriveState
from wayloom.mapping.gnss_factors import RECEIVER, antenna_jacobians
from wayloom.mapping.truncated_squares import LEAST_WEIGHT
from wayloom.mapping.witness_graph import WitnessGraph

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]
OMEGA_FIRST = [3, 4, 5, 0, 1, 2]
MOST_TURNED = 66
"""Witnesses that may be turned over at once: so few that no BLAS splits the work among threads, which changes the last bits."""
HELD_BYTES = 64 * 2**20
"""Of S, at most, beside what MOST_TURNED witnesses need."""


class LinearBeliefs:
    """The equations of a choice at its minimum, with the witnesses and visits that count, (W,) and (V,) of a graph over K nodes."""

    def __init__(self, graph: WitnessGraph, witnesses: BoolArray, visits: BoolArray, at: DriveState) -> None:
        importance = graph.importance[graph.witnesses.stretch]
        self.at, self.believed = at, witnesses
        self.covariance = np.asarray(graph.fixes.covariance / importance[:, None, None])
        self.error = -graph.fixes.residuals(at.T_enu_node, at.receiver)
        weights = np.where(witnesses, 1.0, LEAST_WEIGHT) * importance, np.where(visits, 1.0, LEAST_WEIGHT)
        A = _information_root(graph, weights, at)
        self.first_pose = A.shape[1] - 6 * len(at.T_enu_node)  # gtsam orders receiver, scales, leans, poses
        self._J = self._jacobian(graph, A.shape[1])
        self._factor = splu(csc_array(A.T @ A), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        self._columns = OrderedDict[int, FloatArray]()
        self._most_held = max(MOST_TURNED, HELD_BYTES // (8 * 9 * max(len(self.covariance), 1)))

    def columns(self, witness: int) -> FloatArray:
        """(3W, 3) columns of S of a witness. Those that were asked for last are held; all together would be the square of a drive's
        length."""
        if witness in self._columns:
            self._columns.move_to_end(witness)
            return self._columns[witness]
        found = np.asarray(self._J @ self._factor.solve(self._J[3 * witness : 3 * witness + 3].T.toarray()))
        self._columns[witness] = found
        if len(self._columns) > self._most_held:
            self._columns.popitem(last=False)
        return found

    def between(self, witnesses: IntArray) -> FloatArray:
        """(3w, 3w) S of witnesses (w,) among each other."""
        rows = _rows(witnesses)
        return np.hstack([np.zeros((len(rows), 0)), *(self.columns(one)[rows] for one in witnesses.tolist())])

    def _jacobian(self, graph: WitnessGraph, unknowns: int) -> csc_array:
        """(3W, n) of the errors by all unknowns in the order of the columns."""
        by_pose, by_receiver = antenna_jacobians(graph.fixes, self.at.T_enu_node, self.at.receiver)
        count = len(graph.fixes)
        row = np.broadcast_to(np.arange(3 * count).reshape(count, 3, 1), by_pose.shape)
        pose = np.broadcast_to((self.first_pose + 6 * graph.fixes.node[:, None] + np.arange(6))[:, None], by_pose.shape)
        receiver = np.broadcast_to(np.arange(RECEIVER), by_receiver.shape)
        rows = np.concatenate([row.ravel(), row[:, :, :RECEIVER].ravel()])
        columns = np.concatenate([pose.ravel(), receiver.ravel()])
        values = np.concatenate([by_pose.ravel(), by_receiver.ravel()])
        return csc_array((values, (rows, columns)), shape=(3 * count, unknowns)).tocsr()

    def turned(self, witnesses: IntArray) -> tuple[float, FloatArray]:
        """Change of the cost where these witnesses (w,) are turned over, and the pull (3w,) that does it."""
        middle = self.between(witnesses).reshape(len(witnesses), 3, len(witnesses), 3)
        sign = np.where(self.believed[witnesses], -1.0, 1.0)
        each = np.arange(len(witnesses))
        middle[each, :, each, :] += sign[:, None, None] * self.covariance[witnesses]
        error = self.error[witnesses].ravel()
        pull = np.linalg.solve(middle.reshape(len(error), len(error)), error)
        return 0.5 * float(error @ pull), np.asarray(pull)

    def with_errors(self, error_m: FloatArray) -> float:
        """Change of the cost where the fixes of believed witnesses have errors (W, 3) m that are taken out."""
        witnesses = np.flatnonzero(self.believed & error_m.any(axis=1))
        if not len(witnesses):
            return 0.0
        c = error_m[witnesses]
        weighted = np.linalg.solve(self.covariance[witnesses], c[:, :, None])[:, :, 0]
        pull = weighted.ravel()
        gain = float(np.einsum("ni,ni->", weighted, self.error[witnesses] + 0.5 * c))
        return gain - 0.5 * float(pull @ (self.between(witnesses) @ pull))

    def whitened(self, witnesses: IntArray, column: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(3w,) errors of witnesses (w,) that are not believed, and a column (3w,), over the root of the errors' covariance."""
        covariance = self.between(witnesses).reshape(len(witnesses), 3, len(witnesses), 3)
        each = np.arange(len(witnesses))
        covariance[each, :, each, :] += self.covariance[witnesses]
        root = np.linalg.cholesky(covariance.reshape(3 * len(witnesses), 3 * len(witnesses)))
        both = np.linalg.solve(root, np.column_stack([self.error[witnesses].ravel(), column]))
        return both[:, 0], both[:, 1]

    def moved(self, witnesses: IntArray, pull: FloatArray) -> FloatArray:
        """(K, 6) left perturbation (v, omega) of every node by the pull (3w,) of witnesses (w,)."""
        unknowns = -self._factor.solve(self._J[_rows(witnesses)].T @ pull)
        right = unknowns[self.first_pose :].reshape(-1, 6)[:, OMEGA_FIRST]
        return np.asarray(np.einsum("nij,nj->ni", se3.adjoint(self.at.T_enu_node), right))


def _information_root(graph: WitnessGraph, weights: tuple[FloatArray, FloatArray], at: DriveState) -> csc_array:
    """(m, n) A of the normal equations A^T A, in gtsam's natural order of keys."""
    rows, columns, values = graph.weighted(*weights).linear(at).sparseJacobian_()
    of_unknowns = columns < columns.max()  # the last column is the right side
    where = rows[of_unknowns].astype(np.int64) - 1, columns[of_unknowns].astype(np.int64) - 1
    return csc_array((values[of_unknowns], where))


def _rows(witnesses: IntArray) -> IntArray:
    return np.asarray((3 * witnesses[:, None] + np.arange(3)).ravel())
