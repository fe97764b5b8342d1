"""Settings of the fusion of submaps."""

from typing import Final

from pydantic import Field, model_validator

from wayloom.config.settings import Settings

FITS: Final = 3
"""Planes are fitted so often, each time to points weighted by their distance from the plane before."""
WIDEST_VOXEL_M: Final = 0.5
"""Coarser voxels may differ at the seams of regions."""
LARGEST_THING_M: Final = 6.0
THING_HALO_M: Final = LARGEST_THING_M + 0.5
"""How far around a region things reach that have a point or their middle in it."""
HALO_M: Final = 12.0 + THING_HALO_M
"""How far around a region points bear on what is in it, at most."""
FURTHEST_LOOK_M: Final = 25.0
LOOK_HALO_M: Final = FURTHEST_LOOK_M + THING_HALO_M
"""How far around a region looks bear on what is in it, at most: the cameras, not what they see."""


class ChangeSettings(Settings):
    """When a look sees a thing or through it, and how many looks make a thing gone or new."""

    see_m: float = Field(25.0, gt=0.0, le=FURTHEST_LOOK_M, description="how far looks are believed, m")
    gate_sigma: float = Field(2.0, gt=0.0, description="so many sigma of places and depths may a look be off")
    slack_m: float = Field(0.3, ge=0.0, description="and so much besides: a thing is no point, m")
    share: float = Field(0.5, gt=0.0, le=1.0, description="least share of a thing's points that a look sees through")
    link_m: float = Field(0.5, gt=0.0, le=0.5, description="edge of the columns whose points are one thing where they touch, m")
    thing_m: float = Field(LARGEST_THING_M, gt=0.0, le=LARGEST_THING_M, description="larger things are judged in pieces, m")
    nothing_odds: float = Field(
        8.0, gt=0.0, description="log-odds, by the looks of all other drives together, at which nothing is there"
    )
    least_through: int = Field(4, ge=1, description="and at least so many of these looks see through")
    least_through_vehicle: int = Field(3, ge=1, description="the same of a vehicle, which stereo does not miss")
    looks: int = Field(4, ge=1, description="looks of the drives that have a thing before it can be missed")
    agreeing: float = Field(0.25, ge=0.0, description="looks of these that see through it, for each that sees it, at most")
    confirming: int = Field(5, ge=1, description="looks of one drive that confirm a new thing; two drives do with fewer")
    listed_points: int = Field(2, ge=1, description="points of a thing, but of a post or sign, whose change is listed")


class MergeSettings(Settings):
    """The grids, and what is believed of a point. They are fixed for a map: changing one makes another map."""

    voxel_m: float = Field(0.1, ge=0.01, le=10.0, description="edge of a voxel, m")
    surface_cell_m: float = Field(
        0.8, ge=0.1, le=5.0, description="edge of a cell of the planes, m; each is fitted to three cells a side"
    )
    surface_points: float = Field(8.0, ge=4.0, description="least points, by their weights, that make a plane")
    surface_sigma_m: float = Field(1.0, gt=0.0, description="points that make planes have at most this sigma, m")
    surface_floor_m: float = Field(0.02, gt=0.0, description="no surface is taken to be more even than this, m")
    gate_sigma: float = Field(2.0, gt=0.0, description="a point is taken to be on a surface that lies within so many sigma")
    reach_m: float = Field(2.0, gt=0.0, le=10.0, description="no point is moved further than this onto a surface, m")
    across_rad: float = Field(0.002, gt=0.0, description="sigma of a point across its ray, radians")
    lone_sigma_m: float = Field(0.3, gt=0.0, description="a point that nothing confirms is published up to this sigma, m")
    confirm_m: float = Field(0.2, gt=0.0, le=1.0, description="a point of another drive so near confirms it, m")
    vote_reach_m: float = Field(1.2, gt=0.0, le=2.0, description="points of one surface so near vote together, m")
    lone_vote_reach_m: float = Field(0.2, gt=0.0, le=2.0, description="the same for points on no surface, m")
    surface_thickness_m: float = Field(0.15, gt=0.0, description="how far from its plane a point still votes on a surface, m")
    standing_s: float = Field(1.0, gt=0.0, description="a vehicle that a drive sees at one place for so long is parked, s")
    change: ChangeSettings = ChangeSettings()

    @property
    def halo_m(self) -> float:
        """m around a region that decide what it holds.

        A voxel's votes come from points within `vote_reach_m` of it after the fusion. Which plane a point was moved to, up to
        `reach_m`, is chosen among planes up to `reach_m` around it, which reach half a cell beyond their own; and each fit of a
        cell's plane asks for the points of the cells next to it and for their planes before. What confirms a point is itself fused.
        """
        fits = (FITS + 1.5) * self.surface_cell_m
        votes = max(self.vote_reach_m, self.lone_vote_reach_m)
        return 2.0 * self.reach_m + self.confirm_m + votes + fits + 2.0 * min(self.voxel_m, WIDEST_VOXEL_M)

    @model_validator(mode="after")
    def _reach_no_further_than_the_halo(self) -> "MergeSettings":
        most = HALO_M - THING_HALO_M
        if self.halo_m > most:
            raise ValueError(
                f"points bear on a region from {self.halo_m:.1f} m around it: shorten reaches or cells to come under {most} m"
            )
        return self


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
    level_deg: float = Field(1.0, gt=0.0, le=45.0, description="sigma of how level a drive without GNSS lies, degrees")
    least_road_m: float = Field(
        100.0, ge=0.0, description="road of a drive without GNSS whose meetings must agree before the city map takes it, m"
    )
    free_m: float = Field(100.0, gt=0.0, description="prior sigma of a drive without GNSS about where its meetings put it, m")
    free_rad: float = Field(1.0, gt=0.0, description="the same of its heading, rad")
    whole_up_to: int = Field(1000, ge=1, description="drives that meet are solved as one up to so many submaps, else cell by cell")
    cell_m: float = Field(500.0, gt=0.0, description="edge of the cells of which each is solved with its surroundings, m")
    halo_m: float = Field(500.0, ge=0.0, description="how far the surroundings reach beyond a cell, m")
