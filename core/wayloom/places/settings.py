"""Settings of the places."""

from pydantic import Field

from wayloom.config.settings import Settings


class PlaceSettings(Settings):
    """Spacing, number and limits of local features, static points and stations."""

    feature_spacing_m: float = Field(2.0, gt=0.0, description="road between keyframes that keep local features, m")
    features: int = Field(200, ge=1, le=300, description="local features of such a keyframe, at most")
    describe_width_px: int = Field(
        1000, ge=64, description="narrower images are enlarged by whole numbers towards this before features are described, px"
    )
    cloud_spacing_m: float = Field(2.0, gt=0.0, description="road between keyframes whose stereo pair gives static points, m")
    cloud_candidates: int = Field(4000, ge=0, description="pixels of such a keyframe that are matched")
    cloud_depth_m: float = Field(40.0, gt=0.0, le=300.0, description="static points further from their camera are left out, m")
    cloud_sigma_m: float = Field(1.0, gt=0.0, description="static points whose depth is less sure are left out, m")
    feature_depth_share: float = Field(
        0.15, gt=0.0, description="features whose depth's sigma is over this share of it are left out"
    )
    voxel_m: float = Field(0.2, gt=0.0, description="one static point a cube of this side, within the reach of road, m")
    station_spacing_m: float = Field(10.0, gt=0.0, description="road between the keyframes by which an index knows the drive, m")
    reach_m: float = Field(30.0, gt=0.0, description="road before and behind a keyframe that its surroundings are gathered from, m")
