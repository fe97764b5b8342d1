"""Inputs, settings and solution of the pose graph."""

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
PLANAR_ROWS: Final = (0, 1, 5)
"""Of (v, omega), what moves in the plane z = 0."""


@dataclass(frozen=True, slots=True)
class PosePriors:
    """P poses whose place in the world is known.

    pose          (P,) rows of the poses
    T_world_prior (P, 4, 4)
    information   (P, 6, 6) inverse covariance of the left perturbation (v, omega) of T_world_prior; what is not known has none
    """

    pose: IntArray
    T_world_prior: FloatArray
    information: FloatArray


def no_priors() -> PosePriors:
    """None: the first pose stays where it is."""
    return PosePriors(np.zeros(0, np.int64), np.zeros((0, 4, 4)), np.zeros((0, 6, 6)))


@dataclass(frozen=True, slots=True)
class PoseGraph:
    """N poses and E measurements of steps between them. Several edges may join the same two poses: each is a witness.

    poses          N
    first, second  (E,) rows of the poses
    T_first_second (E, 4, 4) measured
    information    (E, 6, 6) inverse covariance of the left perturbation (v, omega) of T_first_second, 1/m^2 and 1/rad^2
    is_loop        (E,) edges that may be wrong altogether; the others are trusted
    priors         of poses; without any, poses are relative to the first one
    planar         whether all poses lie in the plane z = 0 with their z axes up: unknowns and errors are x, y and heading
    """

    poses: int
    first: IntArray
    second: IntArray
    T_first_second: FloatArray
    information: FloatArray
    is_loop: BoolArray
    priors: PosePriors = field(default_factory=no_priors)
    planar: bool = False

    def __len__(self) -> int:
        return len(self.first)


@dataclass(frozen=True, slots=True)
class SolverSettings:
    """How a pose graph is optimised.

    robust      whether loops are weighed; otherwise all edges are trusted
    confidence  of chi-square: what share of right loops lies below the error beyond which a loop is left out
    """

    robust: bool = True
    confidence: float = 0.9999
    max_iterations: int = 100
    converged: float = 1e-9


@dataclass(frozen=True, slots=True)
class PoseGraphSolution:
    """The most likely poses.

    T_world_node (N, 4, 4)
    cost         half of chi-square: of the edges by their weights, and of the priors
    weight       (E,) 1 for trusted edges, 0 … 1 for loops: 0 where it is left out
    chi2         (E,) of each edge, unweighted
    iterations   linear systems solved at full size
    start        the first guess that led here
    """

    T_world_node: FloatArray
    cost: float
    weight: FloatArray
    chi2: FloatArray
    iterations: int
    start: str
