"""Processing of a drive anew, beside the result that the map has until the new one is published."""

from collections.abc import Mapping, Sequence
from typing import Any

from sqlalchemy import delete, null, select
from sqlalchemy.orm import Session

from wayloom.config.gate import Gate
from wayloom.config.stages import drive_stages
from wayloom.errors import ConflictError
from wayloom.store import gate, jobs, maps
from wayloom.store.coming import VERDICT
from wayloom.store.database import now_s
from wayloom.store.history import note_event
from wayloom.store.images import check_kept
from wayloom.store.jobs import JobMessage, create_drive_jobs
from wayloom.store.tables.drives import Drive, Job, SubmapRow


def begin(session: Session, drive_id: str, asked: Mapping[str, Any], facts: Mapping[str, Any] | None = None) -> JobMessage:
    """Queue all stages of the drive once more. Returns the first job's message.

    asked : tables of settings, as in `ProcessSettings`, that count more than the service's
    facts : that the run begins with
    Stages whose results depend on nothing that has changed find their outputs, and take no time. Raises ConflictError for a drive
    that has not arrived, is on its way, is being processed anew, or is being removed.
    """
    drive = gate.lock(session, drive_id)
    _check_can_begin(drive)
    session.execute(delete(Job).where(Job.drive_id == drive_id))
    note_event(session, drive_id, drive_stages()[0], "asked", text=f"processed anew{f' with {dict(asked)}' if asked else ''}")
    drive.coming = {"asked": {**asked}, "since": now_s(session), "facts": {**(facts or {})}}
    if drive.state == "failed":
        drive.state, drive.error, drive.finished_at = "queued", None, None
    return create_drive_jobs(session, drive_id)


def retry(session: Session, drive_id: str, stage: str | None = None) -> list[JobMessage]:
    """`jobs.retry`, while nobody else changes the drive: a sweeper may be about to delete its images. Raises NotFoundError."""
    gate.lock(session, drive_id)
    return jobs.retry(session, drive_id, stage)


def judge(session: Session, drive_id: str, grade: str | None, reasons: Sequence[str], verdict: Gate, sound: bool = False) -> None:
    """`gate.judge`; of a drive that is processed anew, when its new submaps are placed."""
    drive = gate.lock(session, drive_id)
    if drive.coming is None:
        gate.judge(session, drive_id, grade, reasons, verdict, sound)
    else:
        drive.coming = {**drive.coming, "verdict": [grade, [*reasons], verdict, sound]}


def place_submaps(session: Session, drive_id: str, rows: Sequence[SubmapRow]) -> None:
    """`maps.place_submaps`, and with it the verdict that belongs to them."""
    maps.place_submaps(session, drive_id, rows)
    drive = gate.lock(session, drive_id)
    if drive.coming is not None and "verdict" in drive.coming:
        drive.coming = {**drive.coming, "before": {name: getattr(drive, name) for name in VERDICT}}
        gate.judge(session, drive_id, *drive.coming["verdict"])


def await_version(drive: Drive, stitch_job_id: int | None) -> None:
    """The run is finished: its result is the drive's with the version that this job stitches; at once where there is none."""
    if drive.coming is None:
        return
    if stitch_job_id is None:
        _take(drive)
    else:
        drive.coming = {**drive.coming, "stitch": stitch_job_id}


def take_published(session: Session, map_id: str, stitch_job_id: int) -> None:
    """What this job has stitched is published: the new results that it took in are their drives'."""
    for drive in session.scalars(select(Drive).where(Drive.map_id == map_id, Drive.coming.is_not(null()))):
        assert drive.coming is not None
        if drive.coming.get("stitch", stitch_job_id + 1) <= stitch_job_id:
            _take(drive)
            note_event(session, drive.id, "publish", "done", text="what was made anew is in the map")


def _take(drive: Drive) -> None:
    assert drive.coming is not None
    drive.facts, drive.placed = drive.coming.get("facts", {}), drive.coming.get("placed")
    drive.track, drive.coming = drive.coming.get("track"), None


def _check_can_begin(drive: Drive) -> None:
    name = f"drive {drive.id[:12]}"
    if drive.state == "removing":
        raise ConflictError(f"{name} is being removed")
    if drive.uploaded_at is None:
        raise ConflictError(f"{name} has not arrived yet: send its files first")
    check_kept(drive)
    if drive.coming is not None and "error" not in drive.coming and drive.state != "failed":
        raise ConflictError(f"{name} is being processed anew already: wait until that is published")
    if drive.state in ("queued", "running", "stitching"):
        raise ConflictError(f"{name} is still on its way ({drive.state}): wait until it has a result")
