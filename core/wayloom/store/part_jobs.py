"""Jobs of a stage that is made in parts: a row for each part, for which the stage's own row waits."""

from collections.abc import Sequence

from sqlalchemy import Select, select
from sqlalchemy.orm import Session

from wayloom.errors import StageError
from wayloom.store.database import now_s
from wayloom.store.jobs import Claim, JobMessage, new_job, put_back
from wayloom.store.tables.drives import Job


def await_parts(session: Session, held: Claim, parts: Sequence[int], key: str, max_attempts: int) -> list[JobMessage]:
    """Queue these parts (numbers from 1) of the held job's stage, which waits for them. Its attempt does not count.

    key : of the stage; who takes a part makes it for that key
    Raises LeaseLostError; StageError where parts that were made are not found again and again.
    """
    rows = {job.part: job for job in session.scalars(_parts_of(held))}
    again = any(part in rows and rows[part].state == "done" for part in parts)
    if again and held.attempt >= max_attempts:
        raise StageError(
            f"parts of {held.stage} were made {held.attempt} times, but are not there: is the data folder shared by all?"
        )
    put_back(session, held, "waiting", held.attempt if again else held.attempt - 1)
    position = session.get_one(Job, held.job_id).position
    now = now_s(session)
    for part in parts:
        if part not in rows:
            rows[part] = new_job(
                held.stage, now, drive_id=held.drive_id, map_id=held.map_id, parent_id=held.job_id, position=position, part=part
            )
            session.add(rows[part])
        row = rows[part]
        row.state, row.attempt, row.error, row.sent_at, row.finished_at = "queued", 0, None, None, None
        row.progress, row.payload = 0.0, {"key": key}
    for part in rows.keys() - set(parts):
        rows[part].state = "done"
    session.flush()
    return [JobMessage(rows[part].id, rows[part].queue) for part in parts]


def after_part(session: Session, held: Claim) -> JobMessage | None:
    """The stage's own job, queued now if the part that `held` was, and that is done, was the last one. Locks the stage's row, so
    that of parts that end together one sees the other's end."""
    parent = select(Job.parent_id).where(Job.id == held.job_id).scalar_subquery()
    job = session.scalars(select(Job).where(Job.id == parent).with_for_update()).first()
    undone = select(Job.id).where(Job.parent_id == parent, Job.stage == held.stage, Job.part > 0, Job.state != "done")
    if job is None or job.state != "waiting" or session.scalars(undone.limit(1)).first() is not None:
        return None
    job.state, job.sent_at = "queued", None
    return JobMessage(job.id, job.queue)


def _parts_of(held: Claim) -> Select[Job]:
    return select(Job).where(Job.parent_id == held.job_id, Job.stage == held.stage, Job.part > 0)
