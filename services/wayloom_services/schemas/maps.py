"""Models of maps: versions, tiles that changed, features, regions and submaps. Times are seconds since 1970."""

from typing import Any, Literal

from pydantic import BaseModel, Field


class MapOut(BaseModel):
    """A map and its newest version."""

    id: str
    version: int = Field(description="0: nothing published yet")
    created_at: float


class MapList(BaseModel):
    """Every map."""

    maps: list[MapOut]


class VersionOut(BaseModel):
    """One published version of a map."""

    map_id: str
    version: int
    created_at: float
    frame: list[float] = Field(description="origin of the map's ENU frame: longitude, latitude, ellipsoidal height")
    drives: list[str]
    submaps: int
    bounds: list[float] | None = Field(description="west, south, east, north")
    layers: dict[str, Any]
    tiles: int
    bytes: int
    facts: dict[str, Any]


class TileName(BaseModel):
    """Where a tile is."""

    layer: str
    z: int
    x: int
    y: int


class ChangedTile(TileName):
    """A tile that a version brought; the digest is its ETag."""

    digest: str
    bytes: int


class Feature(BaseModel):
    """A GeoJSON feature."""

    type: Literal["Feature"] = "Feature"
    geometry: dict[str, Any] | None
    properties: dict[str, Any]


class FeatureCollection(BaseModel):
    """A GeoJSON feature collection, WGS84."""

    type: Literal["FeatureCollection"] = "FeatureCollection"
    features: list[Feature]


class MarkingPage(FeatureCollection):
    """Markings and kerbs; `next` is null on the last page."""

    next: str | None


class ChangeList(BaseModel):
    """What a version changed."""

    changed: list[ChangedTile]
    gone: list[TileName]
    things: FeatureCollection
    withdrawn_things: FeatureCollection


class VersionList(BaseModel):
    """The versions that are kept, newest first."""

    versions: list[VersionOut]


class RegionParts(BaseModel):
    """A region of a version: its place in the grid, and the digests of its files; empty: it has none."""

    east: int
    north: int
    bytes: int = Field(description="of its voxels")
    voxels: str
    ground: str
    markings: str
    areas: str
    objects: str


class RegionPartsList(BaseModel):
    """Regions of a version, by column and row."""

    frame: list[float] = Field(description="longitude, latitude, height of the origin of the map's frame")
    built_with: str = Field(description="digest of settings, code and frame")
    regions: list[RegionParts]


class SubmapOut(BaseModel):
    """A submap: its place; its points are at /v1/submaps/{digest}."""

    digest: str
    drive_id: str
    position: int
    points: int
    bounds: list[float]
    frame: list[float]
    T_enu_submap: list[list[float]]
    covariance: list[list[float | None]]


class SubmapList(BaseModel):
    """Submaps that touch a box."""

    submaps: list[SubmapOut]
