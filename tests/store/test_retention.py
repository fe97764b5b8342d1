"""Images go when their time is over, never while a job needs them, and may be sent once more."""

import threading
from pathlib import Path

import pytest
from sqlalchemy import update

from wayloom.config.retention import UploadSettings
from wayloom.store import drives, gate, jobs, map_versions, maps, reprocessing, retention
from wayloom.store.database import Database
from wayloom.store.folders import Folders
from wayloom.store.images import DELETING, ImagesDeletedError
from wayloom.store.manifest import Manifest, ManifestFile
from wayloom.store.map_versions import NewVersion
from wayloom.store.tables.drives import Drive, Job

AT_ONCE, WEEK, KEEP = UploadSettings(), UploadSettings(retention=7), UploadSettings(retention="keep")
MANIFEST = Manifest(name="drive", files=(ManifestFile(path="log/a.png", size=1, sha256="0" * 64),))
DAY_S = 86_400.0


@pytest.fixture
def folders(tmp_path: Path) -> Folders:
    return Folders(tmp_path / "data")


def arrived(database: Database, folders: Folders) -> str:
    """A drive whose file has come and whose jobs are queued."""
    with database.write() as session:
        drive_id = drives.register(session, MANIFEST, "city")[0].id
        send(session, folders, drive_id)
    return drive_id


def send(session: object, folders: Folders, drive_id: str) -> jobs.JobMessage | None:
    file = folders.drive(drive_id) / "log" / "a.png"
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(b"1")
    return drives.mark_complete(session, drive_id, "log/a.png")  # type: ignore[arg-type]


def end_jobs(database: Database, drive_id: str, state: str = "done") -> None:
    with database.write() as session:
        session.execute(update(Job).where(Job.drive_id == drive_id).values(state=state, finished_at=drives.now_s(session)))


def published(database: Database, folders: Folders) -> str:
    """A drive that the newest version has."""
    drive_id = arrived(database, folders)
    for stage in ("segmentation", "odometry", "ground"):
        (folders.drive(drive_id) / "stages" / stage / "key").mkdir(parents=True)
    end_jobs(database, drive_id)
    with database.write() as session:
        gate.judge(session, drive_id, "A", [], "merge")
        gate.ask_map(session, drives.get(session, drive_id))
    publish(database, drive_id)
    return drive_id


def publish(database: Database, *held: str) -> None:
    with database.write() as session:
        base = maps.get(session, "city").version
        map_versions.publish(session, "city", NewVersion(base, (8.5, 49.5, 0.0), held, 1, None, ()), kept=20)


def later(database: Database, drive_id: str, days: float) -> None:
    """As if everything had happened so many days before."""
    with database.write() as session:
        drive = drives.get(session, drive_id)
        for name in ("created_at", "uploaded_at", "finished_at", "images_since"):
            if getattr(drive, name) is not None:
                setattr(drive, name, getattr(drive, name) - days * DAY_S)
        session.execute(update(Job).where(Job.drive_id == drive_id).values(finished_at=Job.finished_at - days * DAY_S))


def images(database: Database, drive_id: str) -> str:
    with database.read() as session:
        return drives.get(session, drive_id).images


def test_images_go_with_the_version_that_has_the_drive_and_what_shows_them_too(database: Database, folders: Folders) -> None:
    drive_id = published(database, folders)
    assert retention.delete_due(database, folders, AT_ONCE) == 1
    home = folders.drive(drive_id)
    assert sorted(path.relative_to(home).as_posix() for path in home.rglob("*")) == ["stages", "stages/ground", "stages/ground/key"]
    assert not any(folders.trash.iterdir())
    assert images(database, drive_id) == "deleted"
    assert retention.delete_due(database, folders, AT_ONCE) == 0


@pytest.mark.parametrize("state", ["waiting", "queued", "running"])
def test_images_stay_while_a_job_of_the_drive_is_to_run(database: Database, folders: Folders, state: str) -> None:
    drive_id = published(database, folders)
    end_jobs(database, drive_id, state)
    later(database, drive_id, 1000)
    assert retention.delete_due(database, folders, AT_ONCE) == 0
    assert (folders.drive(drive_id) / "log" / "a.png").is_file()


def test_images_stay_until_the_version_is_published(database: Database, folders: Folders) -> None:
    drive_id = arrived(database, folders)
    end_jobs(database, drive_id)
    with database.write() as session:
        gate.judge(session, drive_id, "A", [], "merge")
        gate.ask_map(session, drives.get(session, drive_id))
    later(database, drive_id, 1000)
    assert retention.delete_due(database, folders, AT_ONCE) == 0
    with database.write() as session:
        drives.get(session, drive_id).state = "done"  # without a version that has it
        drives.get(session, drive_id).finished_at = drives.now_s(session)
    assert retention.delete_due(database, folders, AT_ONCE) == 0


