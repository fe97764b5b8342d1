"""Repository of the gate before the map: verdicts on drives, and releases by operators.

A drive passes by its own grade or an operator's release. One that is held for its place alone is a guest: every stitch asks whether
its meetings place it (`wayloom.stitching.admission`), and `publish` writes the answer.

Locks are taken in one order everywhere, the map's row before the drive's: publishing does the same.
"""

from collections.abc import Sequence
from typing import Final

from sqlalchemy import select
from sqlalchemy.orm import Session

from wayloom.config.gate import GATES, Gate
from wayloom.errors import ConflictError
from wayloom.store import drives, maps
from wayloom.store.database import now_s
from wayloom.store.jobs import JobMessage, request_stitch
from wayloom.store.maps import mark_changed
from wayloom.store.tables.drives import Drive
from wayloom.store.tables.maps import Map

STATE_OUTSIDE: Final = {"merge": "done", "hold": "held", "quarantine": "quarantined"}
"""State of a finished drive that is not merged, by its gate."""


def judge(session: Session, drive_id: str, grade: str | None, reasons: Sequence[str], gate: Gate, sound: bool = False) -> None:
    """Write the verdict down. A release was for what the operator saw: it lapses when the new verdict is stricter.

    sound : at most the drive's place is in doubt
    """
    drive = lock(session, drive_id)
    before = passes(drive), is_guest(drive)
    stricter = drive.gate is not None and GATES.index(gate) > [*GATES].index(drive.gate)  # type: ignore[arg-type]
    loses_its_place = grade is None and drive.grade is not None
    if (stricter or loses_its_place) and drive.released_at is not None:
        reasons = [*reasons, f"the release by {drive.released_by} was for a better grade and has lapsed"]
        _forget_release(drive)
    drive.grade, drive.gate, drive.reasons, drive.sound = grade, gate, list(reasons), sound
    if (passes(drive), is_guest(drive)) != before:
        _forget_verdict(drive)
        mark_changed(session, drive_id)


def passes(drive: Drive) -> bool:
    """Whether the drive may be in the map. As `maps.PASSES` asks of the database."""
    return drive.gate == "merge" or drive.released_at is not None


def is_guest(drive: Drive) -> bool:
    """Whether its meetings with the map's drives may place it. As `maps.IS_GUEST` asks of the database."""
    return drive.gate == "hold" and bool(drive.sound) and drive.released_at is None


def is_in_map(drive: Drive) -> bool:
    """Whether the newest version has it, or the next one will. As `maps.IN_MAP` asks of the database."""
    return passes(drive) or (is_guest(drive) and drive.admitted)


def release(session: Session, drive_id: str, by: str, why: str) -> JobMessage | None:
    """Merge a held or quarantined drive all the same. Returns the map's job, None where the drive is still on its way.

    Raises ConflictError for a drive that needs no release, has no place on Earth, or is not judged yet.
    """
    drive = lock(session, drive_id)
    _check_can_be_released(drive)
    drive.released_at, drive.released_by, drive.released_why = now_s(session), by, why
    _forget_verdict(drive)
    mark_changed(session, drive_id)
    if drive.state not in (*STATE_OUTSIDE.values(), "stitching"):  # a guest is stitching while it is asked for its meetings
        return None
    return ask_map(session, drive)


def revoke(session: Session, drive_id: str) -> JobMessage | None:
    """Take a release back; where the map has the drive, or soon would, it is stitched without it. Returns the map's job.

    Raises ConflictError for a drive that was not released.
    """
    drive = lock(session, drive_id)
    if drive.released_at is None:
        raise ConflictError(f"drive {drive_id[:12]} was not released")
    _forget_release(drive)
    mark_changed(session, drive_id)
    if drive.stitch_job_id is None:
        return None
    return ask_map(session, drive) if is_guest(drive) else leave_out(session, drive)


def ask_map(session: Session, drive: Drive) -> JobMessage:
    """A finished drive goes to the map, which takes it in or, where it is a guest, says whether it does. Returns the map's job."""
    job = request_stitch(session, drive.map_id)
    drive.state, drive.stitch_job_id, drive.error, drive.finished_at = "stitching", job.id, None, None
    return JobMessage(job.id, job.queue)


def leave_out(session: Session, drive: Drive) -> JobMessage | None:
    """A finished drive that does not pass stays outside; where it was given to the map before, the map is stitched without it."""
    drive.state, drive.finished_at, drive.error = STATE_OUTSIDE[drive.gate or "hold"], now_s(session), None
    if drive.stitch_job_id is None and not maps.holds(session, drive.map_id, drive.id):
        return None
    drive.stitch_job_id = None
    job = request_stitch(session, drive.map_id)
    return JobMessage(job.id, job.queue)


def lock(session: Session, drive_id: str) -> Drive:
    """The drive as the database has it, and nobody else may change it, nor its map's jobs, until this transaction ends."""
    map_id = drives.get(session, drive_id).map_id
    session.execute(select(Map.id).where(Map.id == map_id).with_for_update())
    return session.get_one(Drive, drive_id, with_for_update=True, populate_existing=True)


def _check_can_be_released(drive: Drive) -> None:
    name = f"drive {drive.id[:12]}"
    if drive.state == "removing":
        raise ConflictError(f"{name} is being removed")
    if drive.placed is False:
        raise ConflictError(f"{name} has no place on Earth: there is nothing to release; send it again with GNSS")
    if drive.gate is None:
        raise ConflictError(f"{name} is not judged yet: wait for its geo-reference")
    if drive.gate == "merge":
        raise ConflictError(f"{name} has grade {drive.grade} and needs no release")
    if drive.released_at is not None:
        raise ConflictError(f"{name} was released by {drive.released_by} already")


def _forget_verdict(drive: Drive) -> None:
    drive.admitted, drive.map_verdict = False, None


def _forget_release(drive: Drive) -> None:
    drive.released_at = drive.released_by = drive.released_why = None
