"""Loop closures as factors between any two nodes of a drive, in visits that stand or fall together.

A closure says T_first_second = exp(xi) T, where T is true and xi = (v, omega) has the closure's covariance. Its error at poses
T_a, T_b of its two nodes is
    e = Log(T_a^-1 T_b T_first_second^-1),
and, with gtsam's right perturbation (omega, v) put in the order (v, omega),
    by a: -J(e)^-1    by b: J(e)^-1 Ad(T_a^-1 T_b)
with the left Jacobian of SE(3): J(e)^-1 = sum_n B_n / n! ad(e)^n (Barfoot, State Estimation for Robotics, eq. 7.98), to n = 6.

Neighbouring closures see the same things from nearly the same place, so n of them in a group are not n witnesses: together they
weigh as much as one. And where a place was mistaken for another, all closures of a visit agree in the same mistake: groups that
follow each other and agree, by the odometry between them, are one visit, and are believed or refused together.
"""

from dataclasses import dataclass, replace

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from wayloom.geometry import se3
from wayloom.geometry.probability import chi_square_quantile
from wayloom.mapping.drive_types import OdometryChain
from wayloom.mapping.odometry_links import pose_key

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
GROUP_M = 10.0
"""Road, at both ends, over which closures are one witness."""
VISIT_M = 50.0
"""Road, at both ends, over which groups that agree belong to one visit."""
AGREE_SIGMA, AGREE_SHARE, AGREE_RAD = 4.0, 0.03, 0.005
"""How well they must: within so many sigma, and so much of the road between them, and so many radians, by the odometry."""
OMEGA_FIRST = [3, 4, 5, 0, 1, 2]


@dataclass(frozen=True, slots=True)
class LoopLinks:
    """L closures of a drive in G groups of V visits.

    first, second   (L,) rows of nodes
    T_first_second  (L, 4, 4); covariance (L, 6, 6) of its left perturbation (v, omega)
    group           (L,) 0 to G - 1
    visit           (L,) 0 to V - 1, the same within a group
    """

    first: IntArray
    second: IntArray
    T_first_second: FloatArray
    covariance: FloatArray
    group: IntArray
    visit: IntArray

    def __len__(self) -> int:
        return len(self.first)

    @property
    def visits(self) -> int:
        """V."""
        return int(self.visit.max()) + 1 if len(self) else 0

    def at(self, nodes: IntArray) -> "LoopLinks":
        """The same closures over some of the nodes, those of every closure among them."""
        first, second = np.searchsorted(nodes, self.first), np.searchsorted(nodes, self.second)
        return LoopLinks(first, second, self.T_first_second, self.covariance, self.group, self.visit)

    def take(self, visits: BoolArray) -> "LoopLinks":
        """The closures of some visits (V,), numbered anew."""
        if not len(self):
            return self
        rows = visits[self.visit]
        group, visit = (np.unique(part[rows], return_inverse=True)[1].astype(np.int64) for part in (self.group, self.visit))
        return LoopLinks(self.first[rows], self.second[rows], self.T_first_second[rows], self.covariance[rows], group, visit)

    def price(self, probability: float) -> FloatArray:
        """(V,) squared distance beyond which a visit is worth leaving out: this quantile of chi-square, six for each group."""
        if not len(self):
            return np.zeros(0)
        _, first = np.unique(self.group, return_index=True)
        return np.asarray(chi_square_quantile(probability, 6 * np.bincount(self.visit[first])), np.float64)

    def distance2(self, T_enu_node: FloatArray) -> FloatArray:
        """(V,) squared distance of each visit in its sigmas: the sum over its groups of the mean over each."""
        whitened = (self.roots() @ loop_errors(self, T_enu_node)[:, :, None])[:, :, 0]
        return np.asarray(np.bincount(self.visit, (whitened**2).sum(axis=1), self.visits), np.float64)

    def roots(self) -> FloatArray:
        """(L, 6, 6) S with S^T S the information of each closure, shared by its group."""
        count = np.bincount(self.group)[self.group] if len(self) else np.zeros(0)
        information = np.linalg.inv(self.covariance * count[:, None, None])
        return np.asarray(np.swapaxes(np.linalg.cholesky(information), 1, 2))


