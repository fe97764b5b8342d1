"""Equations of a drive over the nodes from which fixes and closures are seen, with a weight for each part of what they say."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.mapping.drive_equations import DriveEquations, DriveState, IndependentFixes
from wayloom.mapping.drive_types import DriveNoise, OdometryChain
from wayloom.mapping.evidence import Evidence
from wayloom.mapping.fix_witnesses import Witnesses
from wayloom.mapping.loop_factors import LoopTerms
from wayloom.mapping.odometry_links import links_of
from wayloom.mapping.truncated_squares import LEAST_WEIGHT

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


class WitnessGraph:
    """Witnesses, closures and odometry over the nodes that they are seen from."""

    def __init__(self, chain: OdometryChain, witnesses: Witnesses, noise: DriveNoise, evidence: Evidence) -> None:
        ends, lost = np.array([0, len(chain.T_world_node) - 1], np.int64), np.flatnonzero(~chain.connected)
        self.chain, self.witnesses, self.noise = chain, witnesses, noise
        self.nodes = np.unique(np.concatenate([ends, witnesses.fixes.node, lost, lost + 1, chain.level, evidence.nodes()]))
        self.evidence = evidence.at(self.nodes)
        self.price = np.concatenate([witnesses.price, evidence.loops.price(noise.gate_probability)])
        self.importance = np.concatenate([witnesses.importance, np.ones(evidence.loops.visits)])
        self.heard = np.arange(len(witnesses), len(self.price))
        self.coarse = coarse_chain(chain, self.nodes)
        self.links = links_of(self.coarse, noise)
        self.fixes = replace(witnesses.fixes, node=np.searchsorted(self.nodes, witnesses.fixes.node))

    def equations(self, weight: FloatArray) -> DriveEquations:
        """With the weight (B + V,), 0 to 1, of each stretch's and each visit's information."""
        of_fixes, of_loops = np.split(np.maximum(weight, LEAST_WEIGHT) * self.importance, [len(self.witnesses)])
        return self.weighted(of_fixes[self.witnesses.stretch], of_loops)

    def weighted(self, of_witness: FloatArray, of_visit: FloatArray) -> DriveEquations:
        """With the weight (W,) > 0 of each witness's and (V,) of each visit's information."""
        terms = (LoopTerms(self.evidence.loops, of_visit), self.evidence.up)
        return DriveEquations(self.coarse, self.links, IndependentFixes(self.fixes, of_witness), self.noise, terms)

    def solve(self, weight: FloatArray, start: DriveState, solves: int) -> DriveState:
        """Descend from a state."""
        return self.equations(weight).descend(start, solves)

    def distance2(self, at: DriveState) -> FloatArray:
        """(B + V,) of each stretch the sum of its witnesses' squared distances from the antenna, in their sigmas; of each visit its
        own."""
        residual = self.fixes.residuals(at.T_enu_node, at.receiver)
        of_witness = np.einsum("ni,ni->n", residual, np.linalg.solve(self.fixes.covariance, residual[:, :, None])[:, :, 0])
        return np.concatenate([self.witnesses.sums(of_witness), self.evidence.loops.distance2(at.T_enu_node)])

    def rivals(self, part: int) -> list[IntArray]:
        """Of a visit's closures: the stretches of fixes at its earlier end, or those at its later one, may be wrong."""
        loops = self.evidence.loops
        rows = loops.visit == part - len(self.witnesses)
        last = len(self.witnesses.stretch) - 1
        after = [np.searchsorted(self.fixes.node, ends[rows]) for ends in (loops.first, loops.second)]
        return [np.unique(self.witnesses.stretch[np.clip(np.concatenate([k - 1, k]), 0, last)]) for k in after]

    def truncated_cost(self, at: DriveState) -> float:
        """Half the truncated squares of stretches and visits plus what all else costs."""
        distance2 = self.distance2(at)
        others = self.equations(np.ones(len(self.price))).cost(at) - 0.5 * float(self.importance @ distance2)
        return others + 0.5 * float(self.importance @ np.minimum(distance2, self.price))


def coarse_chain(chain: OdometryChain, nodes: IntArray) -> OdometryChain:
    """The chain over some of its nodes, both ends among them."""
    road = np.concatenate([[0.0], np.cumsum(chain.length_m)])
    breaks = np.concatenate([[0], np.cumsum(~chain.connected)])
    level = np.flatnonzero(np.isin(nodes, chain.level))
    T, covariance = chain.T_world_node[nodes], summed_covariance(chain, nodes)
    return OdometryChain(T, np.diff(road[nodes]), np.diff(breaks[nodes]) == 0, level, covariance)


def summed_covariance(chain: OdometryChain, nodes: IntArray) -> FloatArray:
    """(k - 1, 6, 6) as `OdometryChain.link_covariance` between the k nodes, both ends among them: of links one after the other,
    independent."""
    T = chain.T_world_node
    first = np.searchsorted(nodes, np.arange(len(T) - 1), side="right") - 1
    Ad = se3.adjoint(se3.inverse(T[nodes[first]]) @ T[:-1])
    return np.add.reduceat(Ad @ chain.link_covariance @ np.swapaxes(Ad, 1, 2), nodes[:-1], axis=0)


def carried(chain: OdometryChain, nodes: IntArray, T_enu_coarse: FloatArray) -> FloatArray:
    """(K, 4, 4) all nodes, each carried by the last of `nodes` before it."""
    before = np.searchsorted(nodes, np.arange(len(chain.T_world_node)), side="right") - 1
    T_enu_world = T_enu_coarse @ se3.inverse(chain.T_world_node[nodes])
    return np.asarray(T_enu_world[before] @ chain.T_world_node)
