"""Radiance of the sky in a direction."""

import math

import numpy as np
from numba import njit

from wayloom.simulation.kernels.arrays import Light, Rgb
from wayloom.simulation.kernels.options import KERNEL
from wayloom.simulation.kernels.sampling import noise

HORIZON_FALL = 4.0
CLOUD_HEIGHT = 0.12
CLOUD_SCALE = 0.35
CLOUD_FADE = 8.0
GLOW_POWER = 64
GLOW = 0.5


@njit(**KERNEL)
def sky_radiance(light: Light, dx: float, dy: float, dz: float) -> Rgb:
    """Linear RGB seen along the unit direction (dx, dy, dz)."""
    near_horizon = math.exp(-HORIZON_FALL * max(dz, 0.0))
    r = light.sky_rgb[0] + (light.horizon_rgb[0] - light.sky_rgb[0]) * near_horizon
    g = light.sky_rgb[1] + (light.horizon_rgb[1] - light.sky_rgb[1]) * near_horizon
    b = light.sky_rgb[2] + (light.horizon_rgb[2] - light.sky_rgb[2]) * near_horizon
    if dz > 0.01:
        scale = CLOUD_SCALE / (dz + CLOUD_HEIGHT)
        white = 0.9 * noise(light.clouds, dx * scale, dy * scale) + 2.4 * (light.cloud_cover - 0.5)
        white = min(max(white, 0.0), 1.0) * min(1.0, dz * CLOUD_FADE)
        bright = light.horizon_rgb[2] * (1.25 - 0.25 * white)
        r, g, b = r + (bright - r) * white, g + (bright - g) * white, b + (bright * 1.01 - b) * white
    toward_sun = dx * light.axes[2, 0] + dy * light.axes[2, 1] + dz * light.axes[2, 2]
    if toward_sun > 0.0:
        glow = GLOW * toward_sun**GLOW_POWER * (1.0 - 0.8 * light.cloud_cover)
        r, g, b = r + glow, g + glow * 0.95, b + glow * 0.8
    return np.float32(r), np.float32(g), np.float32(b)
