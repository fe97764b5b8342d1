"""Job rows: created, claimed, kept alive, finished and recovered, each by one guarded transaction.

A job is claimed by compare-and-set. The claim carries a fencing token that grows with every claim; whatever a worker writes later
is guarded by that token, so a worker that was thought dead and comes back can do no harm, and a message delivered twice finds
nothing to do.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import CursorResult, delete, func, select, update
from sqlalchemy.orm import Session

from wayloom.config.stages import REMOVAL, drive_stages, find_stage, map_stages
from wayloom.errors import ConflictError, LeaseLostError
from wayloom.store import coming
from wayloom.store.database import Database, now_s
from wayloom.store.etas.told import note_estimate, settle
from wayloom.store.history import note_event, thin
from wayloom.store.images import check_kept
from wayloom.store.tables.drives import Drive, DriveRun, Job
from wayloom.store.tables.maps import Map

ERROR_LENGTH = 4000
CANCELLED = "cancelled"
CLOCK_SLACK_S = 1.0
"""A time by which a row is ahead of the clock does not mean that the clock went back: others write while this is read."""
ANEW = "anew"
"""Of a job's payload: its output is made even where there is one."""


@dataclass(frozen=True, slots=True)
class Claim:
    """The right to run a job, as long as `token` is the row's token. part : 0, or the number of the stage's part that it is."""

    job_id: int
    token: int
    stage: str
    attempt: int
    drive_id: str | None
    map_id: str | None
    payload: dict[str, Any]
    part: int = 0


@dataclass(frozen=True, slots=True)
class JobMessage:
    """The message that a job waits in a queue."""

    job_id: int
    queue: str


def create_drive_jobs(session: Session, drive_id: str) -> JobMessage:
    """One row for every stage of the drive; the first is queued, the others wait for the one before."""
    now = now_s(session)
    jobs = [new_job(stage, now, drive_id=drive_id, position=i, state="waiting") for i, stage in enumerate(drive_stages())]
    jobs[0].state = "queued"
    session.add_all(jobs)
    session.flush()
    return JobMessage(jobs[0].id, jobs[0].queue)


def create_map_job(
    session: Session, stage: str, map_id: str, payload: dict[str, Any] | None = None, parent_id: int | None = None
) -> Job:
    """A queued job of a map."""
    job = new_job(
        stage, now_s(session), map_id=map_id, payload=payload or {}, parent_id=parent_id, position=map_stages().index(stage)
    )
    session.add(job)
    session.flush()
    return job


def request_stitch(session: Session, map_id: str) -> Job:
    """The stitch job that will see what this transaction commits: one that nobody has claimed yet, or a new one. Locks the map."""
    session.execute(select(Map.id).where(Map.id == map_id).with_for_update())
    waiting = select(Job).where(Job.map_id == map_id, Job.stage == "stitch", Job.state == "queued", Job.token == 0, Job.part == 0)
    return session.scalars(waiting.order_by(Job.id)).first() or create_map_job(session, "stitch", map_id)


def create_removal_job(session: Session, drive_id: str) -> JobMessage:
    """A queued job that removes a drive; its rows go with the drive."""
    job = new_job(REMOVAL.name, now_s(session), drive_id=drive_id, position=0)
    session.add(job)
    session.flush()
    return JobMessage(job.id, job.queue)


def claim(database: Database, job_id: int, worker: str, lease_s: float) -> Claim | None:
    """Take a queued job, or None where it is not to be had: taken, finished, gone, to be tried later, or its map is worked on."""
    with database.write() as session:
        job = session.get(Job, job_id)
        now = now_s(session)
        if job is None or job.state != "queued" or not _is_ripe(job, now) or _map_is_busy(session, job):
            return None
        taken = _update(
            session,
            update(Job).where(Job.id == job_id, Job.state == "queued", Job.token == job.token),
            state="running", token=job.token + 1, attempt=job.attempt + 1, worker=worker, lease_until=now + lease_s,
            heartbeat_at=now, started_at=now, finished_at=None, progress=0.0, message="",
        )  # fmt: skip
        if not taken:
            return None
        if job.drive_id is not None and job.stage in drive_stages():
            _update(session, update(Drive).where(Drive.id == job.drive_id, Drive.state == "queued"), state="running")
        note_event(session, job.drive_id, job.stage, "begun", part=job.part, attempt=job.attempt + 1, worker=worker)
        if job.drive_id is not None and job.stage in drive_stages() and not job.part:
            note_estimate(session, job.drive_id, job.stage)
        return Claim(job.id, job.token + 1, job.stage, job.attempt + 1, job.drive_id, job.map_id, dict(job.payload), job.part)


