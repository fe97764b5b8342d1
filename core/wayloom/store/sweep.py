"""Recovery of jobs whose worker has died, and of those of which no worker knows. Any number of sweepers may run at once."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from sqlalchemy import or_, select
from sqlalchemy.orm import Session

from wayloom.config.backoff import Backoff
from wayloom.errors import LeaseLostError
from wayloom.store.database import Database, now_s
from wayloom.store.jobs import CLOCK_SLACK_S, Claim, JobMessage, fail, lose, release
from wayloom.store.processes import is_dead, name_of
from wayloom.store.tables.drives import Job

AT_ONCE: Final = Backoff(0.0, 0.0)
TOLD: Final = 5
"""Losses that a failed job tells of."""
STOPPING: Final = "told to stop"
"""Message of a running job whose worker is told to stop: when it dies now, that is nobody's fault."""


@dataclass(frozen=True, slots=True)
class _Lost:
    """A job without a worker: why; whether that one was told to stop; those that were lost before; what is known of this one."""

    held: Claim
    why: str
    was_stopping: bool
    losses: list[dict[str, Any]]
    evidence: dict[str, Any]


def requeue_lost(
    database: Database,
    max_attempts: int,
    max_losses: int = 20,
    backoff: Backoff = AT_ONCE,
    crash_of: Callable[[Claim], str] = lambda _: "",
) -> int:
    """Take back every running job whose lease ran out or whose process is gone. Returns how many.

    crash_of : what the job's process left of a crash of its own; empty where nothing says that the stage was to blame

    A crash is a failed attempt, after `max_attempts` the last. Any other loss uses up no attempt, but is written down: a job that
    has lost `max_losses` workers is quarantined, which means that it fails with what is known of them.
    """
    with database.read() as session:
        lost = _lost(session)
    for job in lost:
        try:
            with database.write() as session:
                _take_back(session, job, max_attempts, max_losses, backoff, crash_of(job.held))
        except LeaseLostError:
            continue  # another sweeper was faster, or the worker has just finished
    return len(lost)


def _take_back(session: Session, job: _Lost, max_attempts: int, max_losses: int, backoff: Backoff, crash: str) -> None:
    held = job.held
    if crash:
        why = f"{job.why} by a crash of the stage (attempt {held.attempt} of {max_attempts}): {crash}"
        is_last = held.attempt >= max_attempts
        fail(session, held, f"quarantined: {why}" if is_last else why, final=is_last, pause_s=backoff.pause_s(held.attempt))
        return
    if job.was_stopping:
        release(session, held)
        return
    losses = [*job.losses, job.evidence]
    if len(losses) >= max_losses:
        told = "; ".join(f"{one['worker']} at {one['progress']:.0%} {one['message']}".strip() for one in losses[-TOLD:])
        fail(session, held, f"quarantined: {len(losses)} workers were lost over it, the last ones {told}", final=True)
        return
    evidence = {**job.evidence, "why": f"{job.why} ({len(losses)} of {max_losses})"}
    lose(session, held, evidence, backoff.pause_s(len(job.losses)) if job.losses else 0.0)


def unsent(database: Database, resend_s: float, limit: int = 500) -> list[JobMessage]:
    """Queued jobs whose message never went out, or went out `resend_s` ago and woke nobody; oldest first."""
    with database.read() as session:
        now = now_s(session)
        # A time to come, of a heartbeat or of a message, is of a clock that has gone back since.
        ripe = or_(Job.not_before.is_(None), Job.not_before <= now, Job.heartbeat_at > now + CLOCK_SLACK_S)
        due = or_(Job.sent_at.is_(None), Job.sent_at < now - resend_s, Job.sent_at > now + CLOCK_SLACK_S)
        queued = select(Job.id, Job.queue).where(Job.state == "queued", due, ripe)
        return [JobMessage(job_id, queue) for job_id, queue in session.execute(queued.order_by(Job.id).limit(limit))]


def open_jobs(database: Database) -> list[JobMessage]:
    """Every job that is queued or runs."""
    with database.read() as session:
        found = select(Job.id, Job.queue).where(Job.state.in_(("queued", "running"))).order_by(Job.id)
        return [JobMessage(job_id, queue) for job_id, queue in session.execute(found)]


def _lost(session: Session) -> list[_Lost]:
    now = now_s(session)
    lost = []
    for job in session.scalars(select(Job).where(Job.state == "running")):
        if job.worker is not None and is_dead(job.worker):
            why = "the worker's process died"
        elif job.lease_until is not None and job.lease_until < now:
            why = f"the worker gave no sign of life for {now - (job.heartbeat_at or now):.0f} s"
        else:
            continue
        held = Claim(job.id, job.token, job.stage, job.attempt, job.drive_id, job.map_id, {})
        evidence = {"at": now, "worker": name_of(job.worker or ""), "progress": job.progress, "message": job.message, "why": why}
        lost.append(_Lost(held, why, job.message == STOPPING, [*job.losses], evidence))
    return lost
