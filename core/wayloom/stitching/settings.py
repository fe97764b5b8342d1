"""Settings of the voxel fusion."""

from pydantic import Field

from wayloom.config.settings import Settings


class MergeSettings(Settings):
    """The voxel grid. It is fixed for a map: changing it makes another map."""

    voxel_m: float = Field(0.1, ge=0.01, le=10.0, description="edge of a voxel, m")
