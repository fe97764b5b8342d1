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
CLOSING, CLOSING_FROM = 7.0, 0.75
"""Over this cover the gaps between the clouds close."""
UNDERSIDE = 0.06
"""Spread of the brightness of a closed cover's underside."""
FOG_FROM_PER_M, FOG_LAYER_M = 0.004, 60.0
"""Denser haze is fog that lies this deep over the ground and hides the sky."""
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
        shape = noise(light.clouds, dx * scale, dy * scale)
        white = 0.9 * shape + 2.4 * (light.cloud_cover - 0.5) + CLOSING * max(light.cloud_cover - CLOSING_FROM, 0.0)
        white = min(max(white, 0.0), 1.0) * min(1.0, dz * CLOUD_FADE)
        bright = light.horizon_rgb[2] * (1.25 - 0.25 * white + UNDERSIDE * light.cloud_cover * shape)
        r, g, b = r + (bright - r) * white, g + (bright - g) * white, b + (bright * 1.01 - b) * white
    toward_sun = dx * light.axes[2, 0] + dy * light.axes[2, 1] + dz * light.axes[2, 2]
    if toward_sun > 0.0:
        glow = GLOW * toward_sun**GLOW_POWER * (1.0 - 0.8 * light.cloud_cover)
        r, g, b = r + glow, g + glow * 0.95, b + glow * 0.8
    if light.haze_per_m > FOG_FROM_PER_M:
        veil = 1.0 - math.exp((FOG_FROM_PER_M - light.haze_per_m) * FOG_LAYER_M / max(dz, 0.01))
        r, g = r + (light.horizon_rgb[0] - r) * veil, g + (light.horizon_rgb[1] - g) * veil
        b += (light.horizon_rgb[2] - b) * veil
    return np.float32(r), np.float32(g), np.float32(b)
