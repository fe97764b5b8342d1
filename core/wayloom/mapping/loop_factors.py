"""Loop closures as factors between any two nodes of a drive, in groups of neighbours that stand or fall together.

A closure says T_first_second = exp(xi) T, where T is true and xi = (v, omega) has the closure's covariance. Its error at poses
T_a, T_b of its two nodes is
    e = Log(T_a^-1 T_b T_first_second^-1),
and, with gtsam's right perturbation (omega, v) put in the order (v, omega),
    by a: -J(e)^-1    by b: J(e)^-1 Ad(T_a^-1 T_b)
with the left Jacobian of SE(3): J(e)^-1 = sum_n B_n / n! ad(e)^n (Barfoot, State Estimation for Robotics, eq. 7.98), to n = 4.

Neighbouring closures see the same things from nearly the same place, so n of them in a group are not n witnesses: together they
weigh as much as one, and they are believed or refused together.
"""

from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from wayloom.geometry import se3
from wayloom.mapping.odometry_links import pose_key

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
GROUP_M = 10.0
"""Road, at both ends, over which closures are one witness."""
OMEGA_FIRST = [3, 4, 5, 0, 1, 2]


@dataclass(frozen=True, slots=True)
class LoopLinks:
    """L closures of a drive in G groups.

    first, second   (L,) rows of nodes
    T_first_second  (L, 4, 4); covariance (L, 6, 6) of its left perturbation (v, omega)
    group           (L,) 0 to G - 1
    """

    first: IntArray
    second: IntArray
    T_first_second: FloatArray
    covariance: FloatArray
    group: IntArray

    def __len__(self) -> int:
        return len(self.first)

    @property
    def groups(self) -> int:
        """G."""
        return int(self.group.max()) + 1 if len(self) else 0

    def at(self, nodes: IntArray) -> "LoopLinks":
        """The same closures over some of the nodes, those of every closure among them."""
        first, second = np.searchsorted(nodes, self.first), np.searchsorted(nodes, self.second)
        return LoopLinks(first, second, self.T_first_second, self.covariance, self.group)

    def take(self, groups: NDArray[np.bool_]) -> "LoopLinks":
        """The closures of some groups (G,), numbered anew."""
        if not len(self):
            return self
        rows = groups[self.group]
        number = np.cumsum(groups) - 1
        parts = (self.first, self.second, self.T_first_second, self.covariance)
        return LoopLinks(*(part[rows] for part in parts), number[self.group[rows]])

    def price(self, probability: float) -> FloatArray:
        """(G,) squared distance beyond which a group is worth leaving out: this quantile of chi-square (6)."""
        return np.full(self.groups, float(chi2.ppf(probability, 6)))

    def distance2(self, T_enu_node: FloatArray) -> FloatArray:
        """(G,) squared distance of each group in its sigmas, the mean over its closures."""
        whitened = (self._roots() @ loop_errors(self, T_enu_node)[:, :, None])[:, :, 0]
        return np.asarray(np.bincount(self.group, (whitened**2).sum(axis=1), self.groups), np.float64)

    def _roots(self) -> FloatArray:
        """(L, 6, 6) S with S^T S the information of each closure, shared by its group."""
        count = np.bincount(self.group, minlength=self.groups)[self.group]
        information = np.linalg.inv(self.covariance * count[:, None, None])
        return np.asarray(np.swapaxes(np.linalg.cholesky(information), 1, 2))


def loop_links(first: IntArray, second: IntArray, T_first_second: FloatArray, covariance: FloatArray, road_m: FloatArray) -> LoopLinks:
    """Closures in the order of the road and in groups: neighbours that lie within GROUP_M of a group's first one at both ends.

    first, second : (L,) rows of nodes; road_m : (K,) m of road to each node
    """
    order = np.lexsort((second, first))
    a, b = road_m[first[order]], road_m[second[order]]
    group, starts = np.zeros(len(order), np.int64), []
    for k in range(len(order)):
        near = [g for g, s in starts if a[k] - a[s] <= GROUP_M and abs(b[k] - b[s]) <= GROUP_M]
        if not near:
            starts = [(g, s) for g, s in starts if a[k] - a[s] <= GROUP_M]
            near = [int(group[:k].max()) + 1 if k else 0]
            starts.append((near[0], k))
        group[k] = near[0]
    return LoopLinks(first[order].astype(np.int64), second[order].astype(np.int64), T_first_second[order], covariance[order], group)


