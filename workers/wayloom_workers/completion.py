"""Completion of a drive: after its last stage it goes into the map, asks for it as a guest, or ends outside of it."""

from wayloom.store import gate, jobs, maps, reprocessing
from wayloom.store.database import Session, now_s
from wayloom.store.etas.told import settle
from wayloom.store.jobs import JobMessage
from wayloom.store.tables.drives import Drive


def complete_drive(session: Session, drive_id: str) -> list[JobMessage]:
    """Have the map stitched with the drive's submaps, or, for a guest, asked for them; the map waits for no other drive."""
    drive = gate.lock(session, drive_id)
    message = _next_version(session, drive)
    reprocessing.await_version(drive, None if message is None else message.job_id)
    settle(session, Drive.id == drive_id)
    return [] if message is None else [message]


def _next_version(session: Session, drive: Drive) -> JobMessage | None:
    """The map's job that takes in, or leaves out, what the drive has now; None where the map stays as it is."""
    has_submaps = maps.has_submaps(session, drive.id)
    if has_submaps and (gate.passes(drive) or gate.is_guest(drive)):
        return gate.ask_map(session, drive)
    if not gate.passes(drive):
        return gate.leave_out(session, drive)
    had_a_place = drive.stitch_job_id is not None
    drive.state, drive.finished_at, drive.stitch_job_id = "done", now_s(session), None
    if not had_a_place:
        return None
    job = jobs.request_stitch(session, drive.map_id)
    return JobMessage(job.id, job.queue)
