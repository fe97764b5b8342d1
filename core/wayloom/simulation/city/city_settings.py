"""Settings of the synthetic city."""

from pydantic import Field

from wayloom.config.settings import Settings


class CitySettings(Settings):
    """A city of columns x rows crossings, about 78 m apart. Equal settings give equal cities, in any order of building."""

    seed: int = Field(default=7, ge=0, description="another seed, another city")
    columns: int = Field(default=5, ge=3, le=400, description="crossings from west to east")
    rows: int = Field(default=5, ge=3, le=400, description="crossings from south to north")
    hard: bool = Field(
        default=False, description="all blocks are one and the same block, on a flat, even grid: false loop closures"
    )
    changed: bool = Field(default=False, description="later in the same city: some signs, poles, parked cars and one facade differ")
    traffic: float = Field(default=1.0, ge=0, le=4, description="vehicles on the streets, 1 is a usual day")
    people: float = Field(default=1.0, ge=0, le=4, description="people on the sidewalks, 1 is a usual day")
