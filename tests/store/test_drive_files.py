"""Files of drives in an object store: fetched for a stage, dropped when others need the room, deleted with what they belong to."""

import fcntl
import hashlib
import os
import threading
from pathlib import Path

import pytest
from sqlalchemy import update

from wayloom.config.retention import UploadSettings
from wayloom.errors import StageError
from wayloom.store import drive_files, drives, packs, retention, uploads
from wayloom.store.database import Database
from wayloom.store.drive_files import DriveFiles
from wayloom.store.folders import Folders
from wayloom.store.images import DELETING
from wayloom.store.manifest import Manifest, ManifestFile
from wayloom.store.objects import Objects
from wayloom.store.receiving import parts
from wayloom.store.receiving.objects import ObjectPlace
from wayloom.store.receiving.pack_rows import PackRows
from wayloom.store.tables.drives import DriveFile, Upload

CONTENTS = {"log/image_0/a.png": b"a" * 5000, "log/empty": b"", "log/times.txt": b"0 1 2", "gnss/fixes.csv": b"t,lat,lon"}
MOST = 1 << 30


@pytest.fixture
def objects() -> Objects:
    return Objects("memory:///")


@pytest.fixture
def folders(tmp_path: Path) -> Folders:
    return Folders(tmp_path / "data")


@pytest.fixture
def files(folders: Folders, database: Database, objects: Objects) -> DriveFiles:
    return DriveFiles(folders, database, objects, MOST)


def sent(database: Database, objects: Objects, name: str = "drive") -> str:
    """A drive of which one file came by itself, the others in a pack."""
    place = ObjectPlace(objects, database)
    promised = [ManifestFile(path=path, size=len(data), sha256=hashlib.sha256(data).hexdigest()) for path, data in CONTENTS.items()]
    with database.write() as session:
        drive_id = drives.register(session, Manifest(name=name, gnss="gnss", files=tuple(promised)), "city")[0].id
        alone = uploads.create(session, drive_id, "log/image_0/a.png", 5000, "", 60.0)
    arrival = place.arrival(alone, 0, None)
    arrival.take(memoryview(CONTENTS["log/image_0/a.png"]))
    arrival.close()
    with database.write() as session:
        uploads.mark_complete(session, alone.id)
        drives.mark_complete(session, drive_id, alone.path, alone.id)
        few = packs.lacking(session, drive_id, [*CONTENTS])
        pack = packs.create(session, drive_id, few)
    index = place.index(pack, few)
    arriving = place.pack_arrival(pack, None, PackRows(database, index, 0, 60.0))
    arriving.take(memoryview(b"".join(CONTENTS[file.path] for file in few)))
    arriving.close()
    return drive_id


def quiet(_share: float, _what: str) -> None:
    """No progress."""


