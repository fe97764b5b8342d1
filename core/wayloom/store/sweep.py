"""Recovery of jobs whose worker has died, and of those of which no worker knows. Any number of sweepers may run at once."""

from sqlalchemy import or_, select
from sqlalchemy.orm import Session

from wayloom.errors import LeaseLostError
from wayloom.store.database import Database, now_s
from wayloom.store.jobs import Claim, JobMessage, fail
from wayloom.store.processes import is_dead
from wayloom.store.tables import Job


def requeue_lost(database: Database, max_attempts: int) -> int:
    """Queue again (after `max_attempts`: fail) every running job whose lease ran out or whose process is gone. Returns how many."""
    with database.read() as session:
        lost = _lost(session)
    for held, why in lost:
        try:
            with database.write() as session:
                fail(session, held, f"{why} (attempt {held.attempt} of {max_attempts})", final=held.attempt >= max_attempts)
        except LeaseLostError:
            continue  # another sweeper was faster, or the worker has just finished
    return len(lost)


def unsent(database: Database, resend_s: float, limit: int = 500) -> list[JobMessage]:
    """Queued jobs whose message never went out, or went out `resend_s` ago and woke nobody; oldest first."""
    with database.read() as session:
        long_ago = now_s(session) - resend_s
        queued = select(Job.id, Job.queue).where(Job.state == "queued", or_(Job.sent_at.is_(None), Job.sent_at < long_ago))
        return [JobMessage(job_id, queue) for job_id, queue in session.execute(queued.order_by(Job.id).limit(limit))]


def _lost(session: Session) -> list[tuple[Claim, str]]:
    now = now_s(session)
    lost = []
    for job in session.scalars(select(Job).where(Job.state == "running")):
        held = Claim(job.id, job.token, job.stage, job.attempt, job.drive_id, job.map_id, {})
        if job.worker is not None and is_dead(job.worker):
            lost.append((held, "the worker's process died"))
        elif job.lease_until is not None and job.lease_until < now:
            lost.append((held, f"the worker gave no sign of life for {now - (job.heartbeat_at or now):.0f} s"))
    return lost
