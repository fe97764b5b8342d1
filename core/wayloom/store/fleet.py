"""Facts on the fleet and on this service's work: vehicles, waiting and running jobs, the workers that hold them."""

from collections.abc import Sequence
from dataclasses import dataclass

from sqlalchemy import func, select, true

from wayloom.store.database import Session
from wayloom.store.tables.drives import Drive, Job, Vehicle
from wayloom.store.tables.maps import MapVersion


@dataclass(frozen=True, slots=True)
class VehicleFacts:
    """A vehicle: since when it is known, its drives by state, when the last one was announced (s since 1970), and its bytes."""

    id: str
    created_at: float
    drives: dict[str, int]
    last_at: float | None
    bytes: int


@dataclass(frozen=True, slots=True)
class Held:
    """A job that a worker holds. progress : 0 to 1. drive : its id and name, of a map's job none."""

    worker: str
    stage: str
    part: int
    drive_id: str | None
    drive_name: str | None
    progress: float
    message: str
    attempt: int
    started_at: float | None
    heartbeat_at: float | None


@dataclass(frozen=True, slots=True)
class MapJob:
    """A job of a map, a stitch or a publish. Its rows are never thinned, so they are the map's history.

    parts    into how many it was cut
    version  what it published, as long as that version has a row
    """

    id: int
    stage: str
    state: str
    parts: int
    attempt: int
    losses: int
    asked_at: float
    started_at: float | None
    finished_at: float | None
    version: int | None
    message: str
    error: str | None


def vehicles(session: Session) -> list[VehicleFacts]:
    """All vehicles, by name."""
    counted = select(Drive.vehicle_id, Drive.state, func.count(), func.max(Drive.created_at), func.sum(Drive.byte_count))
    found = {row.id: VehicleFacts(row.id, row.created_at, {}, None, 0) for row in session.scalars(select(Vehicle))}
    query = counted.where(Drive.vehicle_id.is_not(None)).group_by(Drive.vehicle_id, Drive.state)
    for vehicle, state, number, last, size in session.execute(query):
        if vehicle is None:
            continue
        known = found[vehicle]
        at = max(last, known.last_at or 0.0)
        found[vehicle] = VehicleFacts(vehicle, known.created_at, {**known.drives, state: number}, at, known.bytes + int(size or 0))
    return [found[name] for name in sorted(found)]


def queues(session: Session) -> dict[str, dict[str, int]]:
    """For each queue how many jobs are queued and how many run; those that wait for another stage are in none."""
    found: dict[str, dict[str, int]] = {}
    query = select(Job.queue, Job.state, func.count()).where(Job.state.in_(("queued", "running"))).group_by(Job.queue, Job.state)
    for queue, state, number in session.execute(query):
        found.setdefault(queue, {})[state] = number
    return found


def held_jobs(session: Session) -> list[Held]:
    """The jobs that run, the longest first."""
    query = select(Job, Drive.name).outerjoin(Drive, Drive.id == Job.drive_id).where(Job.state == "running")
    return [
        Held(
            job.worker or "", job.stage, job.part, job.drive_id, name, job.progress, job.message, job.attempt, job.started_at,
            job.heartbeat_at,
        )
        for job, name in session.execute(query.order_by(Job.started_at))
    ]  # fmt: skip


def map_jobs(session: Session, map_id: str, limit: int, before: int | None = None) -> Sequence[MapJob]:
    """The map's jobs, newest first. before : ids below this one alone"""
    query = select(Job).where(Job.map_id == map_id, Job.part == 0)
    if before is not None:
        query = query.where(Job.id < before)
    rows = session.scalars(query.order_by(Job.id.desc()).limit(limit)).all()
    counted = select(Job.parent_id, func.count()).where(Job.parent_id.in_([job.id for job in rows]), Job.part > 0)
    parts = dict(session.execute(counted.group_by(Job.parent_id)).tuples().all())
    return [
        MapJob(
            job.id, job.stage, job.state, parts.get(job.id, 0), job.attempt, len(job.losses), job.created_at, job.started_at,
            job.finished_at, _published(session, job), job.message, job.error,
        )
        for job in rows
    ]  # fmt: skip


def _published(session: Session, job: Job) -> int | None:
    """A map's jobs run one at a time, so the version that came after this one began, and before another did, is its own."""
    if job.stage != "publish" or job.state != "done":
        return None
    later = select(func.min(Job.started_at)).where(Job.map_id == job.map_id, Job.started_at > job.started_at).scalar_subquery()
    came = MapVersion.created_at >= job.started_at, func.coalesce(MapVersion.created_at < later, true())
    return session.scalar(select(func.min(MapVersion.version)).where(MapVersion.map_id == job.map_id, *came))
