"""Joint of two parts of a drive: relative pose of their world frames from the frames that both tracked, a robust mean.

Both parts say how camera c, in the middle of what they share, stands to any other frame i that they share. So each frame gives
D_i = T_c_world T_world_i T_i_world' T_world'_c, before and after the joint told apart by the dash: the pose of the later part's
camera c in the earlier part's, identity where the two agree. They scatter about their mean by what the parts' errors within the
overlap differ; errors that last for many frames make the mean worse than independent ones would, and its covariance says so.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3

FloatArray = NDArray[np.float64]
CAUCHY: Final = 2.4
"""Scaled deviations at which a frame's weight is a half; 95 % efficient for normal errors."""
ITERATIONS: Final = 30
SMALLEST_SIGMA: Final = 1e-6
"""m and rad: scatter below it is rounding."""
LEAST_WAY_M: Final = 5.0
"""That tells a scale."""
LEAST_FRAMES: Final = 8
"""Of an overlap that tells a joint and its noise: more than the six numbers of a pose."""


@dataclass(frozen=True, slots=True)
class Joint:
    """T_before_after (4, 4): the later part's world in the earlier one's.

    covariance    (6, 6) of the perturbation exp(xi) of D, xi = (v, omega) in metres and radians, in the axes of camera c
    scale_ratio   length of the way in the overlap by the later part over that by the earlier one; NaN where the car hardly moved
    frames        that it is the mean of
    """

    T_before_after: FloatArray
    covariance: FloatArray
    scale_ratio: float
    frames: int


def joint(T_before: FloatArray, T_after: FloatArray) -> Joint:
    """The joint of two parts by the poses (n, 4, 4) T_world_cam that each has of the same n >= LEAST_FRAMES frames in a row."""
    middle = len(T_before) // 2
    D = se3.inverse(T_before[middle]) @ T_before @ se3.inverse(T_after) @ T_after[middle]
    mean, covariance = robust_mean(D)
    T_before_after = T_before[middle] @ mean @ se3.inverse(T_after[middle])
    return Joint(T_before_after, covariance, _scale_ratio(T_before, T_after), len(T_before))


def robust_mean(T: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean of poses T (n, 4, 4) that are near each other, in their order, and its covariance (6, 6) for T = exp(xi) mean.

    Cauchy weights by the deviations over their medians (Huber and Ronchetti, Robust Statistics, 2009). The covariance is that of
    an M-estimator, times how much less n correlated deviations tell than independent ones: (1 + rho) / (1 - rho), rho the
    correlation of neighbours, as of a first-order autoregression.
    """
    mean = T[len(T) // 2]
    for _ in range(ITERATIONS):
        xi = _deviations(T, mean)
        weight = _weights(xi)
        step = weight @ xi / weight.sum()
        mean = se3.exp(step) @ mean
        if np.abs(step).max() < 1e-3 * SMALLEST_SIGMA:
            break
    xi = _deviations(T, mean)
    weight = _weights(xi)
    weighted = weight[:, None] * xi
    slope = weight.sum() - (weight * (1.0 - weight)).sum() / 3.0  # of weight * deviation, mean over the six directions
    covariance = weighted.T @ weighted / slope**2 * _correlated(weighted)
    return mean, covariance + SMALLEST_SIGMA**2 * np.eye(6)


def _deviations(T: FloatArray, mean: FloatArray) -> FloatArray:
    """(n, 6) xi of T (n, 4, 4) = exp(xi) mean."""
    return np.array([se3.log(each) for each in T @ se3.inverse(mean)])


def _weights(xi: FloatArray) -> FloatArray:
    """(n,) Cauchy weights of deviations (n, 6), in units of their medians' normal sigma."""
    sigma = np.maximum(1.4826 * np.median(np.abs(xi), axis=0), SMALLEST_SIGMA)
    return np.asarray(1.0 / (1.0 + ((xi / sigma) ** 2).mean(axis=1) / CAUCHY**2))


def _correlated(xi: FloatArray) -> float:
    """How many times less deviations xi (n, 6) in a row tell of their mean than independent ones would; at most n times."""
    n = len(xi)
    unit = xi / np.maximum(xi.std(axis=0), SMALLEST_SIGMA)
    found = float((unit[1:] * unit[:-1]).sum() / max((unit**2).sum(), 1e-12))
    rho = min(max((n * found + 1.0) / (n - 3.0), 0.0), 1.0 - 2.0 / (n + 1.0))  # taken about their own mean, they seem less alike
    return (1.0 + rho) / (1.0 - rho)


def _scale_ratio(T_before: FloatArray, T_after: FloatArray) -> float:
    """Of the later part's way over the earlier one's, by least squares after rotation; see `Joint`."""
    R = T_before[:, :3, :3] @ np.swapaxes(T_after[:, :3, :3], 1, 2)
    before, after = (T[:, :3, 3] - T[:, :3, 3].mean(axis=0) for T in (T_before, T_after))
    if np.linalg.norm(before, axis=1).max() < LEAST_WAY_M / 2:
        return float("nan")
    return float((before * np.einsum("nij,nj->ni", R, after)).sum() / (before**2).sum())
