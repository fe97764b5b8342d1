"""Exposure of a drive's orthophoto: keyframes balanced by the odometry's affine brightness, vignetting undone, one tone curve."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry.camera import PinholeCamera
from wayloom.ground.view import may_be_shown
from wayloom.ground.vignetting import drive_fall_off
from wayloom.logs.types import DriveLog
from wayloom.odometry.frame_source import grey_pair
from wayloom.odometry.types import OdometryResult
from wayloom.places.stereo_pair import LeftLabels

FloatArray = NDArray[np.float64]
SAMPLED: Final = 16
"""Keyframes whose ground tells how bright the drive's ground is."""
WHITE_PERCENTILE, WHITE_TONE = 98.0, 215.0
PIXEL_STEP: Final = 3


@dataclass(frozen=True, slots=True)
class DriveExposure:
    """gain, offset (K,) take the left image of each keyframe to the exposure of the median one, and its vignetting is undone:
    I_drive = (gain I + offset) (1 + r^2)^fall_off, r the tangent of the angle from the axis.

    white : value in that exposure that the tone curve takes to WHITE_TONE
    """

    gain: FloatArray
    offset: FloatArray
    white: float
    fall_off: float

    def tone(self, values: NDArray[Any]) -> NDArray[Any]:
        """0 to 255 of values in the drive's exposure: their root, so that shade shows beside sun."""
        return np.asarray(WHITE_TONE * np.sqrt(np.maximum(values, 0.0) / self.white))


def drive_exposure(log: DriveLog, odometry: OdometryResult, labels: LeftLabels, threads: int = 1) -> DriveExposure:
    """Of a drive whose brightness the odometry followed: I = exp(a) I_scene + b, so I_drive = exp(a_m - a) (I - b) + b_m.

    Raises StageError where an image's labels are missing, LogError where an image cannot be read.
    """
    a, b = odometry.keyframes.affine[:, 0], odometry.keyframes.affine[:, 1]
    gain = np.exp(np.median(a) - a)
    offset = np.median(b) - gain * b
    fall_off, tones = drive_fall_off(log, odometry, labels, (gain, offset), threads), []
    lift = unfallen(log.rig.camera, fall_off)[::PIXEL_STEP, ::PIXEL_STEP]
    for row in np.unique(np.linspace(0, len(a) - 1, SAMPLED).round().astype(np.int64)).tolist():
        left = grey_pair(log, int(odometry.keyframes.frame[row])).left
        ground = may_be_shown(labels.left(row), 0.0)[::PIXEL_STEP, ::PIXEL_STEP] > 0.0
        tones.append((gain[row] * left[::PIXEL_STEP, ::PIXEL_STEP][ground] + offset[row]) * lift[ground])
    pooled = np.concatenate(tones)
    white = float(np.percentile(pooled, WHITE_PERCENTILE)) if len(pooled) else 255.0
    return DriveExposure(gain, offset, max(white, 1.0), fall_off)


def unfallen(camera: PinholeCamera, fall_off: float) -> FloatArray:
    """(h, w) factors that undo a fall of brightness by (1 + r^2)^-fall_off."""
    x = (np.arange(camera.width) - camera.cx) / camera.fx
    y = (np.arange(camera.height) - camera.cy) / camera.fy
    return np.asarray((1.0 + x[None] ** 2 + y[:, None] ** 2) ** fall_off)
