"""Normal equations of a drive: odometry links, gravity, GNSS and the receiver, descended by Gauss-Newton.

gtsam perturbs Pose3 on the right and orders (omega, v); covariances are converted to the left, (v, omega), in `left_covariances`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import gtsam
import numpy as np
from numpy.typing import NDArray

from wayloom.config.one_heap import give_back
from wayloom.geometry import se3
from wayloom.mapping.drive_types import AntennaFixes, DriveNoise, OdometryChain
from wayloom.mapping.gnss_factors import (
    RECEIVER,
    add_correlated_noise,
    antenna_errors,
    antenna_factors,
    antenna_key,
    fix_factors,
    information_roots,
    receiver_key,
    receiver_prior,
    receiver_root,
    white_covariance,
)
from wayloom.mapping.odometry_links import OdometryLinks, add_scale_factors, link_cost, link_factors, pose_key, scale_key
from wayloom.mapping.square_root import SquareRoot, join_in_pattern

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
LOST_POSITION_M, LOST_ROTATION_RAD = 20.0, 0.5  # a link over a loss, plus half of the guessed distance
GAUGE_POSITION_M, GAUGE_ROTATION_RAD = 1e3, float(np.pi)
MAX_ITERATIONS, MAX_HALVINGS, CONVERGED = 30, 8, 1e-9
MANY_NODES = 2000
"""From here on a drive's unknowns are eliminated part by part, and what that was made of is given back to the system."""
PART_NODES = 1000
V_OMEGA = [3, 4, 5, 0, 1, 2]
"""Rows of gtsam's (omega, v) in the order (v, omega)."""


@dataclass(frozen=True, slots=True)
class DriveState:
    """All unknowns at one point: T_enu_node (K, 4, 4), scale s (S,), receiver (4,), place_enu (M, 3) m of the antenna at each fix
    (M = 0 where fixes have independent noise), and poses, scales and places as gtsam's values."""

    T_enu_node: FloatArray
    scale: FloatArray
    receiver: FloatArray
    place_enu: FloatArray
    values: gtsam.Values


@dataclass(frozen=True, slots=True)
class DriveCovariances:
    """Of left perturbations of the nodes (K, 6, 6), and of pairs of nodes, first (rows) with second (columns), (P, 6, 6); of the
    receiver (4, 4); sigma (S,) of each scale."""

    nodes: FloatArray
    cross: FloatArray
    receiver: FloatArray
    scale_sigma: FloatArray


class FixTerms(Protocol):
    """What GNSS says: nonlinear factors that stay, places that are unknowns, and factors and cost at a state."""

    def constant(self) -> gtsam.NonlinearFactorGraph: ...

    def places(self, T_enu_node: FloatArray, receiver: FloatArray) -> FloatArray: ...

    def factors(self, at: DriveState) -> gtsam.GaussianFactorGraph: ...

    def cost(self, at: DriveState) -> float: ...


class PoseTerms(Protocol):
    """What else speaks of the poses T_enu_node (K, 4, 4), closures or gravity: nonlinear factors that stay, its own unknowns, which
    live in gtsam's values, and factors and cost at a state."""

    def constant(self) -> gtsam.NonlinearFactorGraph: ...

    def start(self, values: gtsam.Values) -> None: ...

    def factors(self, T_enu_node: FloatArray, values: gtsam.Values) -> gtsam.GaussianFactorGraph: ...

    def cost(self, T_enu_node: FloatArray, values: gtsam.Values) -> float: ...


@dataclass(frozen=True, slots=True)
class NoFixes:
    """A drive without GNSS."""

    def constant(self) -> gtsam.NonlinearFactorGraph:
        """Nothing."""
        return gtsam.NonlinearFactorGraph()

    def places(self, T_enu_node: FloatArray, receiver: FloatArray) -> FloatArray:
        """(0, 3): none."""
        return np.zeros((0, 3))

    def factors(self, at: DriveState) -> gtsam.GaussianFactorGraph:
        """Nothing."""
        return gtsam.GaussianFactorGraph()

    def cost(self, at: DriveState) -> float:
        """None."""
        return 0.0


@dataclass(frozen=True, slots=True)
class CorrelatedFixes:
    """Fixes whose noise is correlated over time: `wayloom.mapping.gnss_factors`."""

    fixes: AntennaFixes
    noise: DriveNoise

    def constant(self) -> gtsam.NonlinearFactorGraph:
        """The Ornstein-Uhlenbeck part."""
        graph = gtsam.NonlinearFactorGraph()
        add_correlated_noise(graph, self.fixes, self.noise)
        return graph

    def places(self, T_enu_node: FloatArray, receiver: FloatArray) -> FloatArray:
        """(M, 3) m: the antenna on its pose."""
        return self.fixes.antenna_enu(T_enu_node, receiver)

    def factors(self, at: DriveState) -> gtsam.GaussianFactorGraph:
        """The white part."""
        return antenna_factors(self.fixes, at.T_enu_node, at.receiver, at.place_enu)

    def cost(self, at: DriveState) -> float:
        """Half the squared white errors."""
        errors = antenna_errors(self.fixes, at.T_enu_node, at.receiver, at.place_enu)
        return _half_square(white_covariance(self.fixes), errors)


