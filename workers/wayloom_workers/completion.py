"""Completion of a drive: after its last stage it goes into the map, or, where the gate keeps it, ends outside of it."""

from wayloom.store import gate, jobs, maps
from wayloom.store.database import Session, now_s
from wayloom.store.jobs import JobMessage


def complete_drive(session: Session, drive_id: str) -> list[JobMessage]:
    """Have the map stitched with the drive's submaps; a drive that does not pass waits outside, and the map never for it."""
    drive = gate.lock(session, drive_id)
    if not gate.passes(drive):
        again = gate.leave_out(session, drive)
        return [] if again is None else [again]
    if not maps.has_submaps(session, drive_id):
        drive.state, drive.finished_at = "done", now_s(session)
        return []
    job = jobs.request_stitch(session, drive.map_id)
    drive.state, drive.stitch_job_id = "stitching", job.id
    return [JobMessage(job.id, job.queue)]
