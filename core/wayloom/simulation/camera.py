"""From radiance to an image file's grey values: lens, exposure, sensor noise, response."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.geometry.camera import PinholeCamera

Radiance = NDArray[np.float32]
BLUR_PX = 0.5
VIGNETTE_POWER = 0.35
SHOT_NOISE, READ_NOISE2 = 2.2e-4, 2.5e-6
SHOULDER_FROM, SHOULDER_WIDTH = 0.75, 0.25
TOE_LOW, TOE_RISE, TOE_TOP = 0.55, 1.1, 1.18
DISPLAY_GAMMA = 2.2
TARGET_MEAN = 0.17
GAIN_LIMITS = (0.35, 2.6)
ADAPTED_SHARE = 0.12
"""How much of the way to the wanted gain the exposure control goes in one frame."""
METERED_FROM = 0.35
"""Exposure is metered below this share of the image's height: the sky does not count."""


@dataclass(frozen=True, slots=True)
class Sensor:
    """gain: factor on all radiance, which tells one camera of a pair from the other."""

    gain: float = 1.0


def wanted_gain(radiance: Radiance) -> float:
    """Gain that brings the metered part of an image to TARGET_MEAN, partly: dark scenes stay darker."""
    metered = radiance[int(METERED_FROM * len(radiance)) :: 4, ::4].mean(axis=-1)
    mean = float(np.exp(np.log(np.maximum(metered, 1e-3)).mean()))
    return float(np.clip((TARGET_MEAN / mean) ** 0.75, *GAIN_LIMITS))


def adapted(previous: float | None, wanted: float) -> float:
    """Gain of the next frame."""
    return wanted if previous is None else previous * (wanted / previous) ** ADAPTED_SHARE


def exposed(radiance: Radiance, gain: float, camera: PinholeCamera, sensor: Sensor, rng: np.random.Generator) -> NDArray[np.uint8]:
    """(h, w, 3) linear to (h, w, 3) uint8 RGB."""
    x = cv2.GaussianBlur(radiance, (0, 0), BLUR_PX)
    u, v = np.arange(camera.width, dtype=np.float32), np.arange(camera.height, dtype=np.float32)
    r2 = ((u[None] - camera.cx) / camera.fx) ** 2 + ((v[:, None] - camera.cy) / camera.fy) ** 2
    x = x * ((1 + r2) ** -VIGNETTE_POWER * gain * sensor.gain)[..., None].astype(np.float32)
    x += rng.standard_normal(x.shape, dtype=np.float32) * np.sqrt(
        np.maximum(x, 0) * np.float32(SHOT_NOISE) + np.float32(READ_NOISE2)
    )
    np.maximum(x, 0, out=x)
    bright = x > SHOULDER_FROM
    x[bright] = SHOULDER_FROM + (1 - np.exp(-(x[bright] - SHOULDER_FROM) / SHOULDER_WIDTH)) * SHOULDER_WIDTH
    x *= np.clip(TOE_LOW + TOE_RISE * np.sqrt(np.minimum(x, 1)), 0, TOE_TOP)
    return np.asarray(np.clip(x, 0, 1) ** np.float32(1 / DISPLAY_GAMMA) * 255 + 0.5, np.uint8)
