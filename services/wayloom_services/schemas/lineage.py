"""Models of what the map was made from: runs of drives, regions, voxels. Times are seconds since 1970."""

from typing import Any

from pydantic import BaseModel, Field


class RegionOut(BaseModel):
    """A region of a map version: what it was made from, and which blob it is."""

    east: int
    north: int
    digest: str
    inputs: str = Field(description="digest of the submaps, their places, the settings and the code")
    bytes: int


class MadeBy(BaseModel):
    """How a stage of a run was made."""

    stage: str
    key: str = Field(description="digest of all that the result depends on")
    digest: str | None = Field(description="of the result")
    code: str | None = Field(description="version of the code")
    libraries: dict[str, str]
    parameters: str | None = Field(description="digest of the stage's settings, and of what they mean by content")


class NetworkOut(BaseModel):
    """The network that labelled a drive's images."""

    name: str | None
    sha256: str | None
    device: str | None


class RunOut(BaseModel):
    """One way of a drive through its stages."""

    number: int
    created_at: float
    asked: dict[str, Any] = Field(description="tables of settings that counted more than the service's")
    network: NetworkOut
    stages: list[MadeBy]


class RunDetail(RunOut):
    """A run with the settings of its stages by value."""

    submaps: list[str]
    parameters: dict[str, Any]


class RunList(BaseModel):
    """The runs of a drive, newest first; the first made what the map has, or has next."""

    runs: list[RunDetail]


class DriveLineage(BaseModel):
    """A drive whose submaps bear on a place of the map."""

    id: str = Field(description="SHA-256 of the manifest that was uploaded, which names the SHA-256 of each file")
    name: str | None
    vehicle_id: str | None
    submaps: list[str] = Field(description="digests of those that bear on the place")
    run: RunOut | None = Field(description="what made them; None of a drive processed before runs were kept")


class VoxelOut(BaseModel):
    """A voxel of a column: where it is, and who saw it when."""

    layer: str
    label: str
    lon: float
    lat: float
    height_m: float
    distance_m: float
    drives: list[str]
    first_seen: float = Field(description="seconds since 1970, by the clocks of the drives' logs")
    last_seen: float


class LineageOut(BaseModel):
    """What a place of a map version was made from."""

    map_id: str
    version: int
    created_at: float
    built_with: str = Field(description="digest of the settings, the code and the frame of the map's own stages")
    regions: list[RegionOut]
    drives: list[DriveLineage]
    voxels: list[VoxelOut] | None = Field(description="of a point: those around it, nearest first")
