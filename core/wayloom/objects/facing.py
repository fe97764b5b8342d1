"""Direction in which a sign's face looks, out of the normals that drives saw.

A drive that sees a sign's back tells it by the post before it, mostly: where drives contradict each other, normals are one axis
first, then the likelier of its ends.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
LEAST_SIGMA_RAD: Final = 0.02
DOUBTFUL_RAD: Final = 0.7
"""A direction with a greater sigma is not told."""


def azimuth(normals: FloatArray, sigmas: FloatArray) -> tuple[float, float] | None:
    """Direction, clockwise from north in [0, 2 pi), and its sigma, rad; None where it is not known.

    normals (n, 3) enu and their sigmas (n,) rad; NaN where one is not known
    """
    known = np.isfinite(sigmas) & np.isfinite(normals).all(axis=1)
    if not known.any():
        return None
    angle = np.arctan2(normals[known, 0], normals[known, 1])
    weight = 1.0 / np.maximum(sigmas[known], LEAST_SIGMA_RAD) ** 2
    axis = 0.5 * float(np.arctan2((weight * np.sin(2.0 * angle)).sum(), (weight * np.cos(2.0 * angle)).sum()))
    if (weight * np.cos(angle - axis)).sum() < 0.0:
        axis += np.pi
    off = np.arcsin(np.clip(np.sin(angle - axis), -1.0, 1.0))
    ratio = float((weight * off**2).sum() / max(len(off) - 1, 1))
    sigma = float(np.sqrt(max(1.0, ratio) / weight.sum()))
    return (axis % (2.0 * np.pi), max(sigma, LEAST_SIGMA_RAD)) if sigma < DOUBTFUL_RAD else None
