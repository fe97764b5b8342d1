"""Baseline and lens of a rig by the scale of drives with RTK: a linear Gaussian update of what the images say.

A drive that was tracked with the lens x_d and the log baseline ratio b_d, and whose road GNSS finds to be r times as long, says

    log r + a_d^T x_d + b_d = a_d^T x + b,     a_d = d log length / d x  (`wayloom.calibration.scale`),

of the rig's lens x and baseline b. One drive tells the sum alone: drives whose a_d differ (narrow streets, wide ones) tell x and b
apart, and so does what the images say of x. Focal length of both cameras is in b: along the road the two are one.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.calibration.residuals import LENS
from wayloom.calibration.scale import FLOOR

FloatArray = NDArray[np.float64]
GATE_SIGMA: Final = 4.0
"""A drive whose scale is farther from what all say is left out: its GNSS was wrong."""


@dataclass(frozen=True, slots=True)
class ScaleByGnss:
    """Of one drive. ratio: metres of road per metre of odometry, sigma: of it by GNSS alone; the rest as of `scale.scale_facts`."""

    ratio: float
    sigma: float
    by_lens: FloatArray
    own_sigma: float
    lens: FloatArray
    baseline_ratio: float

    @classmethod
    def from_facts(cls, facts: Mapping[str, Any]) -> "ScaleByGnss":
        """As JSON keeps it, and as `wayloom.georeference.scale_prior.scale_by_gnss` makes it."""
        return cls(
            float(facts["ratio"]), float(facts["sigma"]), np.array(facts["by_lens"], float), float(facts["own_sigma"]),
            np.array(facts["lens"], float), float(facts["baseline_ratio"]),
        )  # fmt: skip


def with_gnss(x: FloatArray, covariance: FloatArray, drives: Sequence[ScaleByGnss]) -> tuple[FloatArray, FloatArray, int]:
    """Lens x (10,) and log baseline ratio as one (11,), their covariance (11, 11), and how many drives were used.

    covariance : (11, 11) before: of the lens by images, and of the ratio by what is believed of the given baseline
    """
    mean, left = np.append(x, 0.0), list(drives)
    while left:
        H = np.array([np.append(drive.by_lens, 1.0) for drive in left])
        y = np.array([np.log(drive.ratio) + drive.by_lens @ drive.lens + np.log(drive.baseline_ratio) for drive in left])
        noise = np.array([drive.sigma**2 + drive.own_sigma**2 + FLOOR**2 for drive in left])
        S = H @ covariance @ H.T + np.diag(noise)
        gain = np.linalg.solve(S, H @ covariance).T
        found, after = mean + gain @ (y - H @ mean), covariance - gain @ H @ covariance
        off = np.abs(y - H @ found) / np.sqrt(noise)
        if len(left) < 3 or off.max() <= GATE_SIGMA:
            return found, np.asarray(0.5 * (after + after.T)), len(left)
        left.pop(int(np.argmax(off)))
    return mean, covariance, 0


def joint_covariance(of_lens: FloatArray, baseline_sigma: float) -> FloatArray:
    """(11, 11) of lens (10, 10) and log baseline ratio, which know nothing of each other."""
    out = np.zeros((LENS + 1, LENS + 1))
    out[:LENS, :LENS], out[LENS, LENS] = of_lens, baseline_sigma**2
    return out