def no_loop_links() -> LoopLinks:
    """None."""
    none = np.zeros(0, np.int64)
    return LoopLinks(none, none, np.zeros((0, 4, 4)), np.zeros((0, 6, 6)), none)


def loop_errors(loops: LoopLinks, T_enu_node: FloatArray) -> FloatArray:
    """(L, 6) e = (v, omega), m and rad, at poses T_enu_node (K, 4, 4)."""
    T_a_b = se3.inverse(T_enu_node[loops.first]) @ T_enu_node[loops.second]
    return np.array([se3.log(T) for T in T_a_b @ se3.inverse(loops.T_first_second)]).reshape(-1, 6)


def loop_jacobians(loops: LoopLinks, T_enu_node: FloatArray, errors: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Of the errors (L, 6) by first and by second node (L, 6, 6), gtsam's right (omega, v), at T_enu_node (K, 4, 4)."""
    inverse_J = inverse_left_jacobian(errors)
    Ad = se3.adjoint(se3.inverse(T_enu_node[loops.first]) @ T_enu_node[loops.second])
    return -inverse_J[:, :, OMEGA_FIRST], (inverse_J @ Ad)[:, :, OMEGA_FIRST]


def inverse_left_jacobian(xi: FloatArray) -> FloatArray:
    """J^-1 (N, 6, 6) of twists xi (N, 6) = (v, omega): Log(Exp(d) Exp(xi)) = xi + J^-1 d. Good to 1e-4 for turns under a radian."""
    ad = np.zeros((len(xi), 6, 6))
    ad[:, :3, :3] = ad[:, 3:, 3:] = se3.hat(xi[:, 3:])
    ad[:, :3, 3:] = se3.hat(xi[:, :3])
    ad2 = ad @ ad
    return np.asarray(np.eye(6) - ad / 2.0 + ad2 / 12.0 - ad2 @ ad2 / 720.0)


@dataclass(frozen=True, slots=True)
class LoopTerms:
    """Closures in a drive's equations, each group with a weight (G,) > 0 of its information."""

    loops: LoopLinks
    weight: FloatArray

    def constant(self) -> gtsam.NonlinearFactorGraph:
        """Nothing."""
        return gtsam.NonlinearFactorGraph()

    def start(self, values: gtsam.Values) -> None:
        """No unknowns of its own."""

    def factors(self, T_enu_node: FloatArray, values: gtsam.Values) -> gtsam.GaussianFactorGraph:
        """The closures, linear at T_enu_node (K, 4, 4), whitened."""
        loops, graph, unit = self.loops, gtsam.GaussianFactorGraph(), gtsam.noiseModel.Unit.Create(6)
        if not len(loops):
            return graph
        errors = loop_errors(loops, T_enu_node)
        root = self._roots()
        by_a, by_b = (root @ J for J in loop_jacobians(loops, T_enu_node, errors))
        b = -(root @ errors[:, :, None])[:, :, 0]
        for k, (i, j) in enumerate(zip(loops.first.tolist(), loops.second.tolist(), strict=True)):
            graph.add(gtsam.JacobianFactor(pose_key(i), by_a[k], pose_key(j), by_b[k], b[k], unit))
        return graph

    def cost(self, T_enu_node: FloatArray, values: gtsam.Values) -> float:
        """Half the sum of squares of the whitened errors."""
        return 0.5 * float(self.weight @ self.loops.distance2(T_enu_node)) if len(self.loops) else 0.0

    def _roots(self) -> FloatArray:
        return np.asarray(np.sqrt(self.weight)[self.loops.group][:, None, None] * self.loops._roots())
