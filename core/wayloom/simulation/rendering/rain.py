"""Rain streaks: falling drops imaged as short bright lines while the shutter is open."""

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.geometry.camera import PinholeCamera

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
DROPS_PER_M3 = 50.0
"""Of those large enough to be seen, in rain of 1 mm/h; their number grows as the rate to the power 0.6 (Marshall & Palmer 1948)."""
NEAREST_M, FARTHEST_M = 0.8, 7.0
FALL_M = 0.055
"""Length of a streak: 7 m/s for 8 ms."""
SLANT = 0.12
DROP_M, LENS_BLUR_M = 0.0022, 0.0035
"""Width of a drop, and of what lies out of focus at 1 m."""
OPACITY = 0.3
SUBPIXEL_BITS = 4


def with_rain(radiance: F32, camera: PinholeCamera, T_world_cam: F64, rain_mm_h: float, t_s: float, sky_rgb: F32) -> F32:
    """(h, w, 3) radiance behind the drops between a camera and what it sees, which throw sky_rgb (3,) towards it.

    Left and right see other drops: those near enough to be seen as streaks are far too near to be matched. The same place and
    time give the same drops.
    """
    seed = np.frombuffer(np.append(T_world_cam[:3, 3], t_s).tobytes(), np.uint32)
    rng = np.random.default_rng(seed)
    half = np.array([camera.width / camera.fx, camera.height / camera.fy]) / 2
    volume = 4 * half.prod() * (FARTHEST_M**3 - NEAREST_M**3) / 3
    count = rng.poisson(DROPS_PER_M3 * rain_mm_h**0.6 * volume)
    z = rng.uniform(NEAREST_M**3, FARTHEST_M**3, count) ** (1 / 3)
    down = se3.inverse(T_world_cam)[:3, :3] @ np.array([SLANT, 0.0, -1.0])
    uv = rng.uniform((-20, -20), (camera.width + 20, camera.height + 20), (count, 2))
    tail = uv + (down[:2] / np.hypot(*down[:2])) * (camera.fy * FALL_M / z)[:, None]
    cover = _cover((camera.height, camera.width), uv, tail, z, camera.fx)[..., None]
    return np.asarray(radiance + (sky_rgb - radiance) * cover, np.float32)


def _cover(shape: tuple[int, int], uv: F64, tail: F64, z: F64, fx: float) -> F32:
    """(h, w) share of each pixel's light that drops replace; far drops are finer than a pixel and cover less of it."""
    layer = np.zeros(shape, np.uint8)
    width = fx * (DROP_M + LENS_BLUR_M / z) / z
    unit = 1 << SUBPIXEL_BITS
    for a, b, w in zip(np.rint(uv * unit).astype(int), np.rint(tail * unit).astype(int), width, strict=True):
        strength = int(255 * OPACITY * min(1.0, w) / max(1.0, w) ** 0.5)
        cv2.line(layer, a.tolist(), b.tolist(), strength, max(1, round(w)), cv2.LINE_AA, SUBPIXEL_BITS)
    return np.asarray(cv2.GaussianBlur(layer.astype(np.float32) / 255, (0, 0), 0.6), np.float32)
