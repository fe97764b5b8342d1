"""Inputs, noise model and solution of the drive's factor graph."""

from dataclasses import dataclass, field, fields

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
    link_covariance  (K - 1, 6, 6) of xi = (v, omega), m and rad, of exp(xi) T_node_next, as the odometry's window of keyframes
                  knows it; 0, the default, where it is not known
    """

    T_world_node: FloatArray
    length_m: FloatArray
    connected: BoolArray
    level: NDArray[np.int64]
    link_covariance: FloatArray = field(default_factory=lambda: np.zeros((0, 6, 6)))

    def __post_init__(self) -> None:
        if len(self.link_covariance) != len(self.length_m):
            object.__setattr__(self, "link_covariance", np.zeros((len(self.length_m), 6, 6)))


@dataclass(frozen=True, slots=True)
class AntennaFixes:
    """GNSS fixes, each seen from a node.

    t_s           (M,) increasing, s
    node          (M,) row of the node
    late_s        (M,) the time offset of the receiver at which p_node_gnss and v_node_gnss hold
    p_node_gnss   (M, 3) m, the antenna at the time of the fix in the node's camera frame
    v_node_gnss   (M, 3) m/s, its velocity there
    R_node_cam    (M, 3, 3) from the camera at the time of the fix to the node's camera
    position_enu  (M, 3) m
    covariance    (M, 3, 3) m^2
    kind          (M,) uint8 FixType
    white_share   (M,) share of sigma that is new with each fix
    datum         (M,) number of the height datum: 0, the default, is the map's, any other lies higher by an unknown constant
    """

    t_s: FloatArray
    node: NDArray[np.int64]
    late_s: FloatArray
    p_node_gnss: FloatArray
    v_node_gnss: FloatArray
    R_node_cam: FloatArray
    position_enu: FloatArray
    covariance: FloatArray
    kind: NDArray[np.uint8]
    white_share: FloatArray
    datum: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))

    def __post_init__(self) -> None:
        if len(self.datum) != len(self.t_s):
            object.__setattr__(self, "datum", np.zeros(len(self.t_s), np.int64))

    def __len__(self) -> int:
        return len(self.t_s)

    def take(self, rows: NDArray[np.int64]) -> "AntennaFixes":
        """The fixes of these rows."""
        return AntennaFixes(*(getattr(self, column.name)[rows] for column in fields(self)))

    def p_node_antenna(self, receiver: FloatArray) -> FloatArray:
        """(M, 3) m, the antenna in its node's frame; receiver (4,): time offset s, error of the lever arm m."""
        later = (receiver[0] - self.late_s)[:, None] * self.v_node_gnss
        return np.asarray(self.p_node_gnss - later + self.R_node_cam @ receiver[1:])

    def antenna_enu(self, T_enu_node: FloatArray, receiver: FloatArray) -> FloatArray:
        """(M, 3) m: the antenna on poses T_enu_node (K, 4, 4)."""
        T = T_enu_node[self.node]
        return np.asarray(np.einsum("nij,nj->ni", T[:, :3, :3], self.p_node_antenna(receiver)) + T[:, :3, 3])

    def residuals(self, T_enu_node: FloatArray, receiver: FloatArray) -> FloatArray:
        """(M, 3) m: fix minus antenna."""
        return np.asarray(self.position_enu - self.antenna_enu(T_enu_node, receiver))


@dataclass(frozen=True, slots=True)
class DriveNoise:
    """Sigmas, explained in `wayloom.mapping.drive_graph`: m and rad, for one metre of road where they grow; scale_sigma a share.

    receiver      : (4, 4) covariance of time offset, s, and lever arm, m, where log or rig memory knows them beside
                    time_offset_s and lever_m; None where neither does
    window_factor : what `OdometryChain.link_covariance` is multiplied by
    clock_drifts  : whether the stamps were put right of a drift, of which something may be left
    """

    position_m: float
    rotation_rad: float
    standing_position_m: float
    standing_rotation_rad: float
    scale_sigma: float
    scale_length_m: float
    level_rad: float
    correlation_s: float
    gate_floor_m: float
    gate_probability: float
    time_offset_s: float
    lever_m: float
    receiver: FloatArray | None = None
    window_factor: float = 3.0
    clock_drifts: bool = False


@dataclass(frozen=True, slots=True)
class DriveSolution:
    """Solution of a drive's factor graph.

    T_enu_node    (K, 4, 4)
    covariance    (K, 6, 6) of its left perturbation (v, omega)
    cross         (P, 6, 6) covariance of the left perturbations of the nodes of each pair asked for, the first's by rows
    scale         (S,) metres of road per metre of odometry, stretch by stretch; scale_sigma (S,) its sigma
    inlier        (M,) whether the fix was used
    residual_enu  (M, 3) m
    receiver      (4,) time offset s and error of the lever arm m; receiver_covariance (4, 4)
    clock_drift   s/s by which the receiver's stamps are ever later, about the middle of the fixes; 0 where the drive does not tell
    told          what the drive alone says of the receiver
    overruled     of clock and lever arm, whether the drive denies what was known of it
    noise_ratio   for each kind of fix that scatters more than it says: how many times
    shifted       stretches of fixes that lie apart from the others
    unconfirmed_m metres by which the drive would lie elsewhere if the lesser part of its fixes were right; see `fix_screening`
    unconfirmed_height_m  the same where that part differs in its heights alone
    datum         (M,) number of each fix's height datum, 0 the drive's; datum_height_m (D,) by which each of the others, from 1
                  on, is higher; residuals are without it
    closed        (V,) whether the loop closures of each visit were used
    """

    T_enu_node: FloatArray
    covariance: FloatArray
    cross: FloatArray
    scale: FloatArray
    scale_sigma: FloatArray
    inlier: BoolArray
    residual_enu: FloatArray
    receiver: FloatArray
    receiver_covariance: FloatArray
    clock_drift: float
    told: "ReceiverTold"
    overruled: tuple[bool, bool]
    noise_ratio: dict[int, float]
    shifted: tuple["ShiftedFixes", ...]
    unconfirmed_m: float
    unconfirmed_height_m: float
    datum: NDArray[np.int64]
    datum_height_m: FloatArray
    closed: BoolArray


@dataclass(frozen=True, slots=True)
class ReceiverTold:
    """information (4, 4), pull (4,) of time offset, s, and error of the lever arm, m, without any prior: the marginal of the
    drive's graph, exp -1/2 [r^T information r - 2 pull^T r]."""

    information: FloatArray
    pull: FloatArray


@dataclass(frozen=True, slots=True)
class ShiftedFixes:
    """Fixes in a row, first to last (rows of AntennaFixes, inclusive), that lie apart from the drive by about offset_enu (3,) m."""

    first: int
    last: int
    offset_enu: FloatArray
