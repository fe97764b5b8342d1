"""Settings of dense depth and looks."""

from pydantic import Field

from wayloom.config.settings import Settings


class LookSettings(Settings):
    """Spacing and size of the looks, and of the images that they are matched in."""

    spacing_m: float = Field(2.0, gt=0.0, description="road between keyframes that keep a look, m")
    width_px: int = Field(176, ge=16, le=1024, description="a look's width at most; its pixels are whole pixels of the image, px")
    match_width_px: int = Field(
        800, ge=64, description="wider images are matched at a half, a quarter, … of their size, until they are no wider, px"
    )
    check_px: float = Field(0.7, gt=0.0, description="a disparity is sure when the one from the right image is as near, px")
    sure_share: float = Field(0.5, gt=0.0, le=1.0, description="least share of a patch's pixels that are sure where the patch is")
