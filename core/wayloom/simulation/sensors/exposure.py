"""Automatic exposure control: metering, shutter time and gain."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayloom.simulation.vehicle.vehicle_settings import ExposureSettings, LightChange

F32 = NDArray[np.float32]
ROAD_FROM = 0.35
"""Metering "road" looks below this share of the image's height: the sky does not count."""
DARKEST = 1e-3
FACTOR_LIMITS = (0.05, 20.0)


@dataclass(frozen=True, slots=True)
class Exposure:
    """exposure_s: time the shutter is open; gain of the amplifier; factor: what both do to radiance."""

    exposure_s: float
    gain: float
    factor: float


def metered(radiance: F32, settings: ExposureSettings) -> float:
    """Log-mean of the metered part of an image (h, w, 3)."""
    height, width = radiance.shape[:2]
    rows, columns = slice(0, height), slice(0, width)
    if settings.metering == "road":
        rows = slice(int(ROAD_FROM * height), height)
    elif settings.metering == "centre":
        rows, columns = slice(height // 4, height - height // 4), slice(width // 3, width - width // 3)
    seen = radiance[rows, columns][::4, ::4].mean(axis=-1)
    return float(np.exp(np.log(np.maximum(seen, DARKEST)).mean()))


def light_factor(changes: tuple[LightChange, ...], t_s: float) -> float:
    """Factor on all radiance at t_s after the drive's start; ramps are straight in its logarithm."""
    exponent = 0.0
    for change in changes:
        inside = min(t_s - change.from_s, change.to_s - t_s)
        share = float(inside >= 0) if change.ramp_s == 0 else float(np.clip(inside / change.ramp_s, 0, 1))
        exponent += share * float(np.log(change.factor))
    return float(np.exp(exponent))


def next_factor(previous: float | None, mean: float, step_s: float, settings: ExposureSettings) -> float:
    """Exposure factor step_s after `previous` (None: at the start), when the metered mean is `mean`."""
    wanted = float(np.clip((settings.target / mean) ** settings.compensation, *FACTOR_LIMITS))
    if previous is None or settings.time_constant_s == 0:
        return limited(wanted, settings)
    share = 1.0 - float(np.exp(-step_s / settings.time_constant_s))
    return limited(previous * (wanted / previous) ** share, settings)


def limited(factor: float, settings: ExposureSettings) -> float:
    """The factor within the limits of shutter and amplifier."""
    low, high = settings.shortest_s / settings.unit_s, settings.longest_s / settings.unit_s * settings.largest_gain
    return float(np.clip(factor, low, high))


def exposure_of(factor: float, settings: ExposureSettings) -> Exposure:
    """Shutter time and gain of a factor: the shutter first."""
    exposure_s = float(np.clip(factor * settings.unit_s, settings.shortest_s, settings.longest_s))
    gain = float(np.clip(factor * settings.unit_s / exposure_s, 1.0, settings.largest_gain))
    return Exposure(exposure_s, gain, exposure_s / settings.unit_s * gain)
