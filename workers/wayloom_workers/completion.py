"""Completion of a drive: after its last stage it goes into the map, or, without a place on Earth, ends outside of it."""

from wayloom.store import drives, jobs, maps
from wayloom.store.database import Session, now_s
from wayloom.store.jobs import JobMessage


def complete_drive(session: Session, drive_id: str) -> list[JobMessage]:
    """Have the map stitched with the drive's submaps; a drive without any is done."""
    drive = drives.get(session, drive_id)
    if not maps.has_submaps(session, drive_id):
        drive.state, drive.finished_at = "done", now_s(session)
        return []
    job = jobs.request_stitch(session, drive.map_id)
    drive.state, drive.stitch_job_id = "stitching", job.id
    return [JobMessage(job.id, job.queue)]
