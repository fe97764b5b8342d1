"""Settings of a recording vehicle: stereo rig with its calibration errors, cameras, GNSS, IMU and LiDAR.

Lengths in pixels are those of full-size images; smaller sizes scale them.
"""

from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from wayloom.config.settings import Settings
from wayloom.geometry.lens import RightLens
from wayloom.logs.types import FixType

F64 = NDArray[np.float64]
Triple = tuple[float, float, float]
AXES_CAM_BODY: Final = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
"""x forward, y left, z up into x right, y down, z forward."""


class RightLensSettings(Settings):
    """Deviation of the true right camera from the calibration in the log; see `wayloom.geometry.lens.RightLens`."""

    pitch_rad: float = Field(default=0.0, ge=-0.1, le=0.1)
    yaw_rad: float = Field(default=0.0, ge=-0.1, le=0.1)
    roll_rad: float = Field(default=0.0, ge=-0.1, le=0.1)
    ty: float = Field(default=0.0, ge=-0.1, le=0.1, description="share of the baseline")
    tz: float = Field(default=0.0, ge=-0.1, le=0.1, description="share of the baseline")
    focal_ratio: float = Field(default=1.0, ge=0.9, le=1.1)
    cx_shift_px: float = Field(default=0.0, ge=-50, le=50, description="px of full-size images")
    k1: float = Field(default=0.0, ge=-0.1, le=0.1)
    p1: float = Field(default=0.0, ge=-0.1, le=0.1)
    p2: float = Field(default=0.0, ge=-0.1, le=0.1)

    def lens(self, scale: float = 1.0) -> RightLens:
        """The lens of images that are `scale` times full size."""
        values = self.model_dump()
        return RightLens(**{**values, "cx_shift_px": self.cx_shift_px * scale})


class SensorSettings(Settings):
    """One camera of the pair; the defaults are a good camera."""

    gain: float = Field(default=1.0, gt=0.3, lt=3, description="sensitivity")
    offset: float = Field(default=0.0, ge=-40, le=40, description="added to the image, grey values")
    gamma_ratio: float = Field(default=1.0, gt=0.4, lt=2.5, description="exponent on the response curve")
    vignette: float = Field(default=0.35, ge=0, le=4, description="brightness falls as (1 + r^2)^-vignette; 2 is cos^4")
    vignette_centre: tuple[float, float] = Field(default=(0.0, 0.0), description="where it is brightest, x/z and y/z")
    blur_px: float = Field(default=0.525, ge=0, le=0.577, description="standard deviation of the lens's blur")
    noise: float = Field(default=1.0, ge=0, le=20, description="factor on the standard deviation of all noise")


class LightChange(Settings):
    """Light that falls or rises over everything for a while, as under a bridge or in a tunnel."""

    from_s: float = Field(ge=0, description="s after the drive's start")
    to_s: float = Field(gt=0)
    factor: float = Field(gt=0, le=20, description="on all radiance")
    ramp_s: float = Field(default=0.3, ge=0, description="over how long it begins, and ends")


class ExposureSettings(Settings):
    """Exposure control: first the time within its limits, then the gain."""

    target: float = Field(default=0.23, gt=0, lt=1, description="linear value to which the metered part is brought")
    compensation: float = Field(default=0.75, ge=0, le=1, description="1 all scenes equally bright, 0 no control")
    time_constant_s: float = Field(default=0.78, ge=0, le=60, description="0: at once")
    metering: Literal["road", "mean", "centre"] = "road"
    unit_s: float = Field(default=0.004, gt=0, le=0.1, description="time that exposes radiance 1 to full scale at gain 1")
    shortest_s: float = Field(default=0.0005, gt=0, le=0.1)
    longest_s: float = Field(default=0.008, gt=0, le=0.2)
    largest_gain: float = Field(default=4.0, ge=1, le=64)
    each_for_itself: bool = Field(default=False, description="left and right are metered and exposed apart")
    logged: bool = Field(default=False, description="exposure times are written to the log")
    light_changes: tuple[LightChange, ...] = ()