def test_images_stay_for_as_long_as_the_setting_says(database: Database, folders: Folders) -> None:
    drive_id = published(database, folders)
    later(database, drive_id, 6.9)
    assert retention.delete_due(database, folders, WEEK) == 0
    later(database, drive_id, 0.2)
    assert retention.delete_due(database, folders, KEEP) == 0
    assert retention.delete_due(database, folders, WEEK) == 1


def test_images_of_a_drive_in_the_map_stay_longer_than_those_outside_where_the_setting_says_so(
    database: Database, folders: Folders
) -> None:
    drive_id = published(database, folders)
    quarter = UploadSettings(retention=90)
    for days, deleted in ((31.0, 0), (58.0, 0), (2.0, 1)):
        later(database, drive_id, days)
        assert retention.delete_due(database, folders, quarter) == deleted


@pytest.mark.parametrize("state", ["held", "quarantined", "failed"])
def test_images_of_a_drive_outside_of_the_map_go_at_their_greatest_age(database: Database, folders: Folders, state: str) -> None:
    drive_id = arrived(database, folders)
    end_jobs(database, drive_id, "failed" if state == "failed" else "done")
    with database.write() as session:
        drive = drives.get(session, drive_id)
        drive.state, drive.finished_at = state, drives.now_s(session)
    later(database, drive_id, 29.9)
    assert retention.delete_due(database, folders, AT_ONCE) == 0
    later(database, drive_id, 0.2)
    assert retention.delete_due(database, folders, KEEP) == 0
    assert retention.delete_due(database, folders, AT_ONCE) == 1


def test_a_drive_that_did_not_arrive_whole_leaves_nothing_and_may_still_arrive(database: Database, folders: Folders) -> None:
    both = Manifest(name="drive", files=(*MANIFEST.files, ManifestFile(path="log/b.png", size=1, sha256="1" * 64)))
    with database.write() as session:
        drive_id = drives.register(session, both, "city")[0].id
        send(session, folders, drive_id)
    later(database, drive_id, 31)
    assert retention.delete_due(database, folders, AT_ONCE) == 1
    assert retention.delete_due(database, folders, AT_ONCE) == 0
    with database.read() as session:
        assert [path for path, _, _ in drives.missing_files(session, drive_id)] == ["log/a.png", "log/b.png"]
        assert drives.get(session, drive_id).state == "uploading"


def test_a_drive_whose_last_file_comes_while_its_images_are_being_deleted_is_not_queued(
    database: Database, folders: Folders
) -> None:
    both = Manifest(name="drive", files=(*MANIFEST.files, ManifestFile(path="log/b.png", size=1, sha256="1" * 64)))
    with database.write() as session:
        drive_id = drives.register(session, both, "city")[0].id
        send(session, folders, drive_id)
    later(database, drive_id, 31)
    with database.write() as session:
        retention._mark(session, drive_id, AT_ONCE)
    with database.write() as session:
        assert drives.mark_complete(session, drive_id, "log/b.png") is None
    assert retention.delete_due(database, folders, AT_ONCE) == 1
    with database.read() as session:
        assert drives.get(session, drive_id).state == "uploading"
        assert [path for path, _, _ in drives.missing_files(session, drive_id)] == ["log/a.png", "log/b.png"]


def test_a_retry_waits_for_a_sweeper_that_marks_the_images(database: Database, folders: Folders) -> None:
    drive_id = arrived(database, folders)
    end_jobs(database, drive_id, "failed")
    begun, said = threading.Event(), []

    def retry() -> None:
        begun.set()
        with database.write() as session:
            try:
                said.append(reprocessing.retry(session, drive_id))
            except ImagesDeletedError as error:
                said.append(error)

    other = threading.Thread(target=retry)
    with database.write() as session:
        gate.lock(session, drive_id).images = DELETING
        session.flush()
        other.start()
        begun.wait()
        other.join(0.3)
        assert said == []
    other.join()
    assert [type(one) for one in said] == [ImagesDeletedError]


def test_a_run_anew_without_images_is_refused_until_they_are_sent_once_more(database: Database, folders: Folders) -> None:
    drive_id = published(database, folders)
    retention.delete_due(database, folders, AT_ONCE)
    with database.write() as session, pytest.raises(ImagesDeletedError, match="send the same log once more"):
        reprocessing.begin(session, drive_id, {})
    with database.write() as session:
        assert drives.register(session, MANIFEST, "city") == (drives.get(session, drive_id), False)
        assert drives.missing_files(session, drive_id) == []
        drives.register(session, MANIFEST, "city", again=True)
        assert [path for path, _, _ in drives.missing_files(session, drive_id)] == ["log/a.png"]
        assert drives.received(session, [drives.get(session, drive_id)])[drive_id].files == 0
    with database.write() as session, pytest.raises(ImagesDeletedError):
        reprocessing.begin(session, drive_id, {})
    with database.write() as session:
        assert send(session, folders, drive_id) is None
    assert retention.delete_due(database, folders, AT_ONCE) == 0  # not published since
    with database.write() as session:
        reprocessing.begin(session, drive_id, {})
    end_jobs(database, drive_id)
    with database.write() as session:
        message = gate.ask_map(session, drives.get(session, drive_id))
        reprocessing.await_version(drives.get(session, drive_id), message.job_id)
    publish(database, drive_id)
    with database.write() as session:
        reprocessing.take_published(session, "city", message.job_id)
    assert retention.delete_due(database, folders, AT_ONCE) == 1


