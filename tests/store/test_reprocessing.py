"""A drive that is processed anew: what it had counts until the version with the new result is published."""

import pytest
from sqlalchemy import select

from wayloom.config.stages import drive_stages
from wayloom.errors import ConflictError
from wayloom.store import coming, drives, gate, jobs, maps, reprocessing, runs
from wayloom.store.database import Database, Session
from wayloom.store.jobs import Claim
from wayloom.store.manifest import Manifest, ManifestFile
from wayloom.store.tables.drives import Drive, Job, SubmapRow


def row(drive_id: str, digest: str) -> SubmapRow:
    return SubmapRow(
        drive_id=drive_id, map_id="city", position=0, digest=digest, point_count=1, frame=[8.5, 49.5, 0.0], T_enu_submap=[],
        covariance=[], min_lon=8.0, min_lat=49.0, max_lon=8.1, max_lat=49.1,
    )  # fmt: skip


def found(session: Session, drive_id: str, word: str, grade: str = "A") -> None:
    """What the hooks of the stages write."""
    drive = drives.get(session, drive_id)
    coming.note(drive, log=word, quality=64 * word[0])
    coming.note_place(drive, True, [[8.0, 49.0, len(word)]])
    reprocessing.judge(session, drive_id, grade, [word], "merge" if grade < "D" else "hold")
    reprocessing.place_submaps(session, drive_id, [row(drive_id, 64 * word[0])])
    runs.record(session, drive, {"places": {"key": word}, "submaps": {"key": word}}, [64 * word[0]])


@pytest.fixture
def drive_id(database: Database) -> str:
    """A drive that is in the map."""
    manifest = Manifest(name="a", files=(ManifestFile(path="log/a", size=1, sha256="0" * 64),))
    with database.write() as session:
        drive_id = drives.register(session, manifest, "city")[0].id
        drives.mark_complete(session, drive_id, "log/a")
        found(session, drive_id, "old")
        drive = drives.get(session, drive_id)
        drive.state, drive.stitch_job_id = "done", 0
    return drive_id


def begin(database: Database, drive_id: str) -> int:
    with database.write() as session:
        return reprocessing.begin(session, drive_id, {"labelling": {"reach": 3}}).job_id


def first(database: Database, job_id: int) -> Claim:
    held = jobs.claim(database, job_id, "w", 60.0)
    assert held is not None
    return held


def shown(database: Database, drive_id: str) -> tuple[object, ...]:
    """What pages and map have of the drive."""
    with database.read() as session:
        drive = drives.get(session, drive_id)
        digests = [one.digest[0] for one in maps.submaps(session, "city")]
        verdict = coming.shown_verdict(drive)
        return drive.state, drive.facts["log"], drive.track, verdict["reasons"], digests


def test_map_and_pages_keep_the_result_until_the_version_with_the_new_one(database: Database, drive_id: str) -> None:
    before = shown(database, drive_id)
    held = first(database, begin(database, drive_id))
    with database.write() as session:
        jobs.finish(session, held, "k" * 64)
        drive = drives.get(session, drive_id)
        coming.note(drive, log="new", quality="n" * 64)
        coming.note_place(drive, True, [[9.0, 50.0, 3]])
        reprocessing.judge(session, drive_id, "B", ["new"], "merge")
    assert shown(database, drive_id) == before
    with database.write() as session:
        assert jobs.keys_of_outputs(session, drive_id, ("places",)) == {"places": "old"}
        found(session, drive_id, "new", "B")
        drive = drives.get(session, drive_id)
        drive.state = "stitching"
        reprocessing.await_version(drive, 7)
        assert jobs.keys_of_outputs(session, drive_id, ("places",)) == {"places": "new"}
    assert shown(database, drive_id)[1:] == (*before[1:4], ["n"])  # the map's next stitch reads the new submaps
    with database.write() as session:
        reprocessing.take_published(session, "city", 6)
    assert shown(database, drive_id)[1] == "old"
    with database.write() as session:
        reprocessing.take_published(session, "city", 7)
    assert shown(database, drive_id)[1:] == ("new", [[8.0, 49.0, 3]], ["new"], ["n"])
    with database.read() as session:
        assert drives.get(session, drive_id).coming is None
        assert [run.number for run in runs.of_drives(session, [drive_id])[drive_id]] == [2, 1]


