"""Drift of the receiver's clock against the cameras': the profile of one more unknown of a drive's equations.

Stamps that are late by tau + d (t - t_0), t_0 the middle of the fixes' times, have moved each antenna by d (t - t_0) of its
velocity more. At a given d the equations are what they are without, so the least cost over all other unknowns is a parabola in
d, to first order, and three of its points give the estimate and its sigma. A drift is no unknown of every drive, as the clock's
offset is: few clocks drift by what a drive can see.
"""

from copy import copy
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.mapping.drive_equations import CorrelatedFixes, DriveEquations, DriveState
from wayloom.mapping.gnss_factors import receiver_covariance

FloatArray = NDArray[np.float64]
STEP: Final = 1e-4
"""Of the parabola, s/s: ten times what a free quartz drifts by."""
PULSE_S: Final = 0.005
"""Prior sigma of the clock's offset under which the clocks are known to be one."""
LEAST_S: Final = 10.0
"""Duration of the fixes under which an offset is all there is to tell."""


@dataclass(frozen=True, slots=True)
class ClockDrift:
    """drift s/s, its sigma, by the drive alone; per_sigma (K, 6) left perturbation (v, omega) of the nodes by one sigma of it."""

    drift: float
    sigma: float
    per_sigma: FloatArray

    @property
    def sigmas(self) -> float:
        """How far from zero the drive sees it."""
        return abs(self.drift) / self.sigma


def clock_drift(equations: DriveEquations, at: DriveState) -> ClockDrift | None:
    """The drift that the drive sees, from the minimum without one; None where it is too short or tells nothing, or where one pulse
    triggers both clocks."""
    assert isinstance(equations.fixes, CorrelatedFixes)
    t_s = equations.fixes.fixes.t_s
    clock_s = float(np.sqrt(receiver_covariance(equations.noise)[0, 0]))
    if t_s[-1] - t_s[0] < LEAST_S or clock_s < PULSE_S:
        return None
    low, high = (_with_drift(equations, drift) for drift in (-STEP, STEP))
    states = low.descend(at, 1), high.descend(at, 1)
    costs = low.cost(states[0]), equations.cost(at), high.cost(states[1])
    bend = (costs[0] - 2.0 * costs[1] + costs[2]) / STEP**2
    if bend <= 0.0:
        return None
    drift = -0.5 * (costs[2] - costs[0]) / STEP / bend
    apart = np.array([se3.log(T) for T in states[1].T_enu_node @ se3.inverse(states[0].T_enu_node)])
    sigma = float(bend**-0.5)
    return ClockDrift(float(drift), sigma, apart * (sigma / (2.0 * STEP)))


def _with_drift(equations: DriveEquations, drift: float) -> DriveEquations:
    out = copy(equations)
    assert isinstance(equations.fixes, CorrelatedFixes)
    fixes = equations.fixes.fixes
    late_s = drift * (fixes.t_s - 0.5 * (fixes.t_s[0] + fixes.t_s[-1]))
    moved = late_s[:, None] * fixes.v_node_gnss
    out.fixes = replace(equations.fixes, fixes=replace(fixes, p_node_gnss=fixes.p_node_gnss - moved))
    return out
