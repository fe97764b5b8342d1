"""Marginal likelihood of the height of an antenna over its camera, where nobody measured it.

A lever arm that turns with an attitude that is uncertain itself makes the equations bilinear: with a high antenna a little roll
explains any error of a fix across the road, so the joint maximum over heights and attitudes runs away to antennas that are metres
too high or too low (Neyman and Scott, Econometrica 1948). With all else integrated out there is no such gain: at a given height h
the other unknowns x are Gaussian, and
    -log p(h | fixes) = h^2 / (2 sigma^2) + min_x cost(x; h) + 1/2 log det H(h) + const,
H their normal matrix. A parabola through three heights is enough, once about the prior and once about what that gave.
"""

from copy import copy
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.mapping.drive_equations import CorrelatedFixes, DriveEquations, DriveState
from wayloom.mapping.gnss_factors import receiver_covariance, with_held

FloatArray = NDArray[np.float64]
DOWN: Final = 2
"""Row of the receiver's unknowns that is the antenna's place along the camera's downward axis, about which roll swings it."""
LOOSE_M: Final = 0.2
"""Prior sigma from which on roll and height are told apart like this: below, what roll could gain by a height is under its own
sigma."""
HELD_M: Final = 1e-4
ROUNDS: Final = 2


@dataclass(frozen=True, slots=True)
class AntennaHeight:
    """down_m: of the antenna, beyond what its fixes were made with, and its sigma; by both, to first order, the nodes (K, 6), left
    perturbation (v, omega) a metre, and the receiver (4,) a metre follow."""

    down_m: float
    sigma_m: float
    nodes_per_m: FloatArray
    receiver_per_m: FloatArray


def is_loose(equations: DriveEquations) -> bool:
    """Whether the height of the antenna is known so little that it has to be told apart from roll."""
    return bool(receiver_covariance(equations.noise)[DOWN, DOWN] > LOOSE_M**2)


def without_height(receiver: FloatArray) -> FloatArray:
    """(4,) the receiver's unknowns where the height is held and not one of them."""
    return np.asarray(np.where(np.arange(len(receiver)) == DOWN, 0.0, receiver))


def held_at(equations: DriveEquations, down_m: float) -> DriveEquations:
    """The equations with an antenna that is held so many metres further down in the camera's frame than its fixes say."""
    out = copy(equations)
    assert isinstance(equations.fixes, CorrelatedFixes)
    fixes = equations.fixes.fixes
    lower = replace(fixes, p_node_gnss=fixes.p_node_gnss + fixes.R_node_cam @ np.array([0.0, down_m, 0.0]))
    out.fixes, out.noise = replace(equations.fixes, fixes=lower), with_held(equations.noise, DOWN, HELD_M)
    return out


def antenna_height(equations: DriveEquations, start: DriveState) -> AntennaHeight:
    """The posterior of the antenna's height as a Gaussian, from a state near the minimum."""
    prior_sigma_m = float(np.sqrt(receiver_covariance(equations.noise)[DOWN, DOWN]))
    start = replace(start, receiver=without_height(start.receiver))
    mean, sigma = 0.0, prior_sigma_m
    for _ in range(ROUNDS):
        heights = mean + sigma * np.array([-1.0, 0.0, 1.0])
        minima = [_minimum(held_at(equations, h), start) for h in heights.tolist()]
        values = np.array([one.negative_log for one in minima]) + 0.5 * (heights / prior_sigma_m) ** 2
        slope, bend = 0.5 * (values[2] - values[0]) / sigma, (values[0] - 2.0 * values[1] + values[2]) / sigma**2
        bend = max(bend, prior_sigma_m**-2)  # fixes never make a height less certain
        mean, sigma = mean - slope / bend, bend**-0.5
    low, _, high = minima
    apart = heights[2] - heights[0]
    moved = np.array([se3.log(T) for T in high.T_enu_node @ se3.inverse(low.T_enu_node)]) / apart
    by_receiver = (high.receiver - low.receiver) / apart
    by_receiver[DOWN] = 1.0
    return AntennaHeight(float(mean), float(sigma), moved, by_receiver)


class _Minimum(NamedTuple):
    """- log of the marginal likelihood, but for a constant; T_enu_node (K, 4, 4) and receiver (4,) where the cost is least."""

    negative_log: float
    T_enu_node: FloatArray
    receiver: FloatArray


def _minimum(equations: DriveEquations, start: DriveState) -> _Minimum:
    """Of the equations, found from a state. No more of it than is asked for: states of a long drive are large."""
    state = equations.descend(start)
    negative_log = equations.cost(state) + equations.square_root(state).half_log_determinant()
    return _Minimum(negative_log, state.T_enu_node, state.receiver)
