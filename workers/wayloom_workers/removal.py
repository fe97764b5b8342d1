"""The removal of a drive: its files at once, its part of the map with the next version."""

import shutil

from wayloom.store import drives, jobs
from wayloom.store.database import Session
from wayloom.store.jobs import JobMessage
from wayloom_workers.steps import StageAttempt


def nothing(_work: StageAttempt) -> None:
    """A stage whose work is all in what it shares and records."""


def remove_files(work: StageAttempt) -> None:
    """The drive's folder. What has arrived of unfinished uploads the sweeper drops, when their rows are gone."""
    shutil.rmtree(work.bench.folders.drive(str(work.claim.drive_id)), ignore_errors=True)


def remove_rows(session: Session, work: StageAttempt) -> list[JobMessage]:
    """Forget the drive; where it was in the map, the map is stitched without it."""
    drive = drives.get(session, str(work.claim.drive_id))
    map_id, was_placed = drive.map_id, drive.stitch_job_id is not None
    drives.delete_rows(session, drive.id)
    if not was_placed:
        return []
    job = jobs.request_stitch(session, map_id)
    return [JobMessage(job.id, job.queue)]