@dataclass(frozen=True, slots=True)
class IndependentFixes:
    """Fixes with independent noise, each with a weight (M,) > 0 of its information."""

    fixes: AntennaFixes
    weight: FloatArray

    def constant(self) -> gtsam.NonlinearFactorGraph:
        """Nothing."""
        return gtsam.NonlinearFactorGraph()

    def places(self, T_enu_node: FloatArray, receiver: FloatArray) -> FloatArray:
        """(0, 3): none is an unknown."""
        return np.zeros((0, 3))

    def factors(self, at: DriveState) -> gtsam.GaussianFactorGraph:
        """Each fix against the antenna."""
        return fix_factors(self.fixes, self._covariance(), at.T_enu_node, at.receiver)

    def cost(self, at: DriveState) -> float:
        """Half the weighted squared errors."""
        return _half_square(self._covariance(), self.fixes.residuals(at.T_enu_node, at.receiver))

    def _covariance(self) -> FloatArray:
        return np.asarray(self.fixes.covariance / self.weight[:, None, None])


def _half_square(covariance: FloatArray, errors: FloatArray) -> float:
    whitened = information_roots(covariance) @ errors[:, :, None]
    return 0.5 * float((whitened**2).sum())


class DriveEquations:
    """What the unknowns must agree with: level and gauge, the odometry's links, the receiver's prior, the fixes and other terms."""

    def __init__(
        self, chain: OdometryChain, links: OdometryLinks, fixes: FixTerms, noise: DriveNoise, terms: tuple[PoseTerms, ...] = ()
    ) -> None:
        self.links, self.fixes, self.noise, self.terms = links, fixes, noise, terms
        self._graph = _anchor_factors(chain, noise)
        add_scale_factors(self._graph, links)
        self._graph.push_back(fixes.constant())
        for term in terms:
            self._graph.push_back(term.constant())

    def first_state(self, T_enu_node: FloatArray, receiver: FloatArray | None = None) -> DriveState:
        """True scale, the receiver as told, every antenna where its node has it."""
        receiver = np.zeros(RECEIVER) if receiver is None else receiver
        values, places = gtsam.Values(), self.fixes.places(T_enu_node, receiver)
        for i, T in enumerate(T_enu_node):
            values.insert(pose_key(i), gtsam.Pose3(T))
        for k in range(self.links.stretches):
            values.insert(scale_key(k), 0.0)
        for k, place in enumerate(places):
            values.insert(antenna_key(k), gtsam.Point3(*place))
        for term in self.terms:
            term.start(values)
        return DriveState(T_enu_node, np.zeros(self.links.stretches), receiver, places, values)

    def square_root(self, at: DriveState, joint: Sequence[tuple[int, int]] = ()) -> SquareRoot:
        """Of the information at a state. joint : keys of pairs of poses whose covariances will be asked for together."""
        linear, count = self.linear(at), len(at.T_enu_node)
        join_in_pattern(linear, joint, 6)
        return SquareRoot(linear, {pose_key(i): i // PART_NODES for i in range(count)} if count > MANY_NODES else {})

    def covariances(self, at: DriveState, pairs: IntArray) -> DriveCovariances:
        """What is known of the unknowns at the minimum. pairs : (P, 2) rows of nodes."""
        joint = [(pose_key(a), pose_key(b)) for a, b in pairs.tolist()]
        nodes, scales = range(len(at.T_enu_node)), range(self.links.stretches)
        wanted = {*map(pose_key, nodes), *map(scale_key, scales), receiver_key()}
        found, crosses = self.square_root(at, joint).covariances(wanted, joint)
        _give_back_of(at)
        cross = np.array(crosses).reshape(-1, 6, 6)[:, V_OMEGA][:, :, V_OMEGA]
        Ad_a, Ad_b = (se3.adjoint(at.T_enu_node[rows]) for rows in pairs.T)
        return DriveCovariances(
            left_covariances(np.array([found[pose_key(i)] for i in nodes]), at.T_enu_node),
            np.asarray(Ad_a @ cross @ np.swapaxes(Ad_b, -1, -2)),
            found[receiver_key()],
            np.sqrt([found[scale_key(k)][0, 0] for k in scales]),
        )

    def linear(self, at: DriveState) -> gtsam.GaussianFactorGraph:
        """All factors, linear at a state, whitened."""
        linear = self._graph.linearize(at.values)
        linear.push_back(link_factors(self.links, at.T_enu_node, at.scale))
        linear.push_back(self.fixes.factors(at))
        for term in self.terms:
            linear.push_back(term.factors(at.T_enu_node, at.values))
        linear.push_back(receiver_prior(self.noise, at.receiver))
        return linear

    def cost(self, at: DriveState) -> float:
        """Half the sum of squares, as gtsam counts."""
        prior = 0.5 * float(((receiver_root(self.noise) @ at.receiver) ** 2).sum())
        own = float(self._graph.error(at.values))
        others = sum(term.cost(at.T_enu_node, at.values) for term in self.terms)
        return own + link_cost(self.links, at.T_enu_node, at.scale) + self.fixes.cost(at) + others + prior

    def descend(self, state: DriveState, iterations: int = MAX_ITERATIONS) -> DriveState:
        """Gauss-Newton, with halved steps while the cost would grow."""
        cost = self.cost(state)
        for _ in range(iterations):
            before = cost
            state, cost = self._step(state, self.square_root(state).minimum(), before)
            if before - cost <= CONVERGED * (before + 1.0):
                break
        _give_back_of(state)
        return state

    def _step(self, state: DriveState, step: gtsam.VectorValues, cost: float) -> tuple[DriveState, float]:
        """The state after the step, or after the first of its half, quarter, … that lowers the cost; unchanged when none does."""
        receiver_step, share = step.at(receiver_key()), 1.0
        for _ in range(MAX_HALVINGS):
            moved = _moved(state, step, state.receiver + share * receiver_step)
            new_cost = self.cost(moved)
            if new_cost < cost:
                return moved, new_cost
            step, share = step.scale(0.5), 0.5 * share
        return state, cost


def _give_back_of(state: DriveState) -> None:
    """To the system what equations of so many unknowns were made of: else the heap's pieces stay beside what comes next."""
    if len(state.T_enu_node) > MANY_NODES:
        give_back()


def _moved(state: DriveState, step: gtsam.VectorValues, receiver: FloatArray) -> DriveState:
    values = state.values.retract(step)
    scale = np.array([values.atDouble(scale_key(k)) for k in range(len(state.scale))])
    places = np.array([values.atPoint3(antenna_key(k)) for k in range(len(state.place_enu))]).reshape(-1, 3)
    T = np.array([values.atPose3(pose_key(i)).matrix() for i in range(len(state.T_enu_node))])
    return DriveState(T, scale, receiver, places, values)


def _anchor_factors(chain: OdometryChain, noise: DriveNoise) -> gtsam.NonlinearFactorGraph:
    """Level, gauge and the guesses over losses: everything but odometry and GNSS."""
    graph = gtsam.NonlinearFactorGraph()
    gauge = _pose_sigmas(GAUGE_ROTATION_RAD, GAUGE_POSITION_M)
    graph.add(gtsam.PriorFactorPose3(pose_key(0), gtsam.Pose3(), gauge))
    for i in np.flatnonzero(~chain.connected).tolist():
        lost = _pose_sigmas(LOST_ROTATION_RAD, LOST_POSITION_M + 0.5 * float(chain.length_m[i]))
        step = gtsam.Pose3(se3.inverse(chain.T_world_node[i]) @ chain.T_world_node[i + 1])
        graph.add(gtsam.BetweenFactorPose3(pose_key(i), pose_key(i + 1), step, lost))
    up, camera_up = gtsam.Unit3(np.array([0.0, 0.0, 1.0])), gtsam.Unit3(np.array([0.0, -1.0, 0.0]))
    level = gtsam.noiseModel.Isotropic.Sigma(2, noise.level_rad)
    for node in chain.level:
        graph.add(gtsam.AttitudeFactorPose3(pose_key(int(node)), up, level, camera_up))
    return graph


def _pose_sigmas(rotation_rad: float, position_m: float) -> gtsam.noiseModel.Diagonal:
    return gtsam.noiseModel.Diagonal.Sigmas(np.array([rotation_rad] * 3 + [position_m] * 3))


def left_covariances(right: FloatArray, T_enu_node: FloatArray) -> FloatArray:
    """(K, 6, 6) out of those of gtsam's right perturbations: T exp(xi) = exp(Ad_T xi) T, (omega, v) in the order (v, omega)."""
    Ad = se3.adjoint(T_enu_node)
    covariance = Ad @ right[:, V_OMEGA][:, :, V_OMEGA] @ np.swapaxes(Ad, -1, -2)
    return np.asarray(0.5 * (covariance + np.swapaxes(covariance, -1, -2)))
