"""Factor graph of one drive: odometry, GNSS and gravity, in the tangent plane of the drive's own place.

Unknowns: the pose T_enu_node of every node, the scale s of every stretch of odometry, the receiver's time offset and lever arm,
and for every fix that is kept the true place g of the antenna at that time.

- Odometry between neighbouring nodes: small white noise, and a scale that varies slowly (`wayloom.mapping.odometry_links`).
  After a loss the link is the constant-motion guess and nearly free, so the segments are held together by GNSS.
- GNSS: correlated noise, time offset and lever arm (`wayloom.mapping.gnss_factors`); stretches of fixes that lie apart are found
  first (`wayloom.mapping.fix_screening`) and left out.
- Gravity: a camera is roughly level. On a straight road GNSS cannot tell the roll about the track; this weak prior does.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from wayloom.mapping.drive_equations import CorrelatedFixes, DriveEquations, DriveState, left_covariances, marginal, scale_sigmas
from wayloom.mapping.drive_types import AntennaFixes, DriveNoise, DriveSolution, OdometryChain
from wayloom.mapping.fix_screening import screen
from wayloom.mapping.gnss_factors import receiver_key
from wayloom.mapping.odometry_links import OdometryLinks, links_of

FloatArray = NDArray[np.float64]
CLOCK_SIGMAS = 3.0
"""How far from zero the drive must see the receiver's clock before an offset is believed."""
HELD_CLOCK_S = 1e-6
"""Prior sigma of a clock that is held."""


def optimise_drive(chain: OdometryChain, fixes: AntennaFixes, T_enu_node: FloatArray, noise: DriveNoise) -> DriveSolution:
    """The most likely poses of a drive and their covariance.

    T_enu_node : (K, 4, 4) first guess
    Fixes that are found to lie apart are left out altogether; at least one fix is needed.
    """
    screened = screen(chain, fixes, T_enu_node, noise)
    kept = screened.fixes.take(np.flatnonzero(screened.inlier))
    links = links_of(chain, noise)
    equations = DriveEquations(chain, links, CorrelatedFixes(kept, noise), noise)
    state = equations.descend(equations.first_state(screened.T_enu_node, screened.receiver))
    tree = equations.tree(state)
    receiver_covariance = marginal(tree, receiver_key())
    if not clock_is_told(state.receiver[0], receiver_covariance[0, 0], noise):
        state = _with_clock_held(chain, links, kept, noise, state)
    covariance = left_covariances(tree, state.T_enu_node)
    covariance[:, :3, :3] += screened.unconfirmed_m**2 * np.eye(3)
    return DriveSolution(
        state.T_enu_node,
        covariance,
        1.0 + state.scale,
        scale_sigmas(tree, links.stretches),
        screened.inlier,
        fixes.residuals(state.T_enu_node, state.receiver),
        state.receiver,
        receiver_covariance,
        screened.noise_ratio,
        screened.shifted,
        screened.unconfirmed_m,
    )


def clock_is_told(time_offset_s: float, variance_s2: float, noise: DriveNoise) -> bool:
    """Whether the drive itself says that the receiver's clock is off: the score of zero, with the prior taken out again.

    On a straight road at one speed an offset is a shift along the road, which only the prior denies; the estimate is then what
    noise makes of it, and zero is the better guess. What could not be told stays in the covariance either way.
    """
    information = 1.0 / variance_s2 - 1.0 / noise.time_offset_s**2
    if information <= 0.0:
        return False
    return (time_offset_s / variance_s2) ** 2 / information > CLOCK_SIGMAS**2


def _with_clock_held(
    chain: OdometryChain, links: OdometryLinks, fixes: AntennaFixes, noise: DriveNoise, state: DriveState
) -> DriveState:
    """The most likely state with the receiver's stamps as they are."""
    held = replace(noise, time_offset_s=HELD_CLOCK_S)
    equations = DriveEquations(chain, links, CorrelatedFixes(fixes, held), held)
    return equations.descend(replace(state, receiver=state.receiver * [0.0, 1.0, 1.0, 1.0]))