def heartbeat(database: Database, held: Claim, lease_s: float, progress: float, message: str) -> None:
    """Prolong the lease and say how far the work is. Raises LeaseLostError."""
    with database.write() as session:
        now = now_s(session)
        values = {"lease_until": now + lease_s, "heartbeat_at": now, "progress": progress, "message": message}
        if not _update(session, _held(held), **values):
            raise LeaseLostError(f"job {held.job_id} ({held.stage}): another worker has taken it over, or its drive is gone")


def finish(session: Session, held: Claim, key: str) -> JobMessage | None:
    """Mark the job done, its output being `key`, and queue the drive's next stage, which is returned; after a part of a stage
    nothing (`part_jobs.after_part`). Raises LeaseLostError."""
    values: dict[str, Any] = {"state": "done", "finished_at": now_s(session), "progress": 1.0, "message": "", "error": None}
    values |= {"worker": None, "lease_until": None, "payload": {**held.payload, "key": key}, "not_before": None}
    values["payload"].pop(ANEW, None)
    if not _update(session, _held(held), **values):
        raise LeaseLostError(f"job {held.job_id} ({held.stage}): finished too late, another worker has taken it over")
    _note(session, held, "done")
    if held.drive_id is None or held.part:
        return None
    following = select(Job).where(Job.drive_id == held.drive_id, Job.state == "waiting").order_by(Job.position)
    job = session.scalars(following).first()
    if job is None:
        return None
    job.state, job.sent_at = "queued", None
    return JobMessage(job.id, job.queue)


def fail(session: Session, held: Claim, error: str, *, final: bool, pause_s: float = 0.0) -> None:
    """Write the error down; queue the job once more, to be tried after a pause, or, when `final`, fail it and what depends on it.

    Raises LeaseLostError.
    """
    values: dict[str, Any] = {"worker": None, "lease_until": None, "error": _text(error), "sent_at": None}
    now = now_s(session)
    values |= (
        {"state": "failed", "finished_at": now} if final else {"state": "queued", "not_before": now + pause_s, "heartbeat_at": now}
    )
    if not _update(session, _held(held), **values):
        raise LeaseLostError(f"job {held.job_id} ({held.stage}): failed too late, another worker has taken it over")
    _note(session, held, "failed" if final else "again", error)
    if final:
        _fail_dependants(session, session.get_one(Job, held.job_id), error)


def release(session: Session, held: Claim) -> None:
    """Put the job back untouched because the worker is told to stop; the attempt does not count. Raises LeaseLostError."""
    put_back(session, held, "queued", held.attempt - 1)
    _note(session, held, "back")


def pause(session: Session, held: Claim, why: str, pause_s: float, what: str = "waits") -> None:
    """Put the job back for a while, for a reason that is not the stage's; the attempt does not count. Raises LeaseLostError.

    what : as the drive's history calls it
    """
    _note(session, held, what, why)
    put_back(session, held, "queued", held.attempt - 1)
    job = session.get_one(Job, held.job_id)
    job.heartbeat_at = now_s(session)
    job.error, job.message, job.not_before = _text(why), _text(why), job.heartbeat_at + pause_s


def lose(session: Session, held: Claim, evidence: dict[str, Any], pause_s: float) -> None:
    """The job's worker is gone through no known fault: the attempt does not count, the loss is kept. Raises LeaseLostError."""
    losses = [*session.get_one(Job, held.job_id).losses, evidence]
    pause(session, held, str(evidence["why"]), pause_s, "lost")
    session.get_one(Job, held.job_id).losses = losses


def cancel(session: Session, drive_id: str) -> None:
    """Stop the drive's stages: the one that is queued or runs fails, its worker loses the lease. `retry` goes on with it.

    Of a drive that is processed anew the result before stays. Raises ConflictError where no stage is on its way.
    """
    drive = session.get_one(Drive, drive_id, with_for_update=True)
    found = session.scalars(select(Job).where(Job.drive_id == drive_id, Job.state.in_(("queued", "running")))).all()
    stages = [job for job in found if job.stage in drive_stages()]
    if not stages:
        raise ConflictError(f"drive {drive_id[:12]} has no stage to cancel: it is {drive.state}")
    now = now_s(session)
    values = {"state": "failed", "error": CANCELLED, "worker": None, "lease_until": None, "finished_at": now, "message": ""}
    _update(session, update(Job).where(Job.id.in_([job.id for job in stages]), Job.state.in_(("queued", "running"))), **values)
    for job in stages:
        note_event(session, drive_id, job.stage, CANCELLED, part=job.part, attempt=job.attempt)
    thin(session, drive_id)
    coming.fail(drive, f"{stages[0].stage}: {CANCELLED}", now)
    settle(session, Drive.id == drive_id)