def test_a_run_that_fails_leaves_what_was_there_and_can_be_tried_again(database: Database, drive_id: str) -> None:
    before = shown(database, drive_id)
    held = first(database, begin(database, drive_id))
    with database.write() as session:
        jobs.fail(session, held, "no such network", final=True)
    assert shown(database, drive_id) == before
    with database.write() as session:
        drive = drives.get(session, drive_id)
        assert (drive.error, drive.coming and drive.coming["error"]) == (None, "ingest: no such network")
        (again,) = jobs.retry(session, drive_id)
        assert "error" not in (drive.coming or {})
    assert shown(database, drive_id) == before
    first(database, again.job_id)
    with pytest.raises(ConflictError, match="already"):
        begin(database, drive_id)


def test_after_a_failed_run_another_may_begin_with_other_settings(database: Database, drive_id: str) -> None:
    held = first(database, begin(database, drive_id))
    with database.write() as session:
        jobs.fail(session, held, "no luck", final=True)
    begin(database, drive_id)
    with database.read() as session:
        states = [job.state for job in session.scalars(select(Job).where(Job.drive_id == drive_id).order_by(Job.position))]
        assert states == ["queued", *["waiting"] * (len(drive_stages()) - 1)]


def test_of_two_runs_at_once_the_second_is_refused_and_the_worker_of_a_replaced_one_may_not_commit(
    database: Database, drive_id: str
) -> None:
    held = first(database, begin(database, drive_id))
    with pytest.raises(ConflictError, match="is being processed anew already"):
        begin(database, drive_id)
    with database.read() as session:
        assert drives.get(session, drive_id).coming is not None
    jobs.heartbeat(database, held, 60.0, 0.5, "")


@pytest.mark.parametrize("state", ["queued", "running", "stitching", "removing"])
def test_a_drive_on_its_way_is_not_processed_anew(database: Database, drive_id: str, state: str) -> None:
    with database.write() as session:
        drives.get(session, drive_id).state = state
    with pytest.raises(ConflictError):
        begin(database, drive_id)


def test_a_drive_that_failed_before_it_had_a_result_begins_again(database: Database, drive_id: str) -> None:
    with database.write() as session:
        drive = drives.get(session, drive_id)
        drive.state, drive.error = "failed", "segmentation: no such network"
    held = first(database, begin(database, drive_id))
    with database.write() as session:
        assert drives.get(session, drive_id).state == "running"
        jobs.fail(session, held, "again", final=True)
        assert (drives.get(session, drive_id).state, drives.get(session, drive_id).error) == ("failed", "ingest: again")
    begin(database, drive_id)


def test_a_new_verdict_that_is_stricter_takes_the_drive_out_with_the_new_submaps_and_not_before(
    database: Database, drive_id: str
) -> None:
    begin(database, drive_id)
    with database.write() as session:
        reprocessing.judge(session, drive_id, "D", ["worse"], "hold")
        assert [one.digest[0] for one in maps.submaps(session, "city")] == ["o"]
        found(session, drive_id, "worse", "D")
        assert maps.submaps(session, "city") == []
        drive = drives.get(session, drive_id)
        message = gate.leave_out(session, drive)
        assert message is not None
        reprocessing.await_version(drive, message.job_id)
    assert shown(database, drive_id)[3] == ["old"]  # on its page, until the map without it is published
    with database.write() as session:
        reprocessing.take_published(session, "city", message.job_id)
    assert shown(database, drive_id)[1:4] == ("worse", [[8.0, 49.0, 5]], ["worse"])


def test_a_drive_that_is_removed_meanwhile_takes_its_new_result_along(database: Database, drive_id: str) -> None:
    held = first(database, begin(database, drive_id))
    with database.write() as session:
        coming.note(drives.get(session, drive_id), preview="p" * 64)
        drives.request_removal(session, drive_id)
        with pytest.raises(jobs.LeaseLostError):
            jobs.finish(session, held, "k" * 64)
        drives.delete_rows(session, drive_id)
        assert session.get(Drive, drive_id) is None
        assert runs.newest(session, drive_id) is None


def test_the_same_run_again_is_written_once(database: Database, drive_id: str) -> None:
    with database.write() as session:
        drive = drives.get(session, drive_id)
        runs.record(session, drive, {"places": {"key": "old"}, "submaps": {"key": "old"}}, [64 * "o"])
        assert [run.number for run in runs.of_drives(session, [drive_id])[drive_id]] == [1]
        made = runs.of_drives(session, [drive_id])[drive_id]
        assert runs.that_made(made, 64 * "o", 0.0) is made[0]
        assert runs.that_made(made, 64 * "x", 2e9) is None
