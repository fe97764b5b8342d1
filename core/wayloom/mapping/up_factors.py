"""Gravity as factors: the direction of up in the camera's frame at nodes of a drive, by witnesses each of which may be biased.

A witness w (an accelerometer, the street, upright walls) says u = R^T z + b_w + n of a node with rotation R = R_enu_cam; of it the
components along the camera's x (roll) and z axes (pitch) count, as up is along -y. b_w is the witness's own lean, one for the whole
drive, an unknown with a prior; n is new with each observation. The error and its Jacobians, by gtsam's right perturbation omega
and by b:
    e = E (R^T z) + b - E u,   E hat(R^T z),   I,   E the rows x and z.
"""

from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.mapping.odometry_links import pose_key

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
ROLL_PITCH = [0, 2]


@dataclass(frozen=True, slots=True)
class UpObservations:
    """N observations of up by W witnesses, as terms of a drive's equations.

    node        (N,) row of the node
    up_node     (N, 3) unit vector in the node's camera frame
    covariance  (N, 2, 2) rad^2 of its x and z components; large where one is not seen
    witness     (N,) row of the witness
    bias_sigma  (W, 2) rad, prior of each witness's lean
    """

    node: IntArray
    up_node: FloatArray
    covariance: FloatArray
    witness: IntArray
    bias_sigma: FloatArray

    def __len__(self) -> int:
        return len(self.node)

    def at(self, nodes: IntArray) -> "UpObservations":
        """The same over some of the nodes, those of every observation among them."""
        return UpObservations(np.searchsorted(nodes, self.node), self.up_node, self.covariance, self.witness, self.bias_sigma)

    def constant(self) -> gtsam.NonlinearFactorGraph:
        """The priors of the leans."""
        graph = gtsam.NonlinearFactorGraph()
        for w, sigma in enumerate(self.bias_sigma):
            graph.add(gtsam.PriorFactorVector(lean_key(w), np.zeros(2), gtsam.noiseModel.Diagonal.Sigmas(sigma)))
        return graph

    def start(self, values: gtsam.Values) -> None:
        """No witness leans."""
        for w in range(len(self.bias_sigma)):
            values.insert(lean_key(w), np.zeros(2))

    def factors(self, T_enu_node: FloatArray, values: gtsam.Values) -> gtsam.GaussianFactorGraph:
        """The observations, linear at T_enu_node (K, 4, 4), whitened."""
        graph, unit = gtsam.GaussianFactorGraph(), gtsam.noiseModel.Unit.Create(2)
        errors, root = up_errors(self, T_enu_node, self._leans(values)), self._roots()
        by_pose = np.zeros((len(self), 2, 6))
        by_pose[:, :, :3] = root @ up_jacobians(self, T_enu_node)
        b = -(root @ errors[:, :, None])[:, :, 0]
        for k, (i, w) in enumerate(zip(self.node.tolist(), self.witness.tolist(), strict=True)):
            graph.add(gtsam.JacobianFactor(pose_key(i), by_pose[k], lean_key(w), root[k], b[k], unit))
        return graph

    def cost(self, T_enu_node: FloatArray, values: gtsam.Values) -> float:
        """Half the sum of squares of the whitened errors."""
        errors = up_errors(self, T_enu_node, self._leans(values))
        return 0.5 * float(((self._roots() @ errors[:, :, None]) ** 2).sum())

    def _leans(self, values: gtsam.Values) -> FloatArray:
        return np.array([values.atVector(lean_key(w)) for w in range(len(self.bias_sigma))]).reshape(-1, 2)

    def _roots(self) -> FloatArray:
        return np.asarray(np.swapaxes(np.linalg.cholesky(np.linalg.inv(self.covariance)), 1, 2))


def nothing_of_up() -> UpObservations:
    """No observation, no witness."""
    none = np.zeros(0, np.int64)
    return UpObservations(none, np.zeros((0, 3)), np.zeros((0, 2, 2)), none, np.zeros((0, 2)))


def lean_key(witness: int) -> int:
    """gtsam's key of a witness's lean."""
    return int(gtsam.symbol("u", witness))


def up_errors(up: UpObservations, T_enu_node: FloatArray, lean: FloatArray) -> FloatArray:
    """(N, 2) e at T_enu_node (K, 4, 4) and the leans (W, 2) rad."""
    said = up.up_node[:, ROLL_PITCH]
    return np.asarray(T_enu_node[up.node][:, 2, ROLL_PITCH] + lean[up.witness] - said)


def up_jacobians(up: UpObservations, T_enu_node: FloatArray) -> FloatArray:
    """(N, 2, 3) of e by omega of its node."""
    return np.asarray(se3.hat(T_enu_node[up.node, 2, :3])[:, ROLL_PITCH])
