"""Empirical Bayes shrinkage of a learnt lens towards the ideal camera: its own covariance decides how much of it is used.

How far rigs are off in general is not known; how far this one is, its lens says itself. With the shape P of the prior, a size tau
and the lens's difference x from the ideal camera's, of covariance C,

    x ~ N(0, C + tau^2 P),    tau by maximum marginal likelihood,    used = tau^2 P (C + tau^2 P)^-1 x

(Efron and Morris 1973, for one common size). A rig without fault has tau near 0 and keeps the ideal camera; of a rig with one, what
is known well is used as it is and what is hardly known stays near zero.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.calibration.settings import CalibrationSettings

FloatArray = NDArray[np.float64]
SIZES: Final = np.append(0.0, np.geomspace(1e-3, 3.0, 70))
"""Of tau that are tried; two neighbours differ by an eighth."""
STEP: Final = 1e-7
"""Parameters are whole multiples of it, so that the last bits of a linear algebra library decide nothing."""


def shrunk(x: FloatArray, covariance: FloatArray, settings: CalibrationSettings = CalibrationSettings()) -> FloatArray:
    """(10,) what to use of a lens's difference x (10,) from the ideal camera's, of this covariance (10, 10)."""
    unit = settings.lens.sigmas
    z, C = x / unit, covariance / np.outer(unit, unit)
    values, vectors = np.linalg.eigh(0.5 * (C + C.T))
    variance, projected = np.maximum(values, 1e-18), vectors.T @ z
    total = variance + SIZES[:, None] ** 2
    cost = (projected**2 / total + np.log(total)).sum(axis=1)
    tau2 = float(SIZES[int(np.argmin(cost))] ** 2)
    used = vectors @ (tau2 / (tau2 + variance) * projected) * unit
    return np.asarray(np.round(used / STEP) * STEP)
