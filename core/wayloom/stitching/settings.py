"""Settings of the voxel fusion."""

from pydantic import Field

from wayloom.config.settings import Settings


class MergeSettings(Settings):
    """The voxel grid. It is fixed for a map: changing it makes another map."""

    voxel_m: float = Field(0.1, ge=0.01, le=10.0, description="edge of a voxel, m")


class CityGraphSettings(Settings):
    """The graph of the submaps of all drives. The odometry's noise serves where a drive does not tell what joins its submaps."""

    position_noise_m: float = Field(
        0.005, gt=0.0, le=5.0, description="odometry: sigma of position after one metre, m; grows with the root"
    )
    rotation_noise_deg: float = Field(0.02, gt=0.0, le=10.0, description="odometry: sigma of rotation after one metre, degrees")
    scale_sigma: float = Field(
        0.002, gt=0.0, le=0.5, description="odometry: sigma of its scale between neighbouring submaps, as a share"
    )
    confidence: float = Field(0.9999, gt=0.9, lt=1.0, description="of chi-square (6): beyond, a meeting is refused")
    least_agreeing: int = Field(2, ge=1, description="meetings that must agree before a drive without GNSS is placed by them")
    free_m: float = Field(100.0, gt=0.0, description="prior sigma of a drive without GNSS about where its meetings put it, m")
    free_rad: float = Field(1.0, gt=0.0, description="the same of its heading, rad")
    whole_up_to: int = Field(1000, ge=1, description="drives that meet are solved as one up to so many submaps, else cell by cell")
    cell_m: float = Field(500.0, gt=0.0, description="edge of the cells of which each is solved with its surroundings, m")
    halo_m: float = Field(500.0, ge=0.0, description="how far the surroundings reach beyond a cell, m")