def test_images_that_were_sent_once_more_in_vain_go_at_their_greatest_age(database: Database, folders: Folders) -> None:
    drive_id = published(database, folders)
    retention.delete_due(database, folders, AT_ONCE)
    with database.write() as session:
        drives.register(session, MANIFEST, "city", again=True)
        send(session, folders, drive_id)
    later(database, drive_id, 31)
    with database.write() as session:
        drives.get(session, drive_id).finished_at = drives.get(session, drive_id).uploaded_at - 1.0  # type: ignore[operator]
    assert retention.delete_due(database, folders, AT_ONCE) == 1
    assert images(database, drive_id) == "deleted"


def test_a_new_run_that_failed_long_ago_is_given_up_with_the_images(database: Database, folders: Folders) -> None:
    drive_id = published(database, folders)
    with database.write() as session:
        reprocessing.begin(session, drive_id, {})
    end_jobs(database, drive_id, "failed")
    assert retention.delete_due(database, folders, AT_ONCE) == 0
    later(database, drive_id, 31)
    assert retention.delete_due(database, folders, AT_ONCE) == 1
    with database.read() as session:
        drive = drives.get(session, drive_id)
        assert (drive.state, drive.coming) == ("done", None)


def test_a_failed_drive_whose_images_went_begins_anew_when_it_is_sent_once_more(database: Database, folders: Folders) -> None:
    drive_id = arrived(database, folders)
    end_jobs(database, drive_id, "failed")
    with database.write() as session:
        drive = drives.get(session, drive_id)
        drive.state, drive.finished_at = "failed", drives.now_s(session)
    later(database, drive_id, 31)
    retention.delete_due(database, folders, AT_ONCE)
    with database.write() as session:
        drives.register(session, MANIFEST, "city", again=True)
        first = send(session, folders, drive_id)
        assert first is not None
        assert drives.get(session, drive_id).state == "queued"


@pytest.mark.parametrize("dies", ["before the folders are renamed", "after the folders are renamed", "before the trash is emptied"])
def test_a_sweeper_that_dies_is_finished_by_the_next_one(
    database: Database, folders: Folders, monkeypatch: pytest.MonkeyPatch, dies: str
) -> None:
    drive_id = published(database, folders)

    def die(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        if dies == "before the folders are renamed":
            patch.setattr(retention, "_move_out", die)
        elif dies == "after the folders are renamed":
            patch.setattr(retention, "update", die)  # of the rows, right after the renaming
        else:
            patch.setattr(retention.shutil, "rmtree", die)
        with pytest.raises(KeyboardInterrupt):
            retention.delete_due(database, folders, AT_ONCE)
    with database.write() as session, pytest.raises(ImagesDeletedError):
        reprocessing.begin(session, drive_id, {})
    retention.delete_due(database, folders, AT_ONCE)
    assert images(database, drive_id) == "deleted"
    assert not (folders.drive(drive_id) / "log").exists()
    assert not any(folders.trash.iterdir())


def test_a_late_sweeper_takes_nothing_of_what_was_sent_once_more(
    database: Database, folders: Folders, monkeypatch: pytest.MonkeyPatch
) -> None:
    drive_id = published(database, folders)
    real = retention._move_out

    def overtaken(session: object, folders_: Folders, which: str) -> bool:
        """Another sweeper finishes, and the log comes again, before this one begins."""
        assert real(session, folders_, which)  # type: ignore[arg-type]
        drives.register(session, MANIFEST, "city", again=True)  # type: ignore[arg-type]
        send(session, folders, drive_id)
        return real(session, folders_, which)  # type: ignore[arg-type]

    monkeypatch.setattr(retention, "_move_out", overtaken)
    assert retention.delete_due(database, folders, AT_ONCE) == 0
    assert (folders.drive(drive_id) / "log" / "a.png").is_file()
    assert images(database, drive_id) == "kept"


def test_equal_files_of_another_drive_stay(database: Database, folders: Folders) -> None:
    drive_id = published(database, folders)
    with database.write() as session:
        other = drives.register(session, MANIFEST.model_copy(update={"name": "other"}), "city")[0].id
        send(session, folders, other)
    assert retention.delete_due(database, folders, AT_ONCE) == 1
    assert not (folders.drive(drive_id) / "log").exists()
    assert (folders.drive(other) / "log" / "a.png").read_bytes() == b"1"
    with database.read() as session:
        assert session.get_one(Drive, other).images == "kept"