class GlareSettings(Settings):
    """Stray light in the lens."""

    veil: float = Field(default=0.0, ge=0, le=0.5, description="share of all light that is spread over the image")
    sun: float = Field(default=0.0, ge=0, le=5, description="brightness of the sun's own veil and ghosts, 0 none, 1 strong")


class ClockSettings(Settings):
    """The GNSS and IMU clock against the cameras': stamp = t + offset_s + drift (t - start)."""

    offset_s: float = Field(default=0.0, ge=-10, le=10)
    drift: float = Field(default=0.0, ge=-1e-3, le=1e-3, description="s/s")
    stated_offset_s: float | None = Field(default=None, ge=-10, le=10, description="what the log says of the offset; none: nothing")
    stated_sigma_s: float = Field(default=1e-3, ge=1e-6, le=10, description="the sigma that it states with it")


ON_ONE_PULSE: Final = ClockSettings(stated_offset_s=0.0)
"""Receiver and cameras triggered by one pulse, and a log that says so."""


class GnssStep(Settings):
    """One kind of fix from a share of the drive on."""

    share: float = Field(ge=0, le=1)
    fix: FixType
    stated_ratio: float = Field(default=1.0, gt=0, le=100, description="stated over true standard deviation; under 1 boasts")


class GnssBurst(Settings):
    """Multipath: positions jump together for a while, and the receiver does not notice."""

    share: float = Field(ge=0, le=1, description="when it begins, share of the drive")
    duration_s: float = Field(gt=0, le=600)
    size_m: float = Field(gt=0, le=200, description="horizontal jump; the direction is random, up half of it")
    wander_share: float = Field(
        default=0.2,
        ge=0,
        le=1,
        description="standard deviation of each axis while it lasts, share of the size; 0 stays where it jumped",
    )
    ramp_s: float = Field(default=0.0, ge=0, le=300, description="it comes and goes over so long; 0 jumps")


class GnssSettings(Settings):
    """The receiver."""

    rate_hz: float = Field(default=10.0, gt=0, le=50)
    steps: tuple[GnssStep, ...] = (GnssStep(share=0.0, fix=FixType.FIXED),)
    bursts: tuple[GnssBurst, ...] = ()


class ImuSettings(Settings):
    """The inertial unit; the defaults are those of a good MEMS unit."""

    rate_hz: float = Field(default=100.0, ge=50, le=1000)
    accelerometer_noise: float = Field(default=2e-3, ge=0, description="m/s^2 per root hertz")
    gyroscope_noise: float = Field(default=1.5e-4, ge=0, description="rad/s per root hertz")
    accelerometer_bias: float = Field(default=0.05, ge=0, description="standard deviation at the start, m/s^2")
    gyroscope_bias: float = Field(default=2e-3, ge=0, description="standard deviation at the start, rad/s")
    accelerometer_walk: float = Field(default=5e-4, ge=0, description="m/s^3 per root hertz")
    gyroscope_walk: float = Field(default=2e-5, ge=0, description="rad/s^2 per root hertz")


class LidarSettings(Settings):
    """A spinning scanner. A scan is drawn at one moment: motion during the turn is taken as undone."""

    rings: int = Field(default=64, ge=1, le=256)
    columns: int = Field(default=2048, ge=64, le=8192, description="shots a turn")
    lowest_deg: float = Field(default=-24.8, ge=-60, le=0)
    highest_deg: float = Field(default=2.0, ge=0, le=45)
    nearest_m: float = Field(default=1.5, ge=0.1)
    farthest_m: float = Field(default=120.0, gt=1, le=300)
    range_noise_m: float = Field(default=0.02, ge=0, description="standard deviation along the ray")
    dropout: float = Field(
        default=0.03, ge=0, lt=1, description="share of shots that give nothing, anywhere; more on glancing hits"
    )
    every: int = Field(default=1, ge=1, description="a scan for each so many frames")
    p_cam_lidar_m: Triple = (0.0, -0.40, -0.60)


