"""GNSS fixes whose errors have heavy tails: Student's t by expectation and maximisation (Lange, Little and Taylor, JASA 1989).

Where most fixes contradict the odometry there are no bursts among good fixes: the receiver stands between houses, and its claims
are wrong everywhere. Then no fix is left out. Each has a variance of its own about a common one that the residuals tell, so that
the drive lies where fixes are dense, not at their mean.

With d_k^2 the squared residual in claimed sigmas and kappa^2 the common inflation,
    u_k = (nu + 3) / (nu + d_k^2 / kappa^2),    kappa^2 = mean(u_k d_k^2) / 3,
and the poses minimise sum u_k d_k^2 / (kappa^2 n) beside the odometry, n the fixes within a correlation time to either side.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wayloom.mapping.drive_equations import DriveEquations, IndependentFixes
from wayloom.mapping.drive_types import AntennaFixes, DriveNoise, OdometryChain
from wayloom.mapping.gnss_factors import RECEIVER
from wayloom.mapping.odometry_links import links_of

FloatArray = NDArray[np.float64]
DEGREES_OF_FREEDOM = 1.0
ROUNDS, SOLVES, SETTLED = 30, 2, 1e-3


@dataclass(frozen=True, slots=True)
class HeavyTails:
    """fixes with covariances that hold the tails; inflation: times the claimed sigma that most of them scatter; T_enu_node
    (K, 4, 4) and receiver (4,) of the solution."""

    fixes: AntennaFixes
    inflation: float
    T_enu_node: FloatArray
    receiver: FloatArray


def heavy_tailed(chain: OdometryChain, fixes: AntennaFixes, T_enu_node: FloatArray, noise: DriveNoise) -> HeavyTails:
    """All fixes, with the variances that their residuals about the odometry tell, from a first guess T_enu_node (K, 4, 4)."""
    links, crowd = links_of(chain, noise), _crowd(fixes.t_s, noise.correlation_s)
    distance2 = _distance2(fixes, fixes.residuals(T_enu_node, np.zeros(RECEIVER)))
    kappa2 = max(float(np.median(distance2)) / 3.0, 1.0)
    state = None
    for _ in range(ROUNDS):
        u = (DEGREES_OF_FREEDOM + 3.0) / (DEGREES_OF_FREEDOM + distance2 / kappa2)
        equations = DriveEquations(chain, links, IndependentFixes(fixes, u / (kappa2 * crowd)), noise)
        state = equations.descend(equations.first_state(T_enu_node) if state is None else state, SOLVES)
        distance2 = _distance2(fixes, fixes.residuals(state.T_enu_node, state.receiver))
        before, kappa2 = kappa2, max(float((u * distance2).mean()) / 3.0, 1.0)
        if abs(kappa2 / before - 1.0) < SETTLED:
            break
    assert state is not None
    return HeavyTails(_inflated(fixes, kappa2, u, noise.correlation_s), float(np.sqrt(kappa2)), state.T_enu_node, state.receiver)


def _distance2(fixes: AntennaFixes, residual: FloatArray) -> FloatArray:
    """(M,) squared residuals (M, 3) in claimed sigmas."""
    return np.asarray(np.einsum("ni,ni->n", residual, np.linalg.solve(fixes.covariance, residual[:, :, None])[:, :, 0]))


def _crowd(t_s: FloatArray, correlation_s: float) -> FloatArray:
    """(M,) how many fixes share their error with each: those within a correlation time before and after."""
    low = np.searchsorted(t_s, t_s - correlation_s)
    return np.asarray(np.searchsorted(t_s, t_s + correlation_s, side="right") - low, np.float64)


def _inflated(fixes: AntennaFixes, kappa2: float, u: FloatArray, correlation_s: float) -> AntennaFixes:
    """Covariances inflated by kappa2 and by what the weights u (M,) of the fixes within half a correlation time say in the mean:
    it changes slowly, so that the correlated part stays one process."""
    low = np.searchsorted(fixes.t_s, fixes.t_s - 0.5 * correlation_s)
    high = np.searchsorted(fixes.t_s, fixes.t_s + 0.5 * correlation_s, side="right")
    total = np.concatenate([[0.0], np.cumsum(1.0 / u)])
    return replace(fixes, covariance=fixes.covariance * (kappa2 * (total[high] - total[low]) / (high - low))[:, None, None])
