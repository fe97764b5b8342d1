"""Global test of a placed drive: fixes that do not belong to it give it no place, whatever sigma is stated.

Screening believes the fixes that agree best. Where none of them is of this drive (another drive's, a receiver that is stuck, a
clock that is seconds off) something is still the best, and its sigma is that of a model that does not hold. It shows in what the
model would have to be: a scale or a clock that no prior allows, or residuals as large as the drive that the receiver's own sigmas
deny.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.mapping.drive_types import AntennaFixes, DriveNoise, DriveSolution

FloatArray = NDArray[np.float64]
DOUBTFUL_SHARE: Final = 0.5
"""Of the fixes, or of a drive's meetings: where more are rejected, all are in doubt."""
DENIED_SIGMAS: Final = 6.0
"""Of a prior, beyond which scale or clock are not believed."""
LEAST_SCALE_SIGMA, LEAST_CLOCK_SIGMA_S = 0.02, 0.05
"""However well rig and clock are said to be known, the drive is not refused for less."""
DENIED_ROAD: Final = 0.25
"""Share of the drive whose scale has to be denied: a stretch that was tracked badly is no reason."""
UNEXPLAINED_SHARE, UNEXPLAINED_M = 0.2, 10.0
"""Median residual, of the drive's extent and in m, from which on the odometry explains nothing of the fixes."""
UNEXPLAINED_SIGMAS: Final = 3.0
"""How many times what the receiver states it must be as well."""
REMEDY: Final = "not placed, map in the drive's own frame; look at the fixes with `wayloom inspect`"


def why_not_placed(fixes: AntennaFixes, solution: DriveSolution, noise: DriveNoise) -> str | None:
    """What denies the place of a drive, in words; None where nothing does.

    fixes : with the covariances that the receiver states
    """
    return _apart(fixes, solution) or _impossible_clock(solution, noise) or _impossible_scale(solution, noise)


def why_doubted(fixes: AntennaFixes, solution: DriveSolution) -> str | None:
    """What makes the fixes as a whole doubtful, in words: most of them contradict the odometry, and those that agree prove no more
    than the others. None where most are believed."""
    rejected = int((~solution.inlier).sum())
    if rejected <= DOUBTFUL_SHARE * len(fixes):
        return None
    return f"{rejected} of {len(fixes)} fixes contradict the odometry: one of the two is wrong, and all are laid aside: {REMEDY}"


def _apart(fixes: AntennaFixes, solution: DriveSolution) -> str | None:
    """Horizontally, all fixes: what was left out is a reason too."""
    residual_m = float(np.median(np.linalg.norm(solution.residual_enu[:, :2], axis=1)))
    place = solution.T_enu_node[:, :2, 3]
    extent_m = float(np.median(np.linalg.norm(place - np.median(place, axis=0), axis=1)))
    stated_m = float(np.median(np.sqrt(np.trace(fixes.covariance[:, :2, :2], axis1=1, axis2=2))))
    if residual_m <= max(UNEXPLAINED_M, UNEXPLAINED_SHARE * extent_m, UNEXPLAINED_SIGMAS * stated_m):
        return None
    return (
        f"the GNSS fixes do not belong to this drive: they lie {residual_m:.0f} m from it in the median where the receiver states "
        f"{stated_m:.2f} m, and the drive itself extends no more than {extent_m:.0f} m about its middle: {REMEDY}"
    )


def _impossible_clock(solution: DriveSolution, noise: DriveNoise) -> str | None:
    offset_s = float(solution.receiver[0])
    if abs(offset_s) <= DENIED_SIGMAS * max(noise.time_offset_s, LEAST_CLOCK_SIGMA_S):
        return None
    side = "late" if offset_s > 0.0 else "early"
    return (
        f"the GNSS fixes fit this drive only if the receiver's clock is {abs(offset_s):.1f} s or more {side}: "
        f"{REMEDY} and correct their time stamps"
    )


def _impossible_scale(solution: DriveSolution, noise: DriveNoise) -> str | None:
    if not len(solution.scale):
        return None
    off = np.abs(solution.scale - 1.0)
    if (off > DENIED_SIGMAS * max(noise.scale_sigma, LEAST_SCALE_SIGMA)).mean() <= DENIED_ROAD:
        return None
    percent = 100.0 * float(np.quantile(off, 1.0 - DENIED_ROAD))
    return f"the GNSS fixes fit this drive only if the odometry's scale is off by {percent:.0f} %: {REMEDY}"
