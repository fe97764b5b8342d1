"""A drive without GNSS: odometry, loop closures and gravity, in a level frame of its own that begins at its first node.

The frame is as a tangent plane: the first camera stands at its origin and looks along its second axis, up is the third. Position
and heading of the first node are the gauge and certain; how level it is, gravity says.
"""

from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from wayloom.mapping.drive_equations import DriveEquations, DriveState, NoFixes
from wayloom.mapping.drive_types import DriveNoise, OdometryChain
from wayloom.mapping.evidence import Evidence
from wayloom.mapping.loop_factors import LoopTerms
from wayloom.mapping.odometry_links import links_of, pose_key
from wayloom.mapping.truncated_squares import LEAST_WEIGHT, lowest
from wayloom.mapping.witness_graph import carried, coarse_chain

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
GAUGE_M, GAUGE_RAD, LEVEL_RAD = 1e-3, 1e-4, 0.5
SPACING_M = 20.0
"""Nodes of the graph on which closures are judged, at least."""


@dataclass(frozen=True, slots=True)
class StartGauge:
    """Holds position and heading of the first node at T_enu_first (4, 4); its roll and pitch are as good as free."""

    T_enu_first: FloatArray

    def constant(self) -> gtsam.NonlinearFactorGraph:
        """One prior. gtsam's rotation error is in the camera's axes, so the up axis is turned into them."""
        R = self.T_enu_first[:3, :3]
        covariance = GAUGE_M**2 * np.eye(6)
        covariance[:3, :3] = R.T @ np.diag([LEVEL_RAD**2, LEVEL_RAD**2, GAUGE_RAD**2]) @ R
        graph = gtsam.NonlinearFactorGraph()
        model = gtsam.noiseModel.Gaussian.Covariance(covariance)
        graph.add(gtsam.PriorFactorPose3(pose_key(0), gtsam.Pose3(self.T_enu_first), model))
        return graph

    def start(self, values: gtsam.Values) -> None:
        """No unknowns of its own."""

    def factors(self, T_enu_node: FloatArray, values: gtsam.Values) -> gtsam.GaussianFactorGraph:
        """All of it is in `constant`."""
        return gtsam.GaussianFactorGraph()

    def cost(self, T_enu_node: FloatArray, values: gtsam.Values) -> float:
        """All of it is in `constant`."""
        return 0.0


class LoopGraph:
    """Odometry, gravity and weighted visits of closures over a part of the nodes, for `truncated_squares.lowest`."""

    def __init__(self, chain: OdometryChain, gauge: StartGauge, noise: DriveNoise, evidence: Evidence) -> None:
        self.nodes = np.union1d(_spaced(chain), np.concatenate([evidence.nodes(), chain.level]))
        self.price = evidence.loops.price(noise.gate_probability)
        self.heard = np.arange(len(self.price))
        self.gauge, self.noise, self.evidence = gauge, noise, evidence.at(self.nodes)
        self.chain = coarse_chain(chain, self.nodes)
        self.links = links_of(self.chain, noise)

    def equations(self, weight: FloatArray) -> DriveEquations:
        """With the weight (V,), 0 to 1, of each visit's information."""
        terms = (LoopTerms(self.evidence.loops, np.maximum(weight, LEAST_WEIGHT)), self.evidence.up, self.gauge)
        return DriveEquations(self.chain, self.links, NoFixes(), self.noise, terms)

    def solve(self, weight: FloatArray, start: DriveState, solves: int) -> DriveState:
        """Descend from a state."""
        return self.equations(weight).descend(start, solves)

    def distance2(self, at: DriveState) -> FloatArray:
        """(V,) squared distance of each visit, in its sigmas."""
        return self.evidence.loops.distance2(at.T_enu_node)

    def rivals(self, part: int) -> list[NDArray[np.int64]]:
        """All others, and nothing."""
        return [np.setdiff1d(self.heard, [part]), np.zeros(0, np.int64)]

    def truncated_cost(self, at: DriveState) -> float:
        """Half the truncated squares of the visits plus what all else costs."""
        distance2 = self.distance2(at)
        excess = np.maximum(distance2 - self.price, 0.0)
        return self.equations(np.ones(len(self.price))).cost(at) - 0.5 * float(excess.sum())


def _spaced(chain: OdometryChain) -> NDArray[np.int64]:
    """Rows of nodes SPACING_M apart, both ends and both sides of every loss."""
    road = np.concatenate([[0.0], np.cumsum(chain.length_m)])
    lost = np.flatnonzero(~chain.connected)
    every = np.searchsorted(road, np.arange(0.0, road[-1], SPACING_M))
    return np.unique(np.concatenate([[0, len(road) - 1], lost, lost + 1, every]))


def closed_in_own_frame(
    chain: OdometryChain, T_enu_node: FloatArray, noise: DriveNoise, evidence: Evidence
) -> tuple[BoolArray, FloatArray]:
    """(V,) visits whose closures are believed, and T_enu_node (K, 4, 4) bent by them, from a level guess (K, 4, 4)."""
    if not len(evidence.loops):
        return np.zeros(0, bool), T_enu_node
    graph = LoopGraph(chain, StartGauge(T_enu_node[0]), noise, evidence)
    weight, state = lowest(graph, T_enu_node)
    return weight > 0.5, carried(chain, graph.nodes, state.T_enu_node)
