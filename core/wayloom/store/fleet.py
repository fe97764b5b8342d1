"""Facts on the fleet and on this service's work: vehicles, waiting and running jobs, the workers that hold them."""

from dataclasses import dataclass

from sqlalchemy import func, select

from wayloom.store.database import Session
from wayloom.store.tables.drives import Drive, Job, Vehicle


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
