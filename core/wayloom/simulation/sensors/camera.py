"""Camera response: vignetting, exposure, sensor noise, tone curve, from radiance to 8 bit grey values."""

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.geometry.camera import PinholeCamera
from wayloom.simulation.vehicle.vehicle_settings import SensorSettings

Radiance = NDArray[np.float32]
SHOT_NOISE, READ_NOISE2 = 1.3e-4, 1.5e-6
"""Variance of the linear signal per unit of it, and of darkness: KITTI's grey pairs show 0.7 grey levels in
the dark, 2.7 in the light."""
SHOULDER_FROM, SHOULDER_WIDTH = 0.85, 0.15
RESPONSE_GAMMA = 1.2
"""Machine vision cameras answer almost linearly: deep shadows, blown out light, noise that grows with brightness."""
TARGET_MEAN = 0.23
GAIN_LIMITS = (0.35, 2.6)
METERED_FROM = 0.35
"""Exposure is metered below this share of the image's height: the sky does not count."""


def metered_gain(radiance: Radiance) -> float:
    """Gain that brings the metered part of an image towards TARGET_MEAN; dark scenes stay darker."""
    metered = radiance[int(METERED_FROM * len(radiance)) :: 4, ::4].mean(axis=-1)
    mean = float(np.exp(np.log(np.maximum(metered, 1e-3)).mean()))
    return float(np.clip((TARGET_MEAN / mean) ** 0.75, *GAIN_LIMITS))


def exposed(
    radiance: Radiance, gain: float, camera: PinholeCamera, sensor: SensorSettings, rng: np.random.Generator
) -> NDArray[np.uint8]:
    """(h, w, 3) linear radiance to (h, w, 3) uint8 RGB of an ideal lens with a still shutter."""
    return developed(blurred(radiance, sensor.blur_px), gain, camera, sensor, rng)


def blurred(radiance: Radiance, blur_px: float) -> Radiance:
    """(h, w, 3) blurred by the filter of `wayloom.simulation.kernels.optics` where it falls on the pixels themselves."""
    side = 0.5 * blur_px**2
    taps = np.array([side, 1.0 - 2.0 * side, side], np.float32)
    return np.asarray(cv2.sepFilter2D(radiance, -1, taps, taps, borderType=cv2.BORDER_REPLICATE), np.float32)


def developed(
    light: Radiance,
    gain: float,
    camera: PinholeCamera,
    sensor: SensorSettings,
    rng: np.random.Generator,
    amplifier: float = 1.0,
) -> NDArray[np.uint8]:
    """(h, w, 3) light on the sensor to (h, w, 3) uint8 RGB. gain: on all light, of shutter and amplifier together; amplifier: the
    part of it that makes noise grow."""
    u, v = np.arange(camera.width, dtype=np.float32), np.arange(camera.height, dtype=np.float32)
    x0, y0 = sensor.vignette_centre
    r2 = ((u[None] - camera.cx) / camera.fx - x0) ** 2 + ((v[:, None] - camera.cy) / camera.fy - y0) ** 2
    x = light * ((1 + r2) ** -sensor.vignette * gain * sensor.gain)[..., None].astype(np.float32)
    shot, read = np.float32(SHOT_NOISE * amplifier), np.float32(READ_NOISE2 * amplifier**2)
    sigma = np.sqrt(np.maximum(x, 0) * shot + read) * np.float32(sensor.noise)
    x += sigma * rng.standard_normal(
        (*x.shape[:2], 1), dtype=np.float32
    )  # one photosite a pixel: its error is in all three colours
    np.maximum(x, 0, out=x)
    bright = x > SHOULDER_FROM
    x[bright] = SHOULDER_FROM + (1 - np.exp(-(x[bright] - SHOULDER_FROM) / SHOULDER_WIDTH)) * SHOULDER_WIDTH
    grey = np.clip(x, 0, 1) ** np.float32(sensor.gamma_ratio / RESPONSE_GAMMA) * 255 + np.float32(sensor.offset)
    return np.asarray(np.clip(grey, 0, 255) + 0.5, np.uint8)
