"""Response models of the API, as its OpenAPI document shows them. Times are seconds since 1970."""

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from wayloom.config.gate import Gate, Grade

DriveState = Literal["uploading", "queued", "running", "stitching", "done", "held", "quarantined", "failed", "removing"]
StageState = Literal["waiting", "queued", "running", "done", "failed"]


class StageOut(BaseModel):
    """One stage of a drive."""

    stage: str
    state: StageState
    progress: float = Field(ge=0, le=1)
    message: str
    attempt: int
    error: str | None
    started_at: float | None
    finished_at: float | None
    seconds: float | None = Field(description="how long it took, or has run so far")


class ReleaseOut(BaseModel):
    """An operator's word that the drive is merged in spite of its grade."""

    by: str
    why: str
    at: float


class QualityOut(BaseModel):
    """What the geo-reference says of the drive, and what the map does with it."""

    grade: Grade | None = Field(description="A to E; None: the drive has no place on Earth")
    reasons: list[str]
    gate: Gate = Field(description="merge; hold: waits for an operator; quarantine: nothing but an operator's word merges it")
    release: ReleaseOut | None


class ReleaseIn(BaseModel):
    """Who releases a drive, and why."""

    model_config = ConfigDict(extra="forbid", str_strip_whitespace=True)
    by: str = Field(min_length=1, max_length=128, pattern=r"^[^\x00]*$")
    why: str = Field(min_length=1, max_length=2000, pattern=r"^[^\x00]*$")


class DriveOut(BaseModel):
    """One drive and how far it is."""

    id: str
    name: str
    vehicle_id: str | None
    map_id: str
    state: DriveState
    note: str | None = Field(description="a few words on the outcome, as 'not geo-referenced'")
    error: str | None
    stage: str | None = Field(description="the stage that is running or comes next")
    progress: float = Field(ge=0, le=1, description="share of all stages that is done")
    eta_s: float | None = Field(
        description="seconds to the end as guessed from this and earlier drives; None where nothing is known"
    )
    stages: list[StageOut]
    files: int
    bytes: int
    received_files: int
    received_bytes: int
    placed: bool | None
    quality: QualityOut | None = Field(description="None until the geo-reference is done")
    facts: dict[str, Any]
    created_at: float
    uploaded_at: float | None
    finished_at: float | None


class DriveList(BaseModel):
    """Drives, newest first."""

    drives: list[DriveOut]
    next_before: float | None = Field(description="give as `before` to get the next page")


class MissingFile(BaseModel):
    """A file that the server lacks, and where its upload can be continued."""

    path: str
    size: int
    sha256: str
    upload: str | None = Field(description="address of an unfinished upload of this file")
    offset: int = Field(description="bytes that it has already")


class Registration(BaseModel):
    """The answer to a manifest."""

    id: str
    created: bool
    drive: DriveOut
    missing: list[MissingFile]


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


class ChangeList(BaseModel):
    """What a version changed."""

    changed: list[ChangedTile]
    gone: list[TileName]


class VersionList(BaseModel):
    """The versions that are kept, newest first."""

    versions: list[VersionOut]


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


class RigDriveOut(BaseModel):
    """A drive that says something of its rig."""

    drive_id: str
    recorded_at: float
    epoch_from: float
    gnss_ratio: float | None = Field(
        description="metres of road per metre of odometry, by GNSS alone; None where it says too little"
    )
    gnss_ratio_sigma: float | None


class RigEpochOut(BaseModel):
    """A stretch of a rig's life in which its drives agree."""

    from_time: float
    drives: int
    chi_square: float | None = Field(
        description="of ten, by which its first drive contradicts the epoch before; None for the first"
    )
    stray: bool = Field(description="one drive that agrees with nothing before and after")


class ReceiverEpochOut(BaseModel):
    """A stretch of a rig's life with one GNSS clock and one place of the antenna, as its drives tell them."""

    from_time: float
    drives: list[str]
    chi_square: float | None = Field(
        description="of four, by which its first drive contradicts the epoch before; None for the first"
    )
    stray: bool = Field(description="one drive that agrees with nothing before and after")
    time_offset_s: float = Field(description="by how much the stamps of fixes are too late")
    sigma_time_offset_s: float = Field(description="where the lever arm is not given")
    p_cam_gnss_m: list[float] = Field(description="the antenna in the left camera's frame, by the drives alone")
    sigma_p_cam_gnss_m: list[float]


class RigVersionOut(BaseModel):
    """A version of a rig's file: what was known, from which drives."""

    version: int
    sha256: str
    epoch_from: float
    drives: list[str]
    reason: str
    facts: dict[str, Any] = Field(description="lens and baseline with sigmas; scale_sigma of its newest drive")
    created_at: float


class RigOut(BaseModel):
    """A rig, all that its drives say of it, and the versions of its file, newest first."""

    id: str
    vehicle_id: str | None
    rig_id: str | None
    created_at: float
    drives: list[RigDriveOut]
    epochs: list[RigEpochOut]
    receivers: list[ReceiverEpochOut]
    versions: list[RigVersionOut]


class RigList(BaseModel):
    """Every rig."""

    rigs: list[RigOut]


class Feature(BaseModel):
    """A GeoJSON feature."""

    type: Literal["Feature"] = "Feature"
    geometry: dict[str, Any] | None
    properties: dict[str, Any]


class FeatureCollection(BaseModel):
    """A GeoJSON feature collection, WGS84."""

    type: Literal["FeatureCollection"] = "FeatureCollection"
    features: list[Feature]


class Health(BaseModel):
    """Whether the server lives, and what it can reach."""

    status: Literal["ok", "degraded"]
    version: str
    checks: dict[str, str]


class ClassOut(BaseModel):
    """A class of the map."""

    id: int
    name: str
    colour: str
    in_map: bool = Field(description="False for what moves and for the sky, which the map leaves out")


class Info(BaseModel):
    """Map, stages and classes: for dashboards and clients, before their first request."""

    version: str
    map_id: str
    needs_key: bool
    stages: list[str]
    classes: list[ClassOut]
