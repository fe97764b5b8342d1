"""A stage in parts: its job waits, the last part queues it, and whatever else happens to jobs happens to parts too."""

import threading

import pytest
from test_jobs import done, drive, job, new_drive, take

from wayloom.errors import ConflictError, LeaseLostError, StageError
from wayloom.store import drives, jobs, part_jobs, sweep
from wayloom.store.database import Database
from wayloom.store.jobs import Claim, JobMessage
from wayloom.store.processes import identity


def odometry(database: Database) -> tuple[str, Claim]:
    """A drive whose odometry somebody has claimed."""
    drive_id, job_id = new_drive(database)
    following = done(database, take(database, job_id))
    assert following is not None
    return drive_id, take(database, following.job_id)


def split(database: Database, held: Claim, parts: list[int]) -> list[JobMessage]:
    with database.write() as session:
        return part_jobs.await_parts(session, held, parts, "key", 3)


def part_done(database: Database, held: Claim) -> JobMessage | None:
    with database.write() as session:
        jobs.finish(session, held, "key")
        return part_jobs.after_part(session, held)


def test_the_stage_is_queued_with_its_last_part_and_no_later_stage_before_it(database: Database) -> None:
    drive_id, held = odometry(database)
    messages = split(database, held, [1, 2, 3])
    assert [message.queue for message in messages] == ["odometry"] * 3
    assert (job(database, held.job_id).state, job(database, held.job_id).attempt) == ("waiting", 0)
    claims = [take(database, message.job_id) for message in messages]
    assert [(claim.stage, claim.part, claim.payload) for claim in claims] == [("odometry", n, {"key": "key"}) for n in (1, 2, 3)]
    assert [part_done(database, claims[n]) for n in (2, 0)] == [None, None]
    assert part_done(database, claims[1]) == JobMessage(held.job_id, "odometry")
    again = take(database, held.job_id)
    assert (again.attempt, again.part) == (1, 0)
    following = done(database, again)
    assert following is not None
    assert job(database, following.job_id).stage == "segmentation"
    with database.read() as session:
        assert jobs.input_keys(session, drive_id, "segmentation")["odometry"] == "key"


def test_of_parts_that_end_together_exactly_one_queues_the_stage(database: Database) -> None:
    _, held = odometry(database)
    claims = [take(database, message.job_id) for message in split(database, held, list(range(1, 9)))]
    barrier, found = threading.Barrier(len(claims)), []

    def end(claim: Claim) -> None:
        barrier.wait()
        found.append(part_done(database, claim))

    threads = [threading.Thread(target=end, args=(claim,)) for claim in claims]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [message for message in found if message is not None] == [JobMessage(held.job_id, "odometry")]


def test_a_part_whose_worker_died_is_queued_again_and_the_others_are_not(database: Database) -> None:
    _, held = odometry(database)
    first, second = split(database, held, [1, 2])
    part_done(database, take(database, first.job_id))
    dead = take(database, second.job_id, identity(999_999_999))
    assert sweep.requeue_lost(database, 3) == 1
    assert [message.job_id for message in sweep.unsent(database, 10.0)] == [second.job_id]
    alive = take(database, second.job_id)
    with pytest.raises(LeaseLostError):
        part_done(database, dead)
    assert part_done(database, alive) is not None


def test_a_part_that_fails_for_good_fails_the_drive_and_a_retry_goes_on_with_it(database: Database) -> None:
    drive_id, held = odometry(database)
    first, second = split(database, held, [1, 2])
    lost = take(database, first.job_id)
    with database.write() as session:
        jobs.fail(session, lost, "no luck", final=True)
    assert drive(database, drive_id).error == "odometry, part 1: no luck"
    assert part_done(database, take(database, second.job_id)) is None
    with database.write() as session:
        assert [message.job_id for message in jobs.retry(session, drive_id)] == [first.job_id]
    assert part_done(database, take(database, first.job_id)) == JobMessage(held.job_id, "odometry")


def test_a_worker_that_lost_the_stage_cannot_split_it(database: Database) -> None:
    _, held = odometry(database)
    with database.write() as session:
        jobs.fail(session, held, "lost", final=False)
    with pytest.raises(LeaseLostError):
        split(database, held, [1, 2])
    with database.read() as session:
        assert session.query(jobs.Job).where(jobs.Job.part > 0).count() == 0


def test_parts_that_are_gone_are_made_again_but_not_for_ever(database: Database) -> None:
    _, held = odometry(database)
    for attempt in (1, 2):
        (message,) = split(database, held, [1])
        assert part_done(database, take(database, message.job_id)) is not None
        held = take(database, held.job_id)
        assert held.attempt == attempt
    (message,) = split(database, held, [1])
    part_done(database, take(database, message.job_id))
    held = take(database, held.job_id)
    assert held.attempt == 3
    with pytest.raises(StageError, match="not there"):
        split(database, held, [1])


def test_removing_a_drive_takes_its_parts_from_whoever_makes_them(database: Database) -> None:
    drive_id, held = odometry(database)
    claim = take(database, split(database, held, [1, 2])[0].job_id)
    with database.write() as session:
        drives.request_removal(session, drive_id)
    with pytest.raises(LeaseLostError):
        part_done(database, claim)
    with pytest.raises(ConflictError), database.write() as session:
        drives.request_removal(session, drive_id)
