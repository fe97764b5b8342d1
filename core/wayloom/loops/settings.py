"""Settings of the search for loops."""

from pydantic import Field

from wayloom.config.settings import Settings
from wayloom.registration.settings import RegistrationSettings


class LoopSettings(Settings):
    """Where loops are looked for, how far the odometry is believed, and how many closures must agree."""

    spacing_m: float = Field(4.0, gt=0, le=50, description="road between keyframes that may be closed, m")
    scout_m: float = Field(12.0, gt=0, le=200, description="road between keyframes from which a loop is looked for, m")
    min_road_m: float = Field(40.0, ge=10, description="road between two places of one loop, at least, m")
    near_m: float = Field(10.0, ge=1, le=40, description="two places are one where their cameras are nearer than this, m")
    candidates: int = Field(6, ge=1, le=100, description="places that a scout compares with, at most")
    drift_share: float = Field(0.007, gt=0, le=0.1, description="standard deviation of the odometry's place, share of the road")
    drift_deg_per_sqrt_m: float = Field(0.05, gt=0, le=1, description="standard deviation of its attitude, degrees a root metre")
    max_prior_sigma_m: float = Field(
        15.0, gt=0, description="where the odometry is less certain, places are looked up by appearance, m"
    )
    recognised: int = Field(3, ge=1, le=20, description="places that a station is compared with by appearance, at most")
    max_prior_sigma_alone_m: float = Field(
        5.0, gt=0, description="a closure known by features alone stands without others where the odometry is as certain, m"
    )
    least_agreeing: int = Field(3, ge=2, le=20, description="closures of neighbours that must agree, at least")
    agreeing_road_m: float = Field(60.0, gt=0, description="neighbours are within this road of each other, m")
    max_cycle_chi2: float = Field(16.8, gt=0, description="chi-square, 6 degrees of freedom, of a cycle of two closures at most")
    registration: RegistrationSettings = RegistrationSettings()
