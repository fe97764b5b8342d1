"""Models of the fleet and of this service's work. Times are seconds since 1970."""

from pydantic import BaseModel, Field


class VehicleOut(BaseModel):
    """A vehicle that has sent at least one drive."""

    id: str
    created_at: float
    drives: dict[str, int] = Field(description="by state")
    last_at: float | None = Field(description="when its newest drive was announced")
    bytes: int


class QueueOut(BaseModel):
    """A queue of jobs."""

    name: str
    queued: int
    running: int


class WorkOut(BaseModel):
    """A job that a worker holds."""

    worker: str = Field(description="host and process")
    stage: str
    part: int
    drive_id: str | None
    drive_name: str | None
    progress: float
    message: str
    attempt: int
    started_at: float | None
    heartbeat_at: float | None


class MapJobOut(BaseModel):
    """A stitch or a publish of a map."""

    id: int
    stage: str = Field(description="stitch or publish")
    state: str = Field(description="waiting, queued, running, done or failed")
    parts: int = Field(description="into how many it was cut")
    attempt: int
    losses: int = Field(description="workers that were lost while they ran it")
    asked_at: float
    started_at: float | None = Field(description="of the newest attempt")
    finished_at: float | None
    version: int | None = Field(description="what it published, as long as that is known")
    message: str
    error: str | None


class MapJobs(BaseModel):
    """Jobs of a map, newest first. next: `before` of the next page, null on the last."""

    jobs: list[MapJobOut]
    next: int | None


class StorageOut(BaseModel):
    """Room on the disk of the data folder, bytes."""

    total: int
    used: int
    free: int
    least_free: int = Field(description="below it no upload is taken")


class EtaStageOut(BaseModel):
    """Estimates of remaining time that were told as a stage began, and judged since."""

    stage: str
    judged: int
    within: int = Field(description="how many had the truth within the interval that was told")


class EtaCalibrationOut(BaseModel):
    """How often the truth lay within the interval of a drive's remaining time that was told."""

    nominal: float = Field(description="share that should")
    measured: float | None = Field(description="share of the newest judged estimates, at most 1000; null before the first")
    judged: int = Field(description="how many `measured` is of")
    stages: list[EtaStageOut] = Field(description="all that were ever judged")


class FleetOut(BaseModel):
    """The fleet and what is being done for it."""

    version: str
    vehicles: list[VehicleOut]
    queues: list[QueueOut]
    work: list[WorkOut]
    storage: StorageOut
    retention: str = Field(description="when images are deleted: setting uploads.retention")
    eta: EtaCalibrationOut
