"""Wild fixes: single ones that lie far from their neighbours (Hampel's identifier, on the odometry's way).

Where a fifth of the fixes is thrown anywhere, half of all triples hold a wild one: neither their scatter nor their jumps tell
anything any more. So they are found first, by the median of the fixes around each, which half of them being wild does not move.
A burst is no such thing: most neighbours of its fixes are of it.
"""

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry.probability import chi_square_quantile
from wayloom.mapping.drive_types import AntennaFixes
from wayloom.mapping.gnss_factors import RECEIVER

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
AROUND = 11
"""Fixes whose median is compared with the middle one; at the drive's ends with one of the others."""
HEADING_RAD = 0.03
"""What the first guess's heading may be off by."""
WILD_PROBABILITY = 1.0 - 1e-5
"""Quantile of chi-square beyond which a fix is wild."""
MOST_WILD = 0.4
"""Share of the fixes from which on it is the receiver that is wild, and none is left out."""


def wild_fixes(fixes: AntennaFixes, T_enu_node: FloatArray) -> BoolArray:
    """(M,) whether a fix lies far from the median of those around it, beyond what all scatter, on poses T_enu_node (K, 4, 4)."""
    if len(fixes) < AROUND:
        return np.zeros(len(fixes), bool)
    first = np.clip(np.arange(len(fixes)) - AROUND // 2, 0, len(fixes) - AROUND)
    around = first[:, None] + np.arange(AROUND)
    residual = fixes.residuals(T_enu_node, np.zeros(RECEIVER))
    antenna = fixes.antenna_enu(T_enu_node, np.zeros(RECEIVER))
    off = residual - np.median(residual[around], axis=1)
    loose = HEADING_RAD * np.linalg.norm(antenna[around] - antenna[:, None], axis=2).max(axis=1)
    spread = fixes.covariance + np.median(fixes.covariance[around], axis=1) + loose[:, None, None] ** 2 * np.eye(3)
    distance2 = np.einsum("ni,ni->n", off, np.linalg.solve(spread, off[:, :, None])[:, :, 0])
    scatter2 = max(float(np.median(distance2)) / float(chi_square_quantile(0.5, 3)), 1.0)
    wild = np.asarray(distance2 > scatter2 * chi_square_quantile(WILD_PROBABILITY, 3))
    return wild if wild.mean() < MOST_WILD else np.zeros(len(fixes), bool)
