"""Stereo calibration faults: presets of single error kinds, in the sizes found on KITTI's own rigs.

Sizes hold for full-size images of KITTI-360's geometry (f = 552.55 px), for what is infinitely far; half-size images have half.
KITTI's rows differ by dv = pitch (1 + y^2) + roll x + k x y, and the horizontal partner of k x y is k y^2: the field of a decentred
lens (p2 = -k), turned by yaw = 3 k so that what remains of x^2 goes, and shifted back.
"""

from typing import Final

from wayloom.simulation.vehicle.rigs import KITTI_360
from wayloom.simulation.vehicle.vehicle_settings import RightLensSettings

_KEYSTONE: Final = 0.0024

PERFECT: Final = RightLensSettings()
ROWS: Final = RightLensSettings(
    pitch_rad=0.0005, roll_rad=0.0005, yaw_rad=3 * _KEYSTONE, p2=-_KEYSTONE, cx_shift_px=-3 * _KEYSTONE * KITTI_360.camera.fx
)
"""Rows off by up to 1 px in the corners; 0.3 px along the rows at most."""
OFFSET: Final = RightLensSettings(cx_shift_px=-1.0)
"""All disparities 1 px too large, as after a knock."""
LENS: Final = RightLensSettings(
    pitch_rad=0.0004, yaw_rad=0.0012, ty=0.002, tz=-0.004, focal_ratio=0.9985, cx_shift_px=-0.6, k1=0.0022, p1=0.0006, p2=-0.0006
)
"""A lens field of up to 2 px: -1.9 to 1.4 px along the rows, -0.4 to 0.7 px across."""
WORN: Final = RightLensSettings(
    pitch_rad=-0.0006, yaw_rad=0.0045, roll_rad=0.0006, ty=0.002, tz=-0.005, focal_ratio=0.9985, cx_shift_px=-3.2, k1=0.0018,
    p1=0.0006, p2=-0.0015,
)  # fmt: skip
"""All of it together: -2.0 to 0.7 px along the rows, 0.1 to 1.9 px across."""
FAULTS: Final = {"perfect": PERFECT, "rows": ROWS, "offset": OFFSET, "lens": LENS, "worn": WORN}
