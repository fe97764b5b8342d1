"""Settings of the objects: how they are found along a drive, and how the map fuses them."""

from pydantic import Field

from wayloom.config.settings import Settings


class ObjectSettings(Settings):
    """Keyframes that are looked at, and what is taken for an object."""

    spacing_m: float = Field(1.0, gt=0.0, description="road between keyframes that are searched for objects, m")
    reach_m: float = Field(22.0, gt=2.0, le=60.0, description="objects further from the camera are left out, m")
    least_looks: int = Field(3, ge=2, description="keyframes that must have seen an object")


class ObjectFusionSettings(Settings):
    """How the sightings of drives become the map's objects."""

    radius_m: float = Field(0.6, gt=0.0, le=3.0, description="sightings further apart are of two objects, m")
    sigmas: float = Field(3.0, gt=0.0, description="and those that differ by more sigmas than this")
    least_confidence: float = Field(0.65, ge=0.0, lt=1.0, description="probability from which on an object is in the map")
    looked: int = Field(4, ge=1, description="keyframes that must have looked at a place before a drive counts against an object")
