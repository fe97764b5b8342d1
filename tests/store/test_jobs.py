"""Job rows: one holder at a time, whatever is delivered twice, late, or never."""

import threading
import time
from collections.abc import Callable

import pytest

from wayloom.config.stages import drive_stages
from wayloom.errors import ConflictError, LeaseLostError
from wayloom.store import drives, history, jobs, maps, sweep
from wayloom.store.database import Database
from wayloom.store.jobs import Claim
from wayloom.store.manifest import Manifest, ManifestFile
from wayloom.store.processes import identity
from wayloom.store.tables.drives import Drive, Job

LEASE_S = 60.0


def new_drive(database: Database, name: str = "a") -> tuple[str, int]:
    """A drive whose file has arrived, and its first job."""
    with database.write() as session:
        manifest = Manifest(name=name, files=(ManifestFile(path="log/a", size=1, sha256="0" * 64),))
        drive, _ = drives.register(session, manifest, "city")
        message = drives.mark_complete(session, drive.id, "log/a")
        assert message is not None
        return drive.id, message.job_id


def take(database: Database, job_id: int, worker: str = "elsewhere|1|1") -> Claim:
    held = jobs.claim(database, job_id, worker, LEASE_S)
    assert held is not None
    return held


def done(database: Database, held: Claim) -> jobs.JobMessage | None:
    with database.write() as session:
        return jobs.finish(session, held, "key")


def job(database: Database, job_id: int) -> Job:
    with database.read() as session:
        return session.get_one(Job, job_id)


def drive(database: Database, drive_id: str) -> Drive:
    with database.read() as session:
        return session.get_one(Drive, drive_id)


