"""Settings of the ground sheets."""

from pydantic import Field

from wayloom.config.settings import Settings


class GroundSettings(Settings):
    """Spacing and reach of the keyframes that a sheet is made of, matching, surface and picture."""

    spacing_m: float = Field(0.8, gt=0.0, description="road between keyframes that a ground sheet is made of, m")
    reach_m: float = Field(25.0, gt=0.0, le=100.0, description="ground further from its camera is left out, m")
    search_share: float = Field(
        0.012,
        gt=0.0,
        le=0.1,
        description="disparities searched on either side of the ground plane's, as a share of the image's width",
    )
    mover_margin_share: float = Field(
        0.008,
        ge=0.0,
        le=0.1,
        description="margin around persons and vehicles that shows no ground, as a share of the image's width",
    )
    smoothing_m: float = Field(0.4, gt=0.0, le=2.0, description="radius over which the surface is a plane, steps left out, m")
