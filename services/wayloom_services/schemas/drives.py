"""Models of drives: announcement, stages, verdicts and runs. Times are seconds since 1970."""

from typing import Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from wayloom.config.drive_states import DriveState
from wayloom.config.gate import Gate, Grade
from wayloom.pipeline.settings import ProcessSettings, with_asked
from wayloom.segmentation.catalogue import MODELS
from wayloom_services.schemas.privacy import ImagesOut

StageState = Literal["waiting", "queued", "running", "done", "failed"]


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


class EtaOut(BaseModel):
    """Between how many seconds a drive will still take."""

    low_s: float
    high_s: float
    rough: bool = Field(description="a stage that is still to come was never seen here: its time is a guess by the drive's frames")


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
        description="seconds to the end as guessed from the usual time of the stages; None: one of them was never seen. It is not "
        "corrected by how earlier guesses turned out, as `eta` is, and may lie outside of that"
    )
    eta: EtaOut | None = Field(
        None, description="the same as an interval, from the first drive on; None: nobody works on the drive"
    )
    warnings: list[str] = Field(
        [], description="what is doubtful about the result, the most serious first, as in the drive's report"
    )
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


class DriveQuery(BaseModel):
    """Which drives are listed, and how."""

    limit: int = Field(100, ge=1, le=500)
    before: float | None = Field(None, description="only drives registered before this time")
    state: DriveState | None = None
    vehicle: str | None = Field(None, max_length=128, description="only of this vehicle")
    search: str | None = Field(None, max_length=128, description="a part of name or vehicle, or the begin of an id")
    sort: Literal["newest", "oldest", "name", "vehicle", "grade"] = "newest"
    offset: int = Field(0, ge=0, le=10_000_000, description="so many are skipped")


class DriveList(BaseModel):
    """Drives, newest first."""

    drives: list[DriveOut]
    next_before: float | None = Field(description="give as `before` to get the next page of the newest drives")
    total: int = Field(description="how many drives there are like those that were asked for")
    states: dict[str, int] = Field(description="how many drives there are in each state, whatever was asked for")


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
