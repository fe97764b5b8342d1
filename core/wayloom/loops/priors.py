"""Prior of the relative pose of two keyframes: by the odometry, or around a closure that is known."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.loops.settings import LoopSettings
from wayloom.registration.register import Prior

FloatArray = NDArray[np.float64]
LEAST_M, LEAST_RAD = 0.05, float(np.deg2rad(0.2))


@dataclass(frozen=True, slots=True)
class Closure:
    """A verified pair: first < second, rows in Keyframes; T_first_second (4, 4) of the cameras and its covariance (6, 6).

    alone : whether local features alone know the pose, beyond chance
    """

    first: int
    second: int
    T_first_second: FloatArray
    covariance: FloatArray
    alone: bool = False


def drift_covariance(road_m: float, T: FloatArray, settings: LoopSettings) -> FloatArray:
    """(6, 6) of the left perturbation of the odometry's T (4, 4) over so much road.

    The place's error is stated at the far end; a left perturbation turns about the near one, hence the adjoint.
    """
    place = LEAST_M + settings.drift_share * road_m
    angle = LEAST_RAD + np.deg2rad(settings.drift_deg_per_sqrt_m) * float(np.sqrt(road_m))
    shift = np.eye(4)
    shift[:3, 3] = T[:3, 3]
    Ad = se3.adjoint(shift)
    covariance: FloatArray = Ad @ np.diag([place**2] * 3 + [angle**2] * 3) @ Ad.T
    return covariance


def by_odometry(T_world_cam: FloatArray, road: FloatArray, i: int, j: int, settings: LoopSettings) -> Prior:
    """T_i_j of the cameras, T_world_cam (K, 4, 4), road (K,) m."""
    T = se3.inverse(T_world_cam[i]) @ T_world_cam[j]
    return Prior(T, drift_covariance(abs(float(road[j] - road[i])), T, settings))


def around(closure: Closure, T_world_cam: FloatArray, road: FloatArray, pair: tuple[int, int], settings: LoopSettings) -> Prior:
    """T_i_j of the pair by way of a closure: from i to its first keyframe, over it, and from its second to j."""
    i, j = pair
    T_i_first, T_second_j = (se3.inverse(T_world_cam[a]) @ T_world_cam[b] for a, b in ((i, closure.first), (closure.second, j)))
    T_i_second = T_i_first @ closure.T_first_second
    Ad_first, Ad_second = se3.adjoint(T_i_first), se3.adjoint(T_i_second)
    covariance = (
        drift_covariance(abs(float(road[closure.first] - road[i])), T_i_first, settings)
        + Ad_first @ closure.covariance @ Ad_first.T
        + Ad_second @ drift_covariance(abs(float(road[j] - road[closure.second])), T_second_j, settings) @ Ad_second.T
    )
    return Prior(T_i_second @ T_second_j, covariance)


def cycle_chi2(one: Closure, other: Closure, T_world_cam: FloatArray, road: FloatArray, settings: LoopSettings) -> float:
    """Chi-square, 6 degrees of freedom, of the cycle of two closures and the odometry between their ends."""
    prior = around(one, T_world_cam, road, (other.first, other.second), settings)
    xi = se3.log(other.T_first_second @ se3.inverse(prior.T_a_b))
    return float(xi @ np.linalg.solve(prior.covariance + other.covariance, xi))


def is_sure(closure: Closure, T_world_cam: FloatArray, road: FloatArray, settings: LoopSettings) -> bool:
    """Whether a closure needs no others beside it: features alone know it, and the odometry, being sure of the place, agrees.

    Features do not tell look-alike places apart; the odometry does.
    """
    road_m = abs(float(road[closure.second] - road[closure.first]))
    if not closure.alone or settings.drift_share * road_m > settings.max_prior_sigma_alone_m:
        return False
    return odometry_chi2(closure, T_world_cam, road, settings) <= settings.max_cycle_chi2


def odometry_chi2(closure: Closure, T_world_cam: FloatArray, road: FloatArray, settings: LoopSettings) -> float:
    """Chi-square, 6 degrees of freedom, of a closure against the odometry between its two ends."""
    prior = by_odometry(T_world_cam, road, closure.first, closure.second, settings)
    xi = se3.log(closure.T_first_second @ se3.inverse(prior.T_a_b))
    return float(xi @ np.linalg.solve(prior.covariance + closure.covariance, xi))


def is_unplaced(closure: Closure, road: FloatArray, settings: LoopSettings) -> bool:
    """Whether the odometry knows too little of a closure's place to tell it from others that look like it."""
    return settings.drift_share * abs(float(road[closure.second] - road[closure.first])) >= settings.max_prior_sigma_m