def below(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def names(objects: Objects) -> list[str]:
    return sorted(name for some in objects.older_than(-1.0, parts.BELOW) for name in some)


def fetch(files: DriveFiles, drive_id: str) -> None:
    with files.held(drive_id, quiet):
        pass


def test_a_stage_finds_the_files_of_its_drive_in_the_folder(
    database: Database, objects: Objects, folders: Folders, files: DriveFiles
) -> None:
    drive_id = sent(database, objects)
    told: list[str] = []
    with files.held(drive_id, lambda _share, what: told.append(what)):
        home = folders.drive(drive_id)
        assert {path: content for path, content in below(home).items() if "/" in path} == CONTENTS
    assert told == ["fetching the drive's files: 0 of 0 MiB"]
    objects.delete(names(objects))
    fetch(files, drive_id)  # nothing is fetched twice


def test_files_that_came_to_the_folder_are_left_alone(database: Database, folders: Folders) -> None:
    with database.write() as session:
        drive_id = drives.register(
            session, Manifest(name="d", files=(ManifestFile(path="log/a", size=1, sha256="0" * 64),)), "city"
        )[0].id
        drives.mark_complete(session, drive_id, "log/a")
    fetch(DriveFiles(folders, database, None, 0), drive_id)
    assert not folders.drive(drive_id).exists()


def test_a_file_that_is_gone_or_not_as_it_was_sent_is_said_and_nothing_takes_its_place(
    database: Database, objects: Objects, folders: Folders, files: DriveFiles
) -> None:
    drive_id = sent(database, objects)
    (name,) = (name for name in names(objects) if objects.get_all(name) == CONTENTS["log/image_0/a.png"])
    objects.put(name, b"b" * 5000)
    with pytest.raises(StageError, match=r"log/image_0/a\.png has SHA-256 .* send it again"):
        fetch(files, drive_id)
    objects.delete([name])
    with pytest.raises(StageError, match=r"log/image_0/a\.png: object .* not in the store"):
        fetch(files, drive_id)
    assert not (folders.drive(drive_id) / "log").exists()
    objects.put(name, CONTENTS["log/image_0/a.png"])
    fetch(files, drive_id)


def test_without_the_object_store_that_has_the_files_the_remedy_is_named(
    database: Database, objects: Objects, folders: Folders
) -> None:
    drive_id = sent(database, objects)
    with pytest.raises(StageError, match=r"uploads\.url"):
        fetch(DriveFiles(folders, database, None, MOST), drive_id)


def test_a_fetch_that_was_killed_is_begun_anew(database: Database, objects: Objects, folders: Folders, files: DriveFiles) -> None:
    drive_id = sent(database, objects)

    def dies(_share: float, _what: str) -> None:
        raise InterruptedError

    with pytest.raises(InterruptedError), files.held(drive_id, dies):
        pass
    home = folders.drive(drive_id)
    (home / "log").mkdir()
    (home / "log" / "times.txt").write_bytes(b"half")
    with files.held(drive_id, quiet):
        assert (home / "log" / "times.txt").read_bytes() == CONTENTS["log/times.txt"]
    assert not (home / drive_files.COMING).exists()


def test_two_workers_fetch_a_drive_once(
    database: Database, objects: Objects, folders: Folders, monkeypatch: pytest.MonkeyPatch
) -> None:
    drive_id, reads = sent(database, objects), []
    get = Objects.get
    monkeypatch.setattr(Objects, "get", lambda self, name, length: (reads.append(name), get(self, name, length))[1])
    workers = [threading.Thread(target=fetch, args=(DriveFiles(folders, database, objects, MOST), drive_id)) for _ in range(2)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    assert len(reads) == len(set(reads)) == 2


def test_the_drives_used_least_lately_make_room(database: Database, objects: Objects, folders: Folders) -> None:
    size = sum(map(len, CONTENTS.values()))
    files = DriveFiles(folders, database, objects, 2 * size)
    ids = [sent(database, objects, name) for name in ("one", "two", "three", "four")]
    for number, drive_id in enumerate(ids):
        fetch(files, drive_id)
        os.utime(folders.drive(drive_id) / drive_files.FETCHED, (1000 + number, 1000 + number))
    with files.held(ids[0], quiet):  # which makes it the last one used
        os.utime(folders.drive(ids[0]) / drive_files.FETCHED, (1, 1))
        assert files.evict() == 2  # of those that no stage reads
    assert [(folders.drive(drive_id) / "log").exists() for drive_id in ids] == [True, False, False, True]
    assert files.evict() == 0
    with files.held(ids[1], quiet):
        assert (folders.drive(ids[1]) / "log" / "times.txt").read_bytes() == CONTENTS["log/times.txt"]


def test_a_drive_that_a_stage_reads_stays_under_the_lock(
    database: Database, objects: Objects, folders: Folders, files: DriveFiles
) -> None:
    drive_id = sent(database, objects)
    with files.held(drive_id, quiet), (folders.drive(drive_id) / drive_files.LOCK).open() as other, pytest.raises(BlockingIOError):
        fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)


def test_objects_go_with_the_images_and_these_may_be_sent_once_more(
    database: Database, objects: Objects, folders: Folders, files: DriveFiles
) -> None:
    drive_id = sent(database, objects)
    fetch(files, drive_id)
    with database.write() as session:
        drives.get(session, drive_id).images = DELETING
    assert retention.delete_due(database, folders, UploadSettings(), files) == 1
    assert names(objects) == []
    assert set(below(folders.drive(drive_id))) <= {drive_files.LOCK}
    with database.write() as session:
        drive = drives.get(session, drive_id)
        drives.ask_again(session, drive)
        session.execute(update(DriveFile).where(DriveFile.drive_id == drive_id).values(complete=False))
    assert sent(database, objects) == drive_id
    fetch(files, drive_id)
    assert (folders.drive(drive_id) / "gnss" / "fixes.csv").read_bytes() == CONTENTS["gnss/fixes.csv"]


def test_an_upload_that_has_expired_goes_and_what_is_done_of_it_stays(
    database: Database, objects: Objects, files: DriveFiles
) -> None:
    drive_id = sent(database, objects)
    kept = names(objects)
    with database.write() as session:
        drives.get(session, drive_id)
        session.execute(update(DriveFile).where(DriveFile.path == "log/times.txt").values(complete=False, upload_id=None))
        lost = uploads.create(session, drive_id, "log/times.txt", 5, "", 60.0)
    arrival = ObjectPlace(objects, database).arrival(lost, 0, None)
    arrival.take(memoryview(b"0 1"))
    arrival.close()
    assert files.drop_given_up() == 0
    with database.write() as session:
        session.execute(update(Upload).values(expires_at=1.0))
    assert files.drop_given_up() == 1
    assert files.drop_given_up() == 0
    assert names(objects) == kept


def test_objects_that_no_row_names_are_deleted_when_they_are_old(
    database: Database, objects: Objects, files: DriveFiles, monkeypatch: pytest.MonkeyPatch
) -> None:
    drive_id = sent(database, objects)
    used = [name for name in names(objects) if not name.endswith("/pack")]
    with database.read() as session:
        upload_id = session.query(Upload.id).filter(Upload.files_done.is_(None)).scalar()
    for name in (f"drives/{drive_id}/{upload_id}/0000000000005000-x", f"drives/{'1' * 64}/{'2' * 32}/0000000000000000-x"):
        objects.put(name, b"lost")
    objects.put("somebody/else/s/object", b"not ours")
    assert files.drop_orphans() == 0
    monkeypatch.setattr(drive_files, "ORPHAN_S", -1.0)
    assert files.drop_orphans() == 3  # the two, and the index of a pack that is whole
    assert names(objects) == used
    assert objects.has("somebody/else/s/object")
