"""History of a drive: short, however long its jobs wait."""

import pytest
from sqlalchemy import update

from store.test_jobs import new_drive, take
from wayloom.store import jobs
from wayloom.store.database import Database
from wayloom.store.history import MOST, note_event, of_drive
from wayloom.store.tables.drives import Job


def told(database: Database, drive_id: str) -> list[tuple[str, int, str]]:
    """What, attempt and text, oldest first."""
    with database.read() as session:
        return [(row.what, row.attempt, row.text) for row in reversed(of_drive(session, drive_id, 10_000))]


def wait(database: Database, job_id: int, why: str) -> None:
    """The job begins, and pauses for a reason of the machine."""
    held = take(database, job_id)
    with database.write() as session:
        jobs.pause(session, held, why, 20.0)
        session.execute(update(Job).where(Job.id == job_id).values(not_before=None))


def test_a_job_that_waits_for_long_tells_so_once_for_each_reason(database: Database) -> None:
    drive_id, job_id = new_drive(database)
    for why in ("the disk is full", "the disk is full", "the disk is full", "the database is away", "the database is away"):
        wait(database, job_id, why)
    begun = ("begun", 1, "")
    waits = [begun, ("waits", 1, "the disk is full"), begun, ("waits", 1, "the database is away")]
    assert told(database, drive_id) == waits
    held = take(database, job_id)
    with database.write() as session:
        jobs.finish(session, held, "key")
    assert told(database, drive_id) == [*waits, begun, ("done", 1, "")]


def test_what_is_said_of_one_stage_is_no_repetition_of_another(database: Database) -> None:
    drive_id, _ = new_drive(database)
    with database.write() as session:
        for part in (1, 2, 1, 2):
            note_event(session, drive_id, "odometry", "begun", part=part, attempt=1)
            note_event(session, drive_id, "odometry", "waits", part=part, attempt=1, text="no room")
    with database.read() as session:
        assert [(row.part, row.what) for row in reversed(of_drive(session, drive_id, 10))] == [
            (1, "begun"), (1, "waits"), (2, "begun"), (2, "waits"),
        ]  # fmt: skip


def test_failures_that_are_alike_are_all_told(database: Database) -> None:
    drive_id, job_id = new_drive(database)
    for _ in range(2):
        held = take(database, job_id)
        with database.write() as session:
            jobs.fail(session, held, "no luck", final=False)
    assert [what for what, _, _ in told(database, drive_id)] == ["begun", "again"] * 2


@pytest.mark.parametrize("end", ["pause", "fail", "cancel", "release"])
def test_whatever_ends_an_attempt_thins_the_history(database: Database, end: str) -> None:
    drive_id, job_id = new_drive(database)
    held = take(database, job_id)
    with database.write() as session:
        for attempt in range(MOST):
            note_event(session, drive_id, "odometry", "begun", attempt=attempt)
    with database.write() as session:
        if end == "pause":
            jobs.pause(session, held, "no room", 1.0)
        elif end == "fail":
            jobs.fail(session, held, "no luck", final=True)
        elif end == "cancel":
            jobs.cancel(session, drive_id)
        else:
            jobs.release(session, held)
    assert len(told(database, drive_id)) == MOST
