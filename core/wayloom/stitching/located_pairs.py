"""Candidates where GNSS places both drives: views whose middles lie near each other by their places and covariances."""

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.registration.register import Prior
from wayloom.stitching.meeting_settings import MeetingSettings
from wayloom.stitching.placed_drive import PlacedDrive

FloatArray = NDArray[np.float64]


def prior_of_places(a: PlacedDrive, b: PlacedDrive, i: int, j: int) -> Prior:
    """T_i_j of the cameras by both drives' geo-references, whose errors are independent.

    T_i_j = T_i_enu exp(-xi_i) exp(xi_j) T_enu_j = exp(Ad(T_i_enu) (xi_j - xi_i)) T_i_enu T_enu_j
    """
    T_i_enu = se3.inverse(a.T_enu_cam[i])
    Ad = se3.adjoint(T_i_enu)
    return Prior(T_i_enu @ b.T_enu_cam[j], Ad @ (a.covariance(i) + b.covariance(j)) @ Ad.T)


def sigma_of_place(prior: Prior) -> float:
    """m: the largest standard deviation of where the second camera stands, seen from the first, in any direction."""
    J = np.concatenate([np.eye(3), -se3.hat(prior.T_a_b[:3, 3])], axis=1)
    return float(np.sqrt(np.linalg.eigvalsh(J @ prior.covariance @ J.T)[-1]))


def near_by_place(a: PlacedDrive, b: PlacedDrive, anchors: NDArray[np.int64], j: int, settings: MeetingSettings) -> list[int]:
    """Anchors of a whose views may see what b's view at j sees, the nearest first, those beside each other along the road once."""
    middles = a.T_enu_cam[a.middle[anchors], :3, 3]
    distance = np.linalg.norm((middles - b.T_enu_cam[b.middle[j], :3, 3])[:, :2], axis=1)
    nearest = int(anchors[int(np.argmin(distance))])
    sigma = sigma_of_place(prior_of_places(a, b, nearest, j))
    if sigma > settings.max_prior_sigma_m:
        return []
    reach = settings.near_m + settings.sigmas * sigma
    chosen: list[int] = []
    for row in np.argsort(distance, kind="stable"):
        i = int(anchors[row])
        if len(chosen) == settings.candidates or distance[row] > reach:
            break
        if all(abs(a.road[i] - a.road[k]) >= settings.scout_m for k in chosen):
            chosen.append(i)
    return chosen