def loop_links(
    first: IntArray, second: IntArray, T_first_second: FloatArray, covariance: FloatArray, chain: OdometryChain
) -> LoopLinks:
    """Closures in the order of the road, in groups and visits. first, second : (L,) rows of the chain's nodes."""
    road_m = np.concatenate([[0.0], np.cumsum(chain.length_m)])
    order = np.lexsort((second, first))
    first, second = first[order].astype(np.int64), second[order].astype(np.int64)
    group = _groups(road_m[first], road_m[second])
    links = LoopLinks(first, second, T_first_second[order], covariance[order], group, group)
    return replace(links, visit=_visits(links, chain.T_world_node, road_m))


def _groups(a_m: FloatArray, b_m: FloatArray) -> IntArray:
    """(L,) the group of each closure between a_m (L,), increasing, and b_m (L,) m of road: within GROUP_M of its first."""
    group, open_groups = np.zeros(len(a_m), np.int64), list[tuple[int, int]]()
    for k in range(len(a_m)):
        open_groups = [(g, s) for g, s in open_groups if a_m[k] - a_m[s] <= GROUP_M]
        near = [g for g, s in open_groups if abs(b_m[k] - b_m[s]) <= GROUP_M]
        group[k] = near[0] if near else (group[:k].max() + 1 if k else 0)
        if not near:
            open_groups.append((int(group[k]), k))
    return group


def _visits(links: LoopLinks, T_world_node: FloatArray, road_m: FloatArray) -> IntArray:
    """(L,) the visit of each closure: groups near by and in agreement, joined one after another."""
    if not len(links):
        return links.group
    groups, row = np.unique(links.group, return_index=True)
    near = np.ones((len(groups), len(groups)), bool)
    for end in (links.first[row], links.second[row]):
        near &= np.abs(road_m[end][:, None] - road_m[end][None]) <= VISIT_M
    i, j = np.nonzero(np.triu(near, 1))
    agree = _agree(links, T_world_node, road_m, row[i], row[j])
    joined = coo_matrix((np.ones(agree.sum()), (i[agree], j[agree])), near.shape)
    return np.asarray(connected_components(joined, directed=False)[1][links.group], np.int64)


def _agree(links: LoopLinks, T_world_node: FloatArray, road_m: FloatArray, i: IntArray, j: IntArray) -> BoolArray:
    """(n,) whether closures of rows i and j (n,) say the same by the odometry between their ends."""
    T_a_a = se3.inverse(T_world_node[links.first[i]]) @ T_world_node[links.first[j]]
    T_b_b = se3.inverse(T_world_node[links.second[j]]) @ T_world_node[links.second[i]]
    apart = T_a_a @ links.T_first_second[j] @ T_b_b @ se3.inverse(links.T_first_second[i])
    twist = np.array([se3.log(T) for T in apart]).reshape(-1, 6)
    road = np.abs(road_m[links.first[i]] - road_m[links.first[j]]) + np.abs(road_m[links.second[i]] - road_m[links.second[j]])
    variance = np.diagonal(links.covariance[i] + links.covariance[j], axis1=1, axis2=2)
    moved_m, turned_rad = (AGREE_SIGMA * np.sqrt(variance[:, part].sum(axis=1)) for part in (slice(3), slice(3, 6)))
    good = np.linalg.norm(twist[:, :3], axis=1) <= moved_m + AGREE_SHARE * road + turned_rad * road
    return np.asarray(good & (np.linalg.norm(twist[:, 3:], axis=1) <= turned_rad + AGREE_RAD))


def no_loop_links() -> LoopLinks:
    """None."""
    none = np.zeros(0, np.int64)
    return LoopLinks(none, none, np.zeros((0, 4, 4)), np.zeros((0, 6, 6)), none, none)


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
    """J^-1 (N, 6, 6) of twists xi (N, 6) = (v, omega): Log(Exp(d) Exp(xi)) = xi + J^-1 d. For turns under a radian."""
    ad = np.zeros((len(xi), 6, 6))
    ad[:, :3, :3] = ad[:, 3:, 3:] = se3.hat(xi[:, 3:])
    ad[:, :3, 3:] = se3.hat(xi[:, :3])
    ad2 = ad @ ad
    return np.asarray(np.eye(6) - ad / 2.0 + ad2 / 12.0 - ad2 @ ad2 / 720.0 + ad2 @ ad2 @ ad2 / 30240.0)


@dataclass(frozen=True, slots=True)
class LoopTerms:
    """Closures in a drive's equations, each visit with a weight (V,) > 0 of its information."""

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
        return np.asarray(np.sqrt(self.weight)[self.loops.visit][:, None, None] * self.loops.roots())
