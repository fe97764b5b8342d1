"""Geo-referencing benchmark over five kilometres: RTK with outages and bursts, and single point fixes against what they allow.

With the noise of odometry, clock and fixes known as it was made, the stated sigma is the Cramer-Rao bound of the drive (all of it
is Gaussian and nearly linear): no unbiased estimate from these fixes and this odometry is better.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayloom.evaluation.gnss_drives import RATE_HZ, MadeDrive, Receiver, city_way, made_drive
from wayloom.georeference.alignment import georeference
from wayloom.georeference.settings import GeoReferenceSettings
from wayloom.georeference.uncertainty import position_covariance
from wayloom.logs.types import FixType
from wayloom.simulation.sensors.gnss import SLOW_S
from wayloom.simulation.vehicle.vehicle_settings import GnssBurst

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
SECONDS, SCALE_SIGMA = 440.0, 0.002
KNOWN = GeoReferenceSettings(
    gnss_correlation_s=SLOW_S, scale_sigma=SCALE_SIGMA, local_scale_sigma=SCALE_SIGMA, time_offset_sigma_s=0.0002
)
"""The noise as it is made."""
SCALE_KNOWN = KNOWN.model_copy(update={"scale_sigma": 1e-5, "local_scale_sigma": 1e-5})
"""The same where the odometry's scale does not wander at all."""
OUTAGES = ((60.0, 30.0), (170.0, 30.0), (290.0, 30.0))
BURSTS = tuple(GnssBurst(share=share, duration_s=8.0, size_m=size) for share, size in ((0.05, 5.0), (0.5, 2.0), (0.85, 11.0)))


@dataclass(frozen=True, slots=True)
class LongResult:
    """rms errors and stated sigmas, m, level and in height, of one drive's part."""

    name: str
    level_m: float
    height_m: float
    level_sigma_m: float
    height_sigma_m: float


def long_results(seed: int = 0) -> Iterator[LongResult]:
    """RTK outside and inside its outages; single point with the default settings and with the noise known."""
    rtk = made_drive(city_way(SECONDS), Receiver(outages=OUTAGES, bursts=BURSTS), seed, SCALE_SIGMA)
    t_s = np.arange(len(rtk.T_place_cam)) / RATE_HZ
    outage = np.any([(t_s >= start) & (t_s < start + length) for start, length in OUTAGES], axis=0)
    yield from _measured(rtk, GeoReferenceSettings(), {"RTK, outside outages": ~outage, "RTK, inside outages of 30 s": outage})
    single, every = made_drive(city_way(SECONDS), Receiver(FixType.SINGLE), seed, SCALE_SIGMA), np.ones(len(t_s), bool)
    yield from _measured(single, GeoReferenceSettings(), {"single point": every})
    yield from _measured(single, KNOWN, {"single point, noise known": every})


def bound_results(seeds: Sequence[int]) -> Iterator[LongResult]:
    """Single point fixes with all noise known as it is made, and with an odometry whose scale does not wander: the stated
    sigmas are the bounds, the errors one draw each."""
    for seed in seeds:
        for name, settings, scale_sigma in (("odometry as made", KNOWN, SCALE_SIGMA), ("its scale known", SCALE_KNOWN, 1e-5)):
            drive = made_drive(city_way(SECONDS), Receiver(FixType.SINGLE), seed, scale_sigma)
            yield from _measured(drive, settings, {f"single point, {name}, seed {seed}": np.ones(len(drive.T_place_cam), bool)})


def _measured(drive: MadeDrive, settings: GeoReferenceSettings, parts: dict[str, BoolArray]) -> Iterator[LongResult]:
    geo = georeference(drive.log, drive.odometry, settings=settings)  # type: ignore[arg-type]
    assert geo.frame is not None
    error2 = (geo.T_enu_cam[:, :3, 3] - drive.truth_in(geo.frame)[:, :3, 3]) ** 2
    variance = np.diagonal(position_covariance(geo.T_enu_cam, geo.covariance), axis1=1, axis2=2)
    for name, rows in parts.items():
        yield LongResult(name, *(_rms(of[rows][:, axes]) for of in (error2, variance) for axes in ([0, 1], [2])))


def _rms(squares: FloatArray) -> float:
    return float(np.sqrt(squares.sum(axis=1).mean()))
