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


class StorageOut(BaseModel):
    """Room on the disk of the data folder, bytes."""

    total: int
    used: int
    free: int
    least_free: int = Field(description="below it no upload is taken")


class FleetOut(BaseModel):
    """The fleet and what is being done for it."""

    version: str
    vehicles: list[VehicleOut]
    queues: list[QueueOut]
    work: list[WorkOut]
    storage: StorageOut
    retention: str = Field(description="when images are deleted: setting uploads.retention")
