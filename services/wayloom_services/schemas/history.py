"""Models of a drive's history. Times are seconds since 1970."""

from pydantic import BaseModel, Field

from wayloom.store.processes import name_of
from wayloom.store.tables.drives import DriveEvent


class EventOut(BaseModel):
    """An entry: something that happened to a stage."""

    at: float
    stage: str
    part: int = Field(description="0: the whole stage")
    attempt: int
    what: str = Field(description="begun, done, failed, again, waits, lost, back, cancelled or asked")
    text: str = Field(description="error or evidence")
    worker: str | None = Field(description="host and process that began it")

    @classmethod
    def of(cls, row: DriveEvent) -> "EventOut":
        """Of a row."""
        worker = None if row.worker is None else name_of(row.worker)
        return cls(at=row.at, stage=row.stage, part=row.part, attempt=row.attempt, what=row.what, text=row.text, worker=worker)


class History(BaseModel):
    """Entries, newest first. next: `before` of the next page, null on the last."""

    events: list[EventOut]
    next: int | None
