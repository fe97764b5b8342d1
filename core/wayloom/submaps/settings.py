"""Settings of the submaps."""

from pydantic import Field

from wayloom.config.settings import Settings


class SubmapSettings(Settings):
    """Length of the submaps, and the limits of depth and uncertainty of their points."""

    keep_persons: bool = Field(
        False, description="keep points of persons and riders in the submaps and clouds of `wayloom process`; a service never does"
    )
    length_m: float = Field(75.0, gt=0.0, description="wanted length of road of a submap, m")
    max_length_m: float = Field(100.0, gt=0.0, description="no submap is longer, m")
    broken_step_m: float = Field(
        0.05, gt=0.0, description="where a step between keyframes is less certain (sigma), submaps end: half a voxel of the map, m"
    )
    max_distance_m: float = Field(60.0, gt=0.0, description="points further from their host camera are left out, m")
    max_depth_sigma_share: float = Field(
        0.05, gt=0.0, description="a point is kept when its depth sigma is under this share of its depth …"
    )
    max_depth_sigma_m: float = Field(0.5, gt=0.0, description="… or under so many metres, m")
    pixel_sigma: float = Field(0.5, gt=0.0, description="sigma of a point's place in its host image, px")
    position_floor_m: float = Field(0.02, gt=0.0, description="no point's position is trusted beyond this, m")