class VehicleSettings(Settings):
    """Settings of a recording vehicle."""

    rig: Literal["kitti-360", "kitti"] = "kitti-360"
    rig_name: str | None = Field(default=None, description="drives with the same name are of the same rig; none: each has its own")
    camera_height_m: float = Field(default=1.65, gt=0.3, le=4)
    camera_forward_m: float = Field(default=0.0, ge=-5, le=5, description="left camera before the body's origin")
    camera_left_m: float = Field(default=0.0, ge=-2, le=2)
    camera_roll_pitch_yaw_rad: Triple = Field(default=(0.0, 0.0, 0.0), description="camera in the body: pitch down, yaw left")
    right_lens: RightLensSettings = Field(default=RightLensSettings(), description="the true right camera against the given one")
    distortion: tuple[float, float, float, float, float] | None = Field(
        default=None, description="k1 k2 p1 p2 k3 of both raw images; only formats that hold raw images can have it"
    )
    left: SensorSettings = SensorSettings()
    right: SensorSettings = SensorSettings()
    exposure: ExposureSettings = ExposureSettings()
    motion_blur: bool = Field(default=False, description="the shutter is open for the exposure time")
    glare: GlareSettings = GlareSettings()
    jpeg_quality: int | None = Field(default=None, ge=30, le=100, description="image files are JPEG of this quality; none: PNG")
    p_cam_gnss_m: Triple = Field(default=(0.05, -0.55, -0.90), description="antenna in the left camera's frame")
    p_cam_imu_m: Triple = Field(default=(0.3, 0.6, -0.8), description="IMU in the left camera's frame")
    imu_roll_pitch_yaw_rad: Triple = Field(default=(0.0, 0.0, 0.0), description="the IMU's axes against forward, left, up")
    clock: ClockSettings = ON_ONE_PULSE
    gnss: GnssSettings | None = GnssSettings()
    imu: ImuSettings | None = None
    lidar: LidarSettings | None = None

    @property
    def T_body_cam(self) -> F64:
        """(4, 4) left camera in the body: x forward, y left, z up, origin on the ground."""
        out = np.eye(4)
        out[:3, :3] = rotation(*self.camera_roll_pitch_yaw_rad) @ AXES_CAM_BODY.T
        out[:3, 3] = self.camera_forward_m, self.camera_left_m, self.camera_height_m
        return out

    @property
    def T_cam_imu(self) -> F64:
        """(4, 4) the IMU's frame (x forward, y left, z up, but for its mounting) into the left camera's."""
        out = np.eye(4)
        out[:3, :3], out[:3, 3] = AXES_CAM_BODY @ rotation(*self.imu_roll_pitch_yaw_rad), self.p_cam_imu_m
        return out

    @property
    def T_cam_lidar(self) -> F64:
        """(4, 4) the LiDAR's frame (x forward, y left, z up) into the left camera's; forward is the camera's."""
        out = np.eye(4)
        out[:3, :3] = AXES_CAM_BODY
        if self.lidar is not None:
            out[:3, 3] = self.lidar.p_cam_lidar_m
        return out


def rotation(roll: float, pitch: float, yaw: float) -> F64:
    """(3, 3): Rz(yaw) Ry(pitch) Rx(roll), rad."""
    (sr, sp, sy), (cr, cp, cy) = (f(np.array([roll, pitch, yaw])) for f in (np.sin, np.cos))
    Rx = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    Ry = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    Rz = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return np.asarray(Rz @ Ry @ Rx)


def gnss_steps(*steps: tuple[float, FixType]) -> tuple[GnssStep, ...]:
    """Shorthand for `GnssStep`s: pairs of share of the drive and fix type."""
    return tuple(GnssStep(share=share, fix=fix) for share, fix in steps)
