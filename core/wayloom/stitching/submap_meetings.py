"""Meetings of submaps from pairs of views: one for each stretch of road that two share, with the drift of both odometries."""

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.loops.priors import Closure
from wayloom.stitching.meeting_settings import MeetingSettings
from wayloom.stitching.placed_drive import PlacedDrive
from wayloom.stitching.types import Meeting

FloatArray = NDArray[np.float64]
ROUNDS = 5


def meetings_of(a: PlacedDrive, b: PlacedDrive, pairs: list[Closure], settings: MeetingSettings) -> list[Meeting]:
    """One meeting for each stretch of road of each pair of submaps that pairs of views join; pairs count rows of a's keyframes and
    behind them of b's."""
    groups: dict[tuple[int, int], list[Closure]] = {}
    for pair in pairs:
        key = int(a.submap_of[pair.first]), int(b.submap_of[pair.second - len(a.places)])
        groups.setdefault(key, []).append(pair)
    return [meeting for key in sorted(groups) for meeting in _of_two_submaps(a, b, key, groups[key], settings)]


def _of_two_submaps(
    a: PlacedDrive, b: PlacedDrive, submaps: tuple[int, int], pairs: list[Closure], settings: MeetingSettings
) -> list[Meeting]:
    """Pairs within `independent_m` of road share their views: together they count as one, however they are cut into stretches."""
    road = float(np.ptp([a.road[pair.first] for pair in pairs]))
    parts = stretches(a, pairs, settings)
    each = (1.0 + road / settings.independent_m) / len(parts)
    return [meeting_of(a, b, submaps, part, settings, each) for part in parts]


def stretches(a: PlacedDrive, pairs: list[Closure], settings: MeetingSettings) -> list[list[Closure]]:
    """The pairs by equal stretches of a's road, as many as the road has independent looks, one more for each `independent_m`.

    Each has at least as many pairs as must agree anywhere: one with fewer is joined with the next.
    """
    ordered = sorted(pairs, key=lambda pair: (a.road[pair.first], pair.second))
    road = np.array([a.road[pair.first] for pair in ordered])
    count = 1 + int(np.ptp(road) / settings.independent_m)
    piece = np.minimum(((road - road[0]) / max(np.ptp(road), 1e-9) * count).astype(int), count - 1)
    parts: list[list[Closure]] = []
    for number in range(count):
        part = [pair for pair, own in zip(ordered, piece, strict=True) if own == number]
        if parts and min(len(part), len(parts[-1])) < settings.least_agreeing:
            parts[-1] += part
        else:
            parts.append(part)
    return parts


def meeting_of(
    a: PlacedDrive, b: PlacedDrive, submaps: tuple[int, int], pairs: list[Closure], settings: MeetingSettings, independent: float
) -> Meeting:
    """The mean of what the pairs say of two submaps, by their information, as sure as so many of them that err apart."""
    T, covariances = zip(*(of_submaps(a, b, pair, settings) for pair in pairs), strict=True)
    information = np.array([np.linalg.inv(covariance) for covariance in covariances])
    total = information.sum(axis=0)
    mean = T[int(np.argmax([np.linalg.slogdet(W)[1] for W in information]))]
    for _ in range(ROUNDS):
        pull = sum(W @ se3.log(each @ se3.inverse(mean)) for W, each in zip(information, T, strict=True))
        mean = se3.exp(np.asarray(np.linalg.solve(total, pull))) @ mean
    covariance = np.linalg.inv(total) * (len(pairs) / min(float(len(pairs)), independent))
    return Meeting(a.drive_id, submaps[0], b.drive_id, submaps[1], mean, 0.5 * (covariance + covariance.T))


def of_submaps(a: PlacedDrive, b: PlacedDrive, pair: Closure, settings: MeetingSettings) -> tuple[FloatArray, FloatArray]:
    """T_a_b (4, 4) of the submaps' frames, and the covariance (6, 6) of its left perturbation.

    T_a_b = T_a_first T_first_second T_second_b; both outer ones err by drift, and by as much as the drive's graph bends them.
    """
    second = pair.second - len(a.places)
    bend_a, bend_b = a.bend[pair.first], b.bend[second]
    T_a_first, T_second_b = a.T_submap_cam[pair.first], se3.inverse(b.T_submap_cam[second])
    T_a_second = T_a_first @ pair.T_first_second
    Ad_first, Ad_second = se3.adjoint(T_a_first), se3.adjoint(T_a_second)
    of_b = se3.adjoint(T_a_second @ T_second_b) @ bend_b
    covariance: FloatArray = (
        drift_within(T_a_first, settings)
        + np.outer(bend_a, bend_a)
        + np.outer(of_b, of_b)
        + Ad_first @ pair.covariance @ Ad_first.T
        + Ad_second @ drift_within(T_second_b, settings) @ Ad_second.T
    )
    return T_a_second @ T_second_b, covariance


def drift_within(T: FloatArray, settings: MeetingSettings) -> FloatArray:
    """(6, 6) of the left perturbation of a pose T (4, 4) within a submap, by the way as the crow flies.

    The place's error is stated at the far end; a left perturbation turns about the near one, hence the adjoint.
    """
    way_m = float(np.linalg.norm(T[:3, 3]))
    place, angle = settings.drift_share * way_m, np.deg2rad(settings.drift_deg_per_sqrt_m) * np.sqrt(way_m)
    shift = np.eye(4)
    shift[:3, 3] = T[:3, 3]
    Ad = se3.adjoint(shift)
    covariance: FloatArray = Ad @ np.diag([place**2] * 3 + [angle**2] * 3) @ Ad.T
    return covariance
