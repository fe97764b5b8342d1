"""Settings of the odometry. docs/odometry.md says which matter, docs/results.md on what the defaults were chosen."""

from typing import Self

from pydantic import Field, model_validator

from wayloom.config.settings import Settings


class Ablation(Settings):
    """What can be taken away from the prior to see what it is worth; all True by default."""

    marginalisation_prior: bool = Field(True, description="what leaves the window stays as a prior")
    bias_in_prior: bool = Field(True, description="the disparity bias is an unknown of that prior, no random walk beside it")
    first_estimates: bool = Field(True, description="Jacobians of keyframes that the prior knows are those of their first estimate")


class ImuSettings(Settings):
    """How a log's IMU is used. Noises are those of a car's MEMS unit; a better unit loses little by them."""

    use: bool = Field(True, description="use the IMU of logs that have one")
    time_offset_s: float = Field(0.0, ge=-1, le=1, description="the IMU's clock minus the camera's")
    gyroscope_noise: float = Field(2e-3, gt=0, description="rad/s/sqrt(Hz)")
    accelerometer_noise: float = Field(2e-2, gt=0, description="m/s^2/sqrt(Hz)")
    gyroscope_walk: float = Field(1e-4, gt=0, description="rad/s^2/sqrt(Hz), of the bias")
    accelerometer_walk: float = Field(1e-3, gt=0, description="m/s^3/sqrt(Hz), of the bias")
    gyroscope_bias: float = Field(0.02, gt=0, description="rad/s, sigma of the bias found at the start")
    accelerometer_bias: float = Field(0.3, gt=0, description="m/s^2, sigma of the bias about zero")
    max_gap_s: float = Field(0.05, gt=0, description="seconds without a sample that are bridged")
    start_span_s: float = Field(1.0, gt=0, description="seconds of the window's poses from which gravity may be found")
    start_gravity_m_s2: float = Field(0.7, gt=0, description="m/s^2 by which the found gravity may be off in length")


class OdometrySettings(Settings):
    """Everything that can be chosen. Grey levels are 0 to 255; shares of the image refer to width + height."""

    window: int = Field(6, ge=3, le=12, description="keyframes in the window")
    points: int = Field(400, ge=50, le=5000, description="points wanted in view of a keyframe")
    min_new_points: int = Field(150, ge=10, le=5000, description="activated even where enough are in view")
    traced_share: float = Field(0.3, ge=0, le=1, description="of the new live points, those that were traced in several keyframes")
    matched_points: int = Field(
        450, ge=0, le=20000, description="wanted from static stereo at a keyframe; those beside the live ones wait"
    )
    sought_points: int = Field(100, ge=0, le=20000, description="candidates of a keyframe without a static match that are traced")
    candidates: int = Field(1600, ge=50, le=20000, description="pixels tried by stereo at the first keyframe; sets the cell size")
    levels: int = Field(5, ge=1, le=8, description="pyramid levels; fewer in small images")
    track_iterations: tuple[int, ...] = Field((50, 50, 50, 20, 10, 10, 10, 10), description="at most, finest level first")
    adjust_iterations: int = Field(2, ge=1, le=50, description="steps of Levenberg-Marquardt at a keyframe, at most")
    huber: float = Field(9.0, gt=0, description="grey levels")
    cutoff: float = Field(20.0, gt=0, description="grey levels, in tracking")
    gradient_scale: float = Field(50.0, gt=0, description="c, grey levels: a pixel weighs c^2 / (c^2 + |gradient|^2)")
    max_energy: float = Field(70.0, gt=0, description="grey^2 a pixel of a patch; above it is an outlier")
    static_weight: float = Field(1.0, ge=0, description="lambda, the weight of a host's own right image")
    observer_right_weight: float = Field(0.5, ge=0, description="the same for the right images of the other keyframes")
    bias_prior: float = Field(300.0, ge=0, description="information of the disparity bias about zero, grey^2/px^2")
    bias_gate: float = Field(4.0, ge=0, description="sigmas from zero at which the disparity bias is set free; 0: free at once")
    affine_prior: tuple[float, float] = Field((1e3, 1.0), description="information of a and b about zero")
    keyframe_flow: float = Field(0.0594, gt=0, description="rms flow that alone makes a keyframe, share of the image")
    keyframe_shift: float = Field(
        0.0445, gt=0, description="rms flow without rotation that alone makes a keyframe, share of the image"
    )
    keyframe_brightness: float = Field(0.35, gt=0, description="|log gain| that alone makes a keyframe")
    block: int = Field(32, ge=8, description="px, of the gradient thresholds")
    gradient_margin: float = Field(7.0, ge=0, description="grey levels above the block's median")
    border: int = Field(6, ge=6, description="px without points at the image's edge")
    max_disparity: int = Field(180, ge=8, description="px")
    min_disparity: float = Field(0.5, gt=0, description="px")
    max_sigma: float = Field(0.5, gt=0, description="px, of a disparity")
    uniqueness: float = Field(0.7, gt=0, le=1, description="best cost over second best")
    max_cost: float = Field(12.0, gt=0, description="of the capped slope, a pixel")
    slope_cap: int = Field(60, ge=10, le=255)
    self_calibration: bool = Field(
        True, description="learn the right camera's lens from pieces of the drive where no rig's file gives it"
    )
    row_frames: tuple[int, ...] = Field((0, 3, 6, 9), description="frames whose stereo matches fit the rows' misalignment")
    min_visible: float = Field(0.25, ge=0, le=1, description="share of the reference in view, below which a frame is lost")
    max_saturated: float = Field(
        0.5, ge=0, le=1, description="share of the reference beyond the cut-off, above which a frame is lost"
    )
    max_gain: float = Field(10.0, gt=1, description="between a frame and its keyframe, up or down")
    max_acceleration: float = Field(25.0, gt=0, description="m/s^2, of a believable motion")
    max_turn_rate: float = Field(3.0, gt=0, description="rad/s, of a believable motion")
    min_contrast: float = Field(2.0, ge=0, description="grey levels, standard deviation of an image that is not blank")
    min_points: int = Field(30, ge=8, description="candidates with a static stereo match without which no segment starts")
    patience: int = Field(3, ge=1, description="frames that may fail in a row before a new segment starts")
    max_gap_s: float = Field(2.0, gt=0, description="seconds without a tracked frame before a new segment starts")
    min_observations: int = Field(2, ge=1, description="keyframes beside the host that must have seen a point for it to be kept")
    min_confirmations: int = Field(
        7, ge=1, description="images that must agree on a kept point: left and right ones of observers, and the host's right one"
    )
    grey_sigma: float = Field(8.0, gt=0, description="grey levels, for a point's variance")
    disparity_sigma: float = Field(0.15, ge=0, description="px, the part of a point's sigma that more views do not lower")
    max_relative_sigma: float = Field(0.2, gt=0, description="sigma of a kept point's inverse depth over the inverse depth")
    seed: int = Field(0, ge=0, lt=2**31, description="of the choice among equal points; results of other seeds show the noise")
    part_frames: int = Field(3000, ge=40, description="frames of a part: longer drives are tracked in parts that overlap")
    part_overlap: int = Field(80, ge=10, description="frames that a part and the next share")
    imu: ImuSettings = ImuSettings()
    ablation: Ablation = Ablation()

    @model_validator(mode="after")
    def _check_parts(self) -> Self:
        if 2 * self.part_overlap > self.part_frames:
            raise ValueError(f"part_overlap {self.part_overlap} is more than half of part_frames {self.part_frames}")
        return self
