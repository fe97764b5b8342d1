"""Removal of a drive: its files at once, its part of the map with the next version."""

import shutil

from wayloom.store import drives, gate, jobs, maps
from wayloom.store.database import Session
from wayloom.store.jobs import JobMessage
from wayloom.store.receiving import parts
from wayloom.store.withdrawal import forget_meetings
from wayloom_workers.stage_hooks import StageAttempt


def nothing(_attempt: StageAttempt) -> None:
    """The run of a stage that only shares and records."""


def remove_files(attempt: StageAttempt) -> None:
    """The drive's folder, and what was stitched with it and is published. What has arrived of unfinished uploads the sweeper drops,
    when their rows are gone."""
    drive_id, context = str(attempt.claim.drive_id), attempt.context
    shutil.rmtree(context.folders.drive(drive_id), ignore_errors=True)
    with context.database.write() as session:
        names = parts.forget_drive(session, drive_id)
    context.files.forget(names)
    with context.database.read() as session:
        map_id = drives.get(session, drive_id).map_id
        if jobs.is_map_at_work(session, map_id):
            return  # the next version tidies up
    for output in (context.folders.map(map_id) / "stages").glob("*/*"):
        if any(drive_id in file.read_text(encoding="utf-8") for file in output.glob("*.json")):
            shutil.rmtree(output, ignore_errors=True)


def remove_rows(session: Session, attempt: StageAttempt) -> list[JobMessage]:
    """Forget the drive; where it was in the map, the map is stitched without it."""
    drive = drives.get(session, str(attempt.claim.drive_id))
    map_id = drive.map_id
    will_be = gate.passes(drive) and maps.has_submaps(session, drive.id)
    was_merged = will_be or drive.stitch_job_id is not None or maps.holds(session, map_id, drive.id)
    drives.delete_rows(session, drive.id)
    if not was_merged:
        forget_meetings(session, map_id, attempt.claim.drive_id or "")
        return []
    job = jobs.request_stitch(session, map_id)
    return [JobMessage(job.id, job.queue)]