def put_back(session: Session, held: Claim, state: str, attempt: int) -> None:
    """Let go of the job in this state, with so many attempts counted. Raises LeaseLostError."""
    values = {"state": state, "attempt": attempt, "worker": None, "lease_until": None, "sent_at": None, "message": ""}
    if not _update(session, _held(held), **values):
        raise LeaseLostError(f"job {held.job_id} ({held.stage}): another worker has taken it over")


def input_keys(session: Session, drive_id: str, stage: str) -> dict[str, str]:
    """For each stage whose result `stage` reads, the key of its output. Raises ConflictError where one is not done."""
    read = find_stage(stage).results_read
    rows = session.scalars(
        select(Job).where(Job.drive_id == drive_id, Job.stage.in_(read), Job.state == "done", Job.part == 0)
    ).all()
    keys = {job.stage: str(job.payload["key"]) for job in rows}
    if len(keys) < len(read):
        raise ConflictError(f"{stage} was started before {', '.join(name for name in read if name not in keys)}")
    return {name: keys[name] for name in read}


def keys_of_outputs(session: Session, drive_id: str, stages: Sequence[str]) -> dict[str, str]:
    """For each of the stages, the key of its output in the run whose submaps the map has: of a drive that is processed anew, that
    of the run before. A drive without a kept run has the outputs of its jobs that are done."""
    run = session.scalars(select(DriveRun).where(DriveRun.drive_id == drive_id).order_by(DriveRun.number.desc()).limit(1)).first()
    if run is not None:
        return {stage: str(run.stages[stage]["key"]) for stage in stages if stage in run.stages}
    return keys_of_jobs(session, drive_id, stages)


def keys_of_jobs(session: Session, drive_id: str, stages: Sequence[str]) -> dict[str, str]:
    """For each of the stages whose job is done, the key of its output."""
    rows = session.scalars(select(Job).where(Job.drive_id == drive_id, Job.stage.in_(stages), Job.state == "done", Job.part == 0))
    return {job.stage: str(job.payload["key"]) for job in rows}


def retry(session: Session, drive_id: str, stage: str | None = None) -> list[JobMessage]:
    """Fresh attempts for the failed stages of a drive, or the map job that it waits for.

    stage : begin with this one, which is made anew, as are those after it, whatever they left
    Raises ConflictError where none failed, none of the drive's own that comes after `stage`, or the images that it needs are gone.
    """
    drive = session.get_one(Drive, drive_id)
    of_drive = (Job.drive_id == drive_id) | (Job.id == (drive.stitch_job_id or 0)) | (Job.parent_id == (drive.stitch_job_id or 0))
    jobs = session.scalars(select(Job).where(of_drive, Job.state == "failed")).all()
    if not jobs:
        raise ConflictError(f"drive {drive_id[:12]} has no failed stage")
    if any(job.drive_id is not None for job in jobs):
        check_kept(drive)
    if stage is not None:
        return [_begin_with(session, drive, stage, jobs)]
    for job in jobs:
        note_event(session, job.drive_id, job.stage, "asked", part=job.part)
        _refresh(job, "queued")
        if job.map_id is not None:
            waiting = update(Drive).where(Drive.stitch_job_id == (job.parent_id or job.id), Drive.state == "failed")
            _update(session, waiting, state="stitching", error=None, finished_at=None)
        else:
            coming.resume(drive)
    return [JobMessage(job.id, job.queue) for job in jobs]


def _begin_with(session: Session, drive: Drive, stage: str, failed: Sequence[Job]) -> JobMessage:
    position = drive_stages().index(stage) if stage in drive_stages() else -1
    if position < 0 or any(job.map_id is not None for job in failed) or position > min(job.position for job in failed):
        names = ", ".join(drive_stages())
        raise ConflictError(f"{stage!r} is no stage of the drive up to the one that failed ({failed[0].stage}); stages are {names}")
    later = Job.drive_id == drive.id, Job.position >= position
    session.execute(delete(Job).where(*later, Job.part > 0))
    rows = session.scalars(select(Job).where(*later, Job.stage.in_(drive_stages())).order_by(Job.position)).all()
    for job in rows:
        _refresh(job, "waiting")
        job.payload, job.progress = {ANEW: True}, 0.0
    rows[0].state = "queued"
    note_event(session, drive.id, stage, "asked", text="this stage and those after it are made anew")
    coming.resume(drive)
    return JobMessage(rows[0].id, rows[0].queue)


