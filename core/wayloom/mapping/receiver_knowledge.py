"""Knowledge of the GNSS receiver against what the drive itself says of clock and lever arm.

What a log states or a rig's memory knows is a tight prior, and a Gaussian never lets go. So the drive is first solved without it;
the marginal of the receiver, with the wide prior taken out again, is what the drive alone says. Where that denies the knowledge
by more than both sigmas allow (`calibration.receiver.denied`), clock or lever arm count as unknown.
"""

from copy import copy
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.calibration.receiver import denied, estimate, loosened
from wayloom.mapping.drive_equations import DriveEquations
from wayloom.mapping.drive_types import DriveNoise, ReceiverTold
from wayloom.mapping.gnss_factors import receiver_covariance

FloatArray = NDArray[np.float64]
LOOSE_LEVER_M: Final = 1.5
"""Sigma of a lever arm that the drive denies, each axis."""


def told_by_drive(receiver: FloatArray, covariance: FloatArray, noise: DriveNoise) -> ReceiverTold:
    """What the drive alone says: of the solution's receiver (4,) and covariance (4, 4) with the prior of `noise` taken out."""
    both = np.linalg.inv(covariance)
    information = both - np.linalg.inv(receiver_covariance(noise))
    values, vectors = np.linalg.eigh(0.5 * (information + information.T))
    return ReceiverTold(np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T), np.asarray(both @ receiver))


def believed(told: ReceiverTold, known: FloatArray, noise: DriveNoise) -> tuple[FloatArray, tuple[bool, bool]]:
    """The covariance (4, 4) to solve with: the known one (4, 4), without what the drive denies; and whether it does, of clock and
    lever arm."""
    said, covariance = estimate(told.information, told.pull)
    overruled = denied(said, covariance, known)
    return loosened(known, overruled, np.array([noise.time_offset_s, *[LOOSE_LEVER_M] * 3])), overruled


def with_receiver(equations: DriveEquations, covariance: FloatArray) -> DriveEquations:
    """The same equations with another prior of the receiver (4, 4)."""
    out = copy(equations)
    out.noise = replace(equations.noise, receiver=covariance)
    return out
