"""Inputs, noise model and solution of the drive's factor graph."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class OdometryChain:
    """The nodes of a drive in time order.

    T_world_node  (K, 4, 4) by the odometry
    length_m      (K - 1,) metres of road from each node to the next
    connected     (K - 1,) false where the track was lost between the two
    level         (k,) rows of the nodes that get a level prior
    """

    T_world_node: FloatArray
    length_m: FloatArray
    connected: BoolArray
    level: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class AntennaFixes:
    """GNSS fixes, each seen from a node.

    t_s           (M,) increasing, s
    node          (M,) row of the node
    p_node_gnss   (M, 3) m, the antenna at the time of the fix in the node's camera frame
    position_enu  (M, 3) m
    covariance    (M, 3, 3) m^2
    """

    t_s: FloatArray
    node: NDArray[np.int64]
    p_node_gnss: FloatArray
    position_enu: FloatArray
    covariance: FloatArray

    def __len__(self) -> int:
        return len(self.t_s)

    def take(self, rows: NDArray[np.int64]) -> "AntennaFixes":
        """The fixes of these rows."""
        return AntennaFixes(self.t_s[rows], self.node[rows], self.p_node_gnss[rows], self.position_enu[rows], self.covariance[rows])

    def residuals(self, T_enu_node: FloatArray) -> FloatArray:
        """(M, 3) m: fix minus antenna."""
        T = T_enu_node[self.node]
        antenna = np.einsum("nij,nj->ni", T[:, :3, :3], self.p_node_gnss) + T[:, :3, 3]
        return np.asarray(self.position_enu - antenna)


@dataclass(frozen=True, slots=True)
class DriveNoise:
    """Sigmas, explained in `wayloom.mapping.drive_graph`: m and rad, for one metre of road where they grow; scale_sigma a share."""

    position_m: float
    rotation_rad: float
    standing_position_m: float
    standing_rotation_rad: float
    scale_sigma: float
    scale_length_m: float
    level_rad: float
    correlation_s: float
    white_share: float
    gate_floor_m: float
    gate_probability: float


@dataclass(frozen=True, slots=True)
class DriveSolution:
    """Solution of a drive's factor graph.

    T_enu_node    (K, 4, 4)
    covariance    (K, 6, 6) of its left perturbation (v, omega)
    scale         (S,) metres of road per metre of odometry, stretch by stretch; scale_sigma (S,) its sigma
    inlier        (M,) whether the fix was used
    residual_enu  (M, 3) m
    """

    T_enu_node: FloatArray
    covariance: FloatArray
    scale: FloatArray
    scale_sigma: FloatArray
    inlier: BoolArray
    residual_enu: FloatArray
