"""Prior of the GNSS receiver: what the log states, what the rig's earlier drives told, and what is believed without either."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.calibration.receiver import LearntReceiver, ReceiverEvidence, denied, fused, learnt_receiver, loosened
from wayloom.georeference.settings import GeoReferenceSettings
from wayloom.logs.types import DriveLog

FloatArray = NDArray[np.float64]
YEAR_2000_NS: Final = 946_684_800 * 10**9
"""Stamps before are no dates: many formats count from zero."""


@dataclass(frozen=True, slots=True)
class ReceiverPrior:
    """mean (4,) of time offset, s, and lever arm, m, in the left camera's frame; covariance (4, 4) of what is known, None where
    only the common prior is; stated: whether the log speaks of its clock; learnt: what the rig's drives told, None where none did;
    overruled: of clock and lever arm, whether the drives deny what the log states."""

    mean: FloatArray
    covariance: FloatArray | None
    stated: bool = False
    learnt: LearntReceiver | None = None
    overruled: tuple[bool, bool] = (False, False)


def receiver_prior(
    log: DriveLog, t_ns: int, settings: GeoReferenceSettings = GeoReferenceSettings(), evidence: Sequence[ReceiverEvidence] = ()
) -> ReceiverPrior:
    """What is known of a log's receiver before its drive is looked at.

    t_ns : when it was recorded; evidence : of the rig's other drives
    """
    stated = log.receiver.time_offset_sigma_s is not None
    mean = np.append(log.receiver.time_offset_s, log.p_cam_gnss)
    clock_s, lever_m = clock_sigma_s(log, settings), lever_sigma_m(log, settings)
    covariance = np.diag(np.square([clock_s, lever_m, lever_m, lever_m]))
    learnt = learnt_receiver(evidence, t_ns if t_ns > YEAR_2000_NS else None)
    if learnt is None:
        return ReceiverPrior(mean, covariance if stated or log.receiver.lever_sigma_m is not None else None, stated)
    overruled = denied(learnt.mean - mean, learnt.covariance, covariance)
    covariance = loosened(covariance, overruled, np.array([settings.time_offset_sigma_s, *[settings.unknown_lever_sigma_m] * 3]))
    return ReceiverPrior(*fused(mean, covariance, learnt), stated, learnt, overruled)


def clock_sigma_s(log: DriveLog, settings: GeoReferenceSettings) -> float:
    """Of the receiver's clock, s: as the log states it, else the common one."""
    stated = log.receiver.time_offset_sigma_s
    return settings.time_offset_sigma_s if stated is None else stated


def lever_sigma_m(log: DriveLog, settings: GeoReferenceSettings) -> float:
    """Of the lever arm, m, each axis: as the log states it, else that of one that is given, or is not."""
    stated = log.receiver.lever_sigma_m
    if stated is not None:
        return stated
    return settings.lever_sigma_m if log.p_cam_gnss.any() else settings.unknown_lever_sigma_m
