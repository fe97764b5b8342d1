"""Settings of the calibration: priors, robust weights, thresholds. docs/calibration.md gives the reasons."""

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from wayloom.config.settings import Settings
from wayloom.geometry.lens import PARAMETERS


class LensPrior(Settings):
    """Standard deviations about the ideal camera, one for each parameter of `RightLens`."""

    pitch_rad: float = Field(0.005, gt=0)
    yaw_rad: float = Field(0.01, gt=0)
    roll_rad: float = Field(0.005, gt=0)
    ty: float = Field(0.01, gt=0, description="share of the baseline")
    tz: float = Field(0.01, gt=0, description="share of the baseline")
    focal_ratio: float = Field(0.004, gt=0)
    cx_shift_px: float = Field(8.0, gt=0, description="px")
    k1: float = Field(0.01, gt=0)
    p1: float = Field(0.004, gt=0)
    p2: float = Field(0.004, gt=0)

    @property
    def sigmas(self) -> NDArray[np.float64]:
        """(10,) in the order of PARAMETERS."""
        return np.array([getattr(self, name) for name in PARAMETERS])


class DrivePrior(Settings):
    """Standard deviations of how one drive differs from its rig."""

    disparity_bias_px: float = Field(0.5, gt=0, description="px")
    pitch_rad: float = Field(3e-4, gt=0)
    roll_rad: float = Field(3e-4, gt=0)

    @property
    def sigmas(self) -> NDArray[np.float64]:
        """(3,) disparity bias, pitch, roll."""
        return np.array([self.disparity_bias_px, self.pitch_rad, self.roll_rad])


class CalibrationSettings(Settings):
    """Everything that can be chosen."""

    lens: LensPrior = LensPrior()
    drive: DrivePrior = DrivePrior()
    baseline_sigma: float = Field(
        0.003, gt=0, description="share of the given baseline (and focal length) by which rigs are off; only GNSS can tell"
    )
    common_radial: float = Field(0.02, gt=0, description="sigma of a k1 that both lenses share, which rectification left")
    iterations: int = Field(30, ge=1, le=200)
    smallest_step: float = Field(0.01, gt=0, description="sigmas: a smaller step of every lens parameter ends the iteration")
    robust_scale: float = Field(2.0, gt=0, description="of a match's Cauchy weight, in units of the matches' own noise")
    least_noise_px: float = Field(0.03, gt=0, description="px, below which no match is believed")
    least_information: float = Field(
        0.5, gt=0, lt=1, description="posterior over prior sigma from which on a parameter is undetermined"
    )
    least_groups: int = Field(3, ge=1, description="match groups of all drives together, without which nothing is learnt")


def with_bias_sigma(settings: CalibrationSettings, bias_sigma: float) -> CalibrationSettings:
    """The settings for drives of a rig whose disparity biases differ by bias_sigma px."""
    return settings.model_copy(update={"drive": settings.drive.model_copy(update={"disparity_bias_px": bias_sigma})})
