"""Settings of the registration between drives."""

from pydantic import Field

from wayloom.config.settings import Settings
from wayloom.loops.settings import LoopSettings
from wayloom.registration.settings import RegistrationSettings


class MeetingSettings(Settings):
    """Where two drives are compared, how far each is believed, and how many pairs of views must agree."""

    spacing_m: float = Field(4.0, gt=0, le=50, description="road between keyframes whose views may be compared, m")
    stride: int = Field(2, ge=1, le=20, description="of these, one in so many is tried along a road that both drives share")
    scout_m: float = Field(12.0, gt=0, le=200, description="road between keyframes from which a shared road is looked for, m")
    scout_alone_m: float = Field(24.0, gt=0, le=200, description="the same where a drive does not know its place, m")
    near_m: float = Field(25.0, ge=1, le=60, description="views meet where their middles are nearer than this, m")
    sigmas: float = Field(3.0, gt=0, le=10, description="widens what is near by so many standard deviations of both drives' places")
    candidates: int = Field(4, ge=1, le=100, description="places of the other drive that a scout compares with, at most")
    compared_drives: int = Field(
        8,
        ge=1,
        le=1000,
        description="drives that one without GNSS is compared with, at most: those that it looks most like",
    )
    max_prior_sigma_m: float = Field(
        20.0, gt=0, description="places less certain than this against each other are looked for by appearance, m"
    )
    drift_share: float = Field(
        0.003, gt=0, le=0.1, description="standard deviation of an odometry's place within a submap, share of the road"
    )
    drift_deg_per_sqrt_m: float = Field(
        0.02, gt=0, le=1, description="standard deviation of its attitude within a submap, degrees a root metre"
    )
    independent_m: float = Field(40.0, gt=0, description="pairs of views nearer to each other than this share their errors, m")
    least_agreeing: int = Field(2, ge=1, le=50, description="pairs of views that must agree where both drives know their place")
    least_agreeing_alone: int = Field(5, ge=2, le=50, description="the same where one of them does not")
    loops: LoopSettings = LoopSettings(least_agreeing=2)
    registration: RegistrationSettings = RegistrationSettings()
