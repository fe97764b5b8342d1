"""Response models of the API, as its OpenAPI document shows them. Times are seconds since 1970."""

from typing import Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from wayloom.config.gate import Gate, Grade
from wayloom.pipeline.settings import ProcessSettings, with_asked
from wayloom.segmentation.catalogue import MODELS
from wayloom_services.privacy_schemas import ImagesOut

DriveState = Literal["uploading", "queued", "running", "stitching", "done", "held", "quarantined", "failed", "removing"]
StageState = Literal["waiting", "queued", "running", "done", "failed"]


def inlined_schema(model: type[BaseModel]) -> dict[str, Any]:
    """JSON schema of a body that the endpoint parses itself, without references."""
    schema = model.model_json_schema()
    named = {f"#/$defs/{name}": definition for name, definition in schema.pop("$defs", {}).items()}

    def inline(part: Any) -> Any:
        if isinstance(part, dict):
            return inline(named[part["$ref"]]) if "$ref" in part else {key: inline(value) for key, value in part.items()}
        return [inline(one) for one in part] if isinstance(part, list) else part

    found: dict[str, Any] = inline(schema)
    return found


class RetryIn(BaseModel):
    """Where to begin."""

    model_config = ConfigDict(extra="forbid")
    stage: str | None = Field(None, max_length=32, description="first stage to be made anew; else the one that failed")


class LossOut(BaseModel):
    """A worker that died or fell silent while it ran a stage, through no fault of the stage that is known."""

    at: float
    worker: str
    progress: float
    message: str
    why: str


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
    losses: list[LossOut] = Field([], description="workers that were lost over it; they use up no attempt")


class ReleaseOut(BaseModel):
    """An operator's word that the drive is merged in spite of its grade."""

    by: str
    why: str
    at: float


class MapVerdictOut(BaseModel):
    """Whether a held drive is in the map by its meetings with other drives."""

    admitted: bool
    reason: str = Field(description="in words: 'placed by 5 meetings with 3 drives, sigma 0.08 m'")
    grade: Grade | None = Field(description="A to E by its place in the map; None: it has none there")
    sigma_m: float | None = Field(description="median of the position's")
    meetings: int
    drives: list[str] = Field(description="ids of those that it meets")


class QualityOut(BaseModel):
    """What the geo-reference says of the drive, and what the map does with it."""

    grade: Grade | None = Field(description="A to E by the drive's own evidence; None: it has no GNSS")
    reasons: list[str]
    gate: Gate = Field(
        description="merge; hold: waits for other drives that place it, or an operator; quarantine: for an operator's word alone"
    )
    sound: bool = Field(description="whether at most the drive's place is in doubt: then the drives that it meets may place it")
    by_map: MapVerdictOut | None = Field(description="what the newest version says of a held drive; None where it was not asked")
    release: ReleaseOut | None


class ReleaseIn(BaseModel):
    """Who releases a drive, and why."""

    model_config = ConfigDict(extra="forbid", str_strip_whitespace=True)
    by: str = Field(min_length=1, max_length=128, pattern=r"^[^\x00]*$")
    why: str = Field(min_length=1, max_length=2000, pattern=r"^[^\x00]*$")


Table = dict[str, bool | int | float | str]
"""Some keys of a table of the settings."""


class ReprocessIn(BaseModel):
    """With what a drive is processed anew, where not with the service's settings."""

    model_config = ConfigDict(extra="forbid")
    model: str | None = Field(None, max_length=64, description="a network of the catalogue, by its name")
    rig_version: int | None = Field(None, ge=1, le=2**31 - 1, description="of the drive's rig; default the newest")
    odometry: Table = Field(default={}, description="keys of the table [odometry] of the settings")
    labelling: Table = Field(default={}, description="keys of the table [labelling] of the settings")

    @field_validator("model")
    @classmethod
    def _known(cls, name: str | None) -> str | None:
        if name is not None and name not in MODELS:
            raise ValueError(f"unknown network {name!r}; known are {', '.join(MODELS)}")
        return name

    @model_validator(mode="after")
    def _in_range(self) -> Self:
        with_asked(ProcessSettings(), self.asked())
        return self

    def asked(self) -> dict[str, Any]:
        """The tables of `ProcessSettings` that it names."""
        tables = {"segmentation": {} if self.model is None else {"model": self.model}}
        return {name: table for name, table in {**tables, "odometry": self.odometry, "labelling": self.labelling}.items() if table}


class ReprocessOut(BaseModel):
    """A drive that is processed anew. Quality, facts and track are of the result before, until the new one is published."""

    since: float
    asked: dict[str, Any] = Field(description="tables of settings that count more than the service's")
    state: Literal["running", "publishing", "failed"]
    error: str | None


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
    eta_s: float | None = Field(description="seconds to the end as guessed from this and earlier drives; None: nothing is known")
    stages: list[StageOut]
    files: int
    bytes: int
    received_files: int
    received_bytes: int
    images: ImagesOut
    placed: bool | None
    quality: QualityOut | None = Field(description="None until the geo-reference is done")
    facts: dict[str, Any]
    reprocess: ReprocessOut | None = Field(description="None unless it is processed anew; `stages` and `progress` are of that run")
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


class OpenPack(BaseModel):
    """A pack that can be continued."""

    upload: str
    length: int


class Registration(BaseModel):
    """The answer to a manifest. A file of an open pack that is not whole yet is missing, too."""

    id: str
    created: bool
    drive: DriveOut
    packs: list[OpenPack] | None = Field(description="unfinished packs of the drive; a server that knows no packs does not name it")
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
    overlays: list[str] = Field(description="layers of pictures beside `semantic`; a version has those that show anything")
    classes: list[ClassOut]