def _refresh(job: Job, state: str) -> None:
    """As a new row."""
    job.state, job.attempt, job.losses, job.error, job.message = state, 0, [], None, ""
    job.sent_at, job.finished_at, job.not_before = None, None, None


def _note(session: Session, held: Claim, what: str, text: str = "") -> None:
    """Into the drive's history, which stays short."""
    note_event(session, held.drive_id, held.stage, what, part=held.part, attempt=held.attempt, text=_text(text))
    thin(session, held.drive_id)


def mark_sent(database: Database, messages: Iterable[JobMessage]) -> None:
    """Remember that the jobs' messages went out."""
    ids = [message.job_id for message in messages]
    if ids:
        with database.write() as session:
            _update(session, update(Job).where(Job.id.in_(ids)), sent_at=now_s(session))


def _text(error: str) -> str:
    """As much of the error as is kept, in characters that every database takes."""
    return error.replace("\0", "").encode("utf-8", "replace").decode()[:ERROR_LENGTH]


def new_job(stage: str, now: float, *, state: str = "queued", **values: Any) -> Job:
    """A row that is not yet in the database."""
    return Job(stage=stage, queue=find_stage(stage).queue, state=state, created_at=now, **values)


def _held(held: Claim) -> Any:
    return update(Job).where(Job.id == held.job_id, Job.token == held.token, Job.state == "running")


def _update(session: Session, statement: Any, **values: Any) -> bool:
    """Run an UPDATE and tell whether it met a row."""
    result = session.execute(statement.values(**values), execution_options={"synchronize_session": False})
    return isinstance(result, CursorResult) and result.rowcount > 0


def _is_ripe(job: Job, now: float) -> bool:
    """Whether the job may be tried: its pause is over, or the clock went back to before the pause began, which then cannot be
    measured. So no job waits for longer than its pause from now, wherever the clock goes; `sweep.unsent` asks the same in SQL."""
    return job.not_before is None or job.not_before <= now or (job.heartbeat_at or 0.0) > now + CLOCK_SLACK_S


def _map_is_busy(session: Session, job: Job) -> bool:
    """One job of a map at a time, but for the parts of one stage, and what was stitched is published before the next stitch.
    Locks the map's row."""
    if job.map_id is None:
        return False
    session.execute(select(Map.id).where(Map.id == job.map_id).with_for_update())
    others = select(Job.id).where(Job.map_id == job.map_id, Job.id != job.id)
    if job.part:
        others = others.where(Job.id != job.parent_id, (Job.part == 0) | (Job.parent_id != job.parent_id))
    busy = others.where((Job.state == "running") | ((Job.state == "waiting") & (Job.part == 0)))
    unpublished = others.where(Job.stage == "publish", Job.state == "queued")
    return bool(session.scalars(busy).first()) or (job.stage == "stitch" and bool(session.scalars(unpublished).first()))


def is_map_at_work(session: Session, map_id: str) -> bool:
    """Whether a job of the map is to run, or the last one has failed and may be tried again."""
    states = session.execute(select(Job.id, Job.state).where(Job.map_id == map_id, Job.state != "done").order_by(Job.id)).all()
    last = session.scalar(select(func.max(Job.id)).where(Job.map_id == map_id))
    return any(state != "failed" or job_id == last for job_id, state in states)


def _fail_dependants(session: Session, job: Job, error: str) -> None:
    """A failed stage fails its drive; a failed map job fails the drives that wait for it."""
    values: dict[str, Any] = {
        "state": "failed",
        "error": _text(f"{job.stage}{f', part {job.part}' if job.part else ''}: {error}"),
        "finished_at": now_s(session),
    }
    if job.drive_id is not None:
        coming.fail(session.get_one(Drive, job.drive_id), values["error"], values["finished_at"])
    else:
        if job.part:
            _update(session, update(Job).where(Job.id == job.parent_id, Job.state == "waiting"), **values)
        waiting = update(Drive).where(Drive.stitch_job_id == (job.parent_id or job.id), Drive.state == "stitching")
        for drive_id in session.scalars(waiting.values(values).returning(Drive.id)).all():
            note_event(session, drive_id, job.stage, "failed", part=job.part, attempt=job.attempt, text=error)
    settle(session, Drive.id == job.drive_id if job.drive_id is not None else Drive.map_id == job.map_id)