def at_once(work: Callable[[], object], times: int) -> list[object]:
    """The results of running it in several threads that start together."""
    results: list[object] = []
    barrier = threading.Barrier(times)

    def run() -> None:
        barrier.wait()
        results.append(work())

    threads = [threading.Thread(target=run) for _ in range(times)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return results


def test_of_many_workers_that_reach_for_a_job_one_gets_it(database: Database) -> None:
    _, job_id = new_drive(database)
    claims = at_once(lambda: jobs.claim(database, job_id, "w", LEASE_S), 8)
    assert sum(claim is not None for claim in claims) == 1


def test_a_message_that_comes_twice_finds_nothing_to_do(database: Database) -> None:
    _, job_id = new_drive(database)
    done(database, take(database, job_id))
    assert jobs.claim(database, job_id, "w", LEASE_S) is None
    assert jobs.claim(database, 10**6, "w", LEASE_S) is None


def test_the_stages_are_queued_one_after_the_other(database: Database) -> None:
    drive_id, job_id = new_drive(database)
    seen = []
    while job_id:
        held = take(database, job_id)
        seen.append(held.stage)
        assert drive(database, drive_id).state == "running"
        following = done(database, held)
        job_id = following.job_id if following else 0
    assert tuple(seen) == drive_stages()


def test_a_worker_whose_token_is_old_can_neither_beat_nor_finish_nor_fail(database: Database) -> None:
    _, job_id = new_drive(database)
    old = take(database, job_id)
    with database.write() as session:
        jobs.fail(session, old, "lost", final=False)
    new = take(database, job_id)
    assert new.token > old.token
    with pytest.raises(LeaseLostError):
        jobs.heartbeat(database, old, LEASE_S, 0.5, "")
    with pytest.raises(LeaseLostError), database.write() as session:
        jobs.finish(session, old, "key")
    with pytest.raises(LeaseLostError), database.write() as session:
        jobs.fail(session, old, "", final=True)
    done(database, new)
    assert job(database, job_id).state == "done"


def test_a_heartbeat_prolongs_the_lease_and_tells_the_progress(database: Database) -> None:
    _, job_id = new_drive(database)
    held = take(database, job_id)
    before = job(database, job_id).lease_until or 0.0
    time.sleep(0.02)
    jobs.heartbeat(database, held, LEASE_S, 0.25, "frame 5 of 20")
    row = job(database, job_id)
    assert (row.progress, row.message) == (0.25, "frame 5 of 20")
    assert (row.lease_until or 0.0) > before


def test_a_job_whose_lease_ran_out_is_queued_again(database: Database) -> None:
    _, job_id = new_drive(database)
    jobs.claim(database, job_id, "elsewhere|1|1", 0.01)
    time.sleep(0.05)
    assert sweep.requeue_lost(database, 3) == 1
    assert job(database, job_id).state == "queued"
    assert [message.job_id for message in sweep.unsent(database, 10.0)] == [job_id]


def test_a_job_whose_process_died_is_queued_again_at_once(database: Database) -> None:
    _, job_id = new_drive(database)
    take(database, job_id, identity(999_999_999))
    assert sweep.requeue_lost(database, 3) == 1
    assert job(database, job_id).state == "queued"


def test_a_job_of_a_living_process_is_left_alone(database: Database) -> None:
    _, job_id = new_drive(database)
    take(database, job_id, identity())
    assert sweep.requeue_lost(database, 3) == 0
    assert job(database, job_id).state == "running"


def test_many_sweepers_at_once_count_a_lost_job_once(database: Database) -> None:
    _, job_id = new_drive(database)
    jobs.claim(database, job_id, "elsewhere|1|1", 0.01)
    time.sleep(0.05)
    at_once(lambda: sweep.requeue_lost(database, 3), 4)
    row = job(database, job_id)
    assert (row.state, row.attempt, len(row.losses)) == ("queued", 0, 1)


def lose_worker(database: Database, job_id: int, crash: str = "", max_losses: int = 20) -> None:
    """One more worker of the job falls silent."""
    jobs.claim(database, job_id, "elsewhere/boot|1|1", 0.01)
    time.sleep(0.03)
    assert sweep.requeue_lost(database, 3, max_losses, crash_of=lambda _: crash) == 1


def test_workers_that_are_lost_through_no_fault_of_the_stage_use_up_no_attempt(database: Database) -> None:
    _, job_id = new_drive(database)
    for _ in range(5):
        lose_worker(database, job_id)
    row = job(database, job_id)
    assert (row.state, row.attempt, len(row.losses)) == ("queued", 0, 5)
    assert row.losses[-1]["worker"] == "elsewhere pid 1"
    assert "no sign of life" in row.losses[-1]["why"]


def test_a_job_that_loses_worker_after_worker_is_quarantined_with_its_evidence(database: Database) -> None:
    drive_id, job_id = new_drive(database)
    for _ in range(4):
        lose_worker(database, job_id, max_losses=4)
    row = drive(database, drive_id)
    assert (row.state, job(database, job_id).state) == ("failed", "failed")
    assert "quarantined: 4 workers were lost over it" in str(row.error)
    with database.write() as session:
        jobs.retry(session, drive_id)
    assert job(database, job_id).losses == []


def test_a_worker_that_was_told_to_stop_and_was_killed_before_it_could_is_no_loss(database: Database) -> None:
    _, job_id = new_drive(database)
    held = jobs.claim(database, job_id, "elsewhere|1|1", 0.05)
    assert held is not None
    jobs.heartbeat(database, held, 0.01, 0.5, sweep.STOPPING)
    time.sleep(0.03)
    assert sweep.requeue_lost(database, 3) == 1
    row = job(database, job_id)
    assert (row.state, row.attempt, row.losses) == ("queued", 0, [])


def test_a_failed_job_waits_before_it_is_tried_again(database: Database) -> None:
    _, job_id = new_drive(database)
    held = take(database, job_id)
    with database.write() as session:
        jobs.fail(session, held, "bad luck", final=False, pause_s=0.3)
    assert jobs.claim(database, job_id, "w", LEASE_S) is None
    assert sweep.unsent(database, 10.0) == []
    time.sleep(0.35)
    assert [message.job_id for message in sweep.unsent(database, 10.0)] == [job_id]
    assert take(database, job_id).attempt == 2


@pytest.mark.parametrize("how", ["fail", "lose"])
def test_a_clock_that_goes_back_holds_a_paused_job_up_for_no_longer_than_its_pause(
    database: Database, monkeypatch: pytest.MonkeyPatch, how: str
) -> None:
    _, job_id = new_drive(database)
    held = take(database, job_id)
    now = [5000.0]
    for module in (jobs, sweep):
        monkeypatch.setattr(module, "now_s", lambda _: now[0])
    with database.write() as session:
        if how == "fail":
            jobs.fail(session, held, "bad luck", final=False, pause_s=300.0)
        else:
            jobs.lose(session, held, {"why": "the worker's process died"}, 300.0)
    now[0] = 5250.0
    assert sweep.unsent(database, 10.0) == []
    now[0] = 5050.0  # 200 s back, but after the pause began: at most the pause is left
    assert sweep.unsent(database, 10.0) == []
    assert jobs.claim(database, job_id, "w", LEASE_S) is None
    now[0] = 1000.0  # an hour back: nobody knows how much of the pause has passed
    assert [message.job_id for message in sweep.unsent(database, 10.0)] == [job_id]
    assert take(database, job_id).attempt == (2 if how == "fail" else 1)


def test_a_message_that_was_lost_is_sent_again_although_the_clock_went_back(
    database: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, job_id = new_drive(database)
    now = [5000.0]
    for module in (jobs, sweep):
        monkeypatch.setattr(module, "now_s", lambda _: now[0])
    messages = sweep.unsent(database, 10.0)
    jobs.mark_sent(database, messages)
    assert sweep.unsent(database, 10.0) == []
    now[0] = 1000.0
    assert [message.job_id for message in sweep.unsent(database, 10.0)] == [job_id]
    jobs.mark_sent(database, messages)
    assert sweep.unsent(database, 10.0) == []


def test_a_cancelled_drive_fails_at_once_and_its_worker_loses_the_job(database: Database) -> None:
    drive_id, job_id = new_drive(database)
    held = take(database, job_id)
    with database.write() as session:
        jobs.cancel(session, drive_id)
    row = drive(database, drive_id)
    assert (row.state, row.error) == ("failed", "ingest: cancelled")
    with pytest.raises(LeaseLostError):
        done(database, held)
    with pytest.raises(ConflictError), database.write() as session:
        jobs.cancel(session, drive_id)
    with database.write() as session:
        assert [message.job_id for message in jobs.retry(session, drive_id)] == [job_id]
    assert take(database, job_id).token > held.token


def test_a_retry_can_begin_with_a_stage_that_was_done(database: Database) -> None:
    drive_id, job_id = new_drive(database)
    following = done(database, take(database, job_id))
    assert following is not None
    held = take(database, following.job_id)
    with database.write() as session:
        jobs.fail(session, held, "bad luck", final=True)
    for wrong in ("labelling", "stitch", "nothing"):
        with pytest.raises(ConflictError), database.write() as session:
            jobs.retry(session, drive_id, wrong)
    with database.write() as session:
        assert [message.job_id for message in jobs.retry(session, drive_id, "ingest")] == [job_id]
    assert [job(database, one).state for one in (job_id, following.job_id)] == ["queued", "waiting"]
    assert take(database, job_id).payload == {jobs.ANEW: True}


def test_after_the_last_crash_the_drive_fails_and_says_why(database: Database) -> None:
    drive_id, job_id = new_drive(database)
    for _ in range(3):
        lose_worker(database, job_id, crash="Fatal Python error: Segmentation fault")
    assert job(database, job_id).state == "failed"
    row = drive(database, drive_id)
    assert row.state == "failed"
    assert "ingest" in str(row.error)
    assert "attempt 3 of 3" in str(row.error)
    assert "quarantined" in str(row.error)
    assert "Segmentation fault" in str(row.error)


def test_a_job_given_back_has_lost_no_attempt(database: Database) -> None:
    _, job_id = new_drive(database)
    held = take(database, job_id)
    with database.write() as session:
        jobs.release(session, held)
    row = job(database, job_id)
    assert (row.state, row.attempt) == ("queued", 0)


def test_a_retried_drive_goes_on_with_the_stage_that_failed(database: Database) -> None:
    drive_id, job_id = new_drive(database)
    following = done(database, take(database, job_id))
    assert following is not None
    held = take(database, following.job_id)
    with database.write() as session:
        jobs.fail(session, held, "bad luck", final=True)
    with database.write() as session:
        messages = jobs.retry(session, drive_id)
    assert [message.job_id for message in messages] == [following.job_id]
    assert job(database, job_id).state == "done"
    assert job(database, following.job_id).attempt == 0
    assert drive(database, drive_id).state == "queued"
    with pytest.raises(ConflictError), database.write() as session:
        jobs.retry(session, drive_id)


def test_one_job_of_a_map_runs_at_a_time_and_publishing_comes_first(database: Database) -> None:
    with database.write() as session:
        maps.ensure_map(session, "city")
        maps.ensure_map(session, "other")
        first = jobs.request_stitch(session, "city").id
        assert jobs.request_stitch(session, "city").id == first
        elsewhere = jobs.request_stitch(session, "other").id
    held = take(database, first)
    with database.write() as session:
        second = jobs.request_stitch(session, "city").id
    assert second != first
    assert jobs.claim(database, second, "w", LEASE_S) is None
    take(database, elsewhere)
    done(database, held)
    with database.write() as session:
        publish = jobs.create_map_job(session, "publish", "city", {"stitch": "key"}, first).id
    assert jobs.claim(database, second, "w", LEASE_S) is None
    done(database, take(database, publish))
    take(database, second)


def test_a_failed_map_job_fails_the_drives_that_wait_for_it_and_a_retry_brings_them_back(database: Database) -> None:
    drive_id, _ = new_drive(database)
    with database.write() as session:
        stitch = jobs.request_stitch(session, "city")
        row = drives.get(session, drive_id)
        row.state, row.stitch_job_id = "stitching", stitch.id
        job_id = stitch.id
    held = take(database, job_id)
    with database.write() as session:
        jobs.fail(session, held, "no\0 room", final=True)
    assert drive(database, drive_id).error == "stitch: no room"
    with database.read() as session:
        newest = history.of_drive(session, drive_id, 1)
        assert [(row.stage, row.what, row.text) for row in newest] == [("stitch", "failed", "no room")]
    with database.write() as session:
        assert [message.job_id for message in jobs.retry(session, drive_id)] == [job_id]
    assert drive(database, drive_id).state == "stitching"


def test_a_job_is_sent_again_only_when_nobody_took_it_for_a_while(database: Database) -> None:
    _, job_id = new_drive(database)
    (message,) = sweep.unsent(database, 10.0)
    jobs.mark_sent(database, [message])
    assert sweep.unsent(database, 10.0) == []
    time.sleep(0.02)
    assert [found.job_id for found in sweep.unsent(database, 0.01)] == [job_id]


def test_removing_a_drive_takes_its_jobs_from_whoever_runs_them(database: Database) -> None:
    drive_id, job_id = new_drive(database)
    held = take(database, job_id)
    with database.write() as session:
        drives.request_removal(session, drive_id)
    with pytest.raises(LeaseLostError):
        jobs.heartbeat(database, held, LEASE_S, 0.5, "")
    with pytest.raises(ConflictError), database.write() as session:
        drives.request_removal(session, drive_id)
