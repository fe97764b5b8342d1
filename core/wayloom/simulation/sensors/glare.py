"""Lens glare: veiling light, sun haze and ghosts."""

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.simulation.sensors.optics import TrueCamera
from wayloom.simulation.vehicle.vehicle_settings import GlareSettings

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
VEIL_CELL_PX = 8
VEIL_WIDTH = 0.12
"""Standard deviation of the spread light, share of the image's width."""
BRIGHTEST = 6.0
SUN_CORE_RAD = 0.012
SUN_VEIL, SUN_HAZE = 0.004, 0.012
"""Radiance of the sun's veil, which falls with the square of the angle, and of its haze, which falls with the angle, per radiance
of a white wall in the sun, at one radian from it."""
SUN_REACH_RAD = 0.35
"""The sun is shaded from the lens when it stands farther outside of the view."""
GHOSTS = ((-0.35, 0.020, 0.05), (-0.8, 0.035, 0.03), (0.45, 0.014, 0.05), (-1.3, 0.06, 0.02))
"""Place on the line from the image's centre to the sun, radius (normalised), radiance."""


def with_glare(light: F32, camera: TrueCamera, settings: GlareSettings, sun_cam: F64, sun_rgb: F32, open_sky: float) -> F32:
    """(h, w, 3) light on the sensor with veiling light, sun haze and ghosts added.

    sun_cam (3,) unit direction to the sun in the camera's frame; sun_rgb (3,) radiance of a white wall in the sun; open_sky: share
    of the sun that is not hidden.
    """
    out = light
    if settings.veil > 0:
        out = (1 - np.float32(settings.veil)) * light + np.float32(settings.veil) * _spread(light)
    if settings.sun > 0 and open_sky > 0 and sun_cam[2] > 0.05:
        out = out + _sun_veil(camera, sun_cam)[..., None] * (sun_rgb * np.float32(settings.sun * open_sky))
    return np.asarray(out, np.float32)


def open_sky_at_sun(depth: F32, camera: TrueCamera, sun_cam: F64) -> float:
    """Share of the sun that is seen between what stands (depth (h, w), 0 for sky) where it is, or at the nearest border; 0 when it
    stands behind the camera or far outside."""
    if sun_cam[2] <= 0.05:
        return 0.0
    u, v = _pixel(camera, sun_cam)
    x, y = np.clip(u, 0, camera.width - 1), np.clip(v, 0, camera.height - 1)
    outside = float(np.hypot(u - x, v - y)) / camera.rendered.fx
    half = max(2, camera.width // 100)
    seen = depth[max(int(y) - half, 0) : int(y) + half + 1, max(int(x) - half, 0) : int(x) + half + 1]
    return float((seen == 0).mean()) * max(0.0, 1.0 - outside / SUN_REACH_RAD)


def _pixel(camera: TrueCamera, direction: F64) -> tuple[float, float]:
    """Pixel of a direction, without lens distortion, which is negligible for a veil."""
    u, v = camera.rendered.project(direction[None])[0]
    if camera.lens_uv is None:
        return float(u), float(v)
    low, high = camera.lens_uv[0, 0], camera.lens_uv[-1, -1]
    return (
        float((u - low[0]) / (high[0] - low[0]) * (camera.width - 1)),
        float((v - low[1]) / (high[1] - low[1]) * (camera.height - 1)),
    )


def _spread(light: F32) -> F32:
    """Light blurred over a good part of the image."""
    height, width = light.shape[:2]
    small = cv2.resize(
        np.minimum(light, BRIGHTEST), (max(width // VEIL_CELL_PX, 1), max(height // VEIL_CELL_PX, 1)), interpolation=cv2.INTER_AREA
    )
    wide = cv2.GaussianBlur(small, (0, 0), VEIL_WIDTH * small.shape[1], borderType=cv2.BORDER_REPLICATE)
    return np.asarray(cv2.resize(wide, (width, height), interpolation=cv2.INTER_LINEAR))


def _sun_veil(camera: TrueCamera, sun_cam: F64) -> F32:
    """(h, w) veil and haze around the sun, and ghosts across the centre."""
    f, (u, v) = np.float32(camera.rendered.fx), _pixel(camera, sun_cam)
    xs = (np.arange(camera.width, dtype=np.float32) - np.float32(u)) / f
    ys = (np.arange(camera.height, dtype=np.float32) - np.float32(v)) / f
    r2 = xs[None] ** 2 + ys[:, None] ** 2
    r2 += np.float32(SUN_CORE_RAD**2)
    veil = np.float32(SUN_VEIL) / r2 + np.float32(SUN_HAZE) / np.sqrt(r2)
    centre = np.array([camera.width - 1, camera.height - 1]) / 2
    for place, radius, radiance in GHOSTS:
        gu, gv = centre + place * (np.array([u, v]) - centre)
        gx = (np.arange(camera.width, dtype=np.float32) - np.float32(gu)) / f
        gy = (np.arange(camera.height, dtype=np.float32) - np.float32(gv)) / f
        edge = np.float32(radius) - np.sqrt(gx[None] ** 2 + gy[:, None] ** 2)
        veil += np.float32(radiance) * np.clip(edge / np.float32(0.15 * radius), 0, 1)
    return np.asarray(veil, np.float32)
