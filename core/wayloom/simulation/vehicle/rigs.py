"""Stereo rigs of the simulated vehicles, and their mounting."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import ConfigError
from wayloom.geometry.camera import PinholeCamera, StereoRig
from wayloom.simulation.city import terrain
from wayloom.simulation.vehicle.vehicle_settings import VehicleSettings

F64 = NDArray[np.float64]
KITTI_360: Final = StereoRig(PinholeCamera(552.55, 552.55, 682.05, 238.77, 1408, 376), (-0.594, 0.0, 0.0))
"""Geometry of KITTI-360's rectified perspective pair."""
KITTI: Final = StereoRig(PinholeCamera(718.856, 718.856, 607.1928, 185.2157, 1241, 376), (-0.537, 0.0, 0.0))
"""Geometry of KITTI's odometry sequences 00 to 02."""
RIGS: Final = {"kitti-360": KITTI_360, "kitti": KITTI}
SIZES: Final = {"full": 0, "half": 1, "quarter": 2}
"""Name to pyramid level."""
CAMERA_HEIGHT_M = 1.65
T_BODY_CAM: Final = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, CAMERA_HEIGHT_M], [0, 0, 0, 1]])
"""Left camera in the body: x forward, y left, z up, origin on the ground under the camera."""
SWAY_RAD, SWAY_M = (0.005, 0.006), 0.010


def sized_rig(size: str, rig: StereoRig = KITTI_360) -> StereoRig:
    """The rig at "full", "half" or "quarter" size. Raises ConfigError for another word."""
    if size not in SIZES:
        raise ConfigError(f"unknown size {size!r}", remedy=f"use one of {', '.join(SIZES)}")
    return StereoRig(rig.camera.at_level(SIZES[size]), rig.t_right_left)


def scale_of(size: str) -> float:
    """Scale of images of that size against full size. Raises ConfigError for another word."""
    sized_rig(size)
    return 0.5 ** int(SIZES[size])


def given_rig(vehicle: VehicleSettings, size: str) -> StereoRig:
    """The rig as the log's calibration states it. Raises ConfigError for an unknown size."""
    return sized_rig(size, RIGS[vehicle.rig])


def camera_on_ground(x: float, y: float, yaw: float, travelled_m: float = 0.0) -> F64:
    """T_world_cam (4, 4) of a vehicle at x, y (m), yaw (rad), with small roll, pitch and heave along the way."""
    roll, pitch = (
        SWAY_RAD[0] * np.sin(0.55 * travelled_m + 0.4),
        SWAY_RAD[1] * np.sin(0.9 * travelled_m) + 0.5 * SWAY_RAD[1] * np.sin(2.3 * travelled_m + 1),
    )
    cr, sr, cp, sp = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
    sway = np.eye(4)
    sway[:3, :3] = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]]) @ np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    sway[2, 3] = SWAY_M * np.sin(1.1 * travelled_m)
    return np.asarray(terrain.pose_on_ground(x, y, yaw) @ sway @ T_BODY_CAM)
