"""Uploads in an object store: what stands in the database has arrived, and two writers cannot mix their bytes."""

import hashlib
from collections.abc import Sequence

import pytest

from wayloom.errors import ChecksumMismatchError, NotFoundError, OffsetConflictError
from wayloom.store import drives, packs, uploads
from wayloom.store.arrivals import Whole
from wayloom.store.blobs import BlobError
from wayloom.store.database import Database
from wayloom.store.manifest import Manifest, ManifestFile
from wayloom.store.objects import Objects
from wayloom.store.receiving import part_writer, parts
from wayloom.store.receiving.objects import ObjectPlace
from wayloom.store.receiving.pack_rows import PackRows
from wayloom.store.receiving.places import Arriving
from wayloom.store.tables.drives import Upload

CONTENTS = {"log/a": b"first file", "log/b": b"", "log/c": b"the third"}
STREAM = b"".join(CONTENTS.values())


@pytest.fixture
def objects() -> Objects:
    return Objects("memory:///")


@pytest.fixture
def place(objects: Objects, database: Database, monkeypatch: pytest.MonkeyPatch) -> ObjectPlace:
    monkeypatch.setattr(part_writer, "PART_BYTES", 4)
    return ObjectPlace(objects, database)


def sha(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def drive(database: Database) -> str:
    files = tuple(ManifestFile(path=path, size=len(content), sha256=sha(content)) for path, content in CONTENTS.items())
    with database.write() as session:
        return drives.register(session, Manifest(name="drive", files=files), "city")[0].id


def upload_of_a(database: Database) -> Upload:
    drive_id = drive(database)
    with database.write() as session:
        return uploads.create(session, drive_id, "log/a", len(CONTENTS["log/a"]), "", 60.0)


def pack_of_all(database: Database, place: ObjectPlace) -> Upload:
    drive_id = drive(database)
    with database.write() as session:
        files = packs.lacking(session, drive_id, [*CONTENTS])
        upload = packs.create(session, drive_id, files)
    place.index(upload, files)
    return upload


def rows_of(database: Database, place: ObjectPlace, upload: Upload) -> PackRows:
    with database.read() as session:
        done = uploads.find(session, upload.id).files_done or 0
    return PackRows(database, place.pack(upload), done, 60.0)


def names(objects: Objects) -> set[str]:
    return {name.rpartition("/")[2] for some in objects.older_than(-1.0, parts.BELOW) for name in some}


def send(arrival: Arriving, *contents: bytes) -> None:
    try:
        for content in contents:
            arrival.take(memoryview(content))
        arrival.end()
    finally:
        arrival.close()


def read(objects: Objects, database: Database, upload: Upload, start: int = 0) -> bytes:
    with database.read() as session:
        stored = parts.parts_of(session, upload.id, start)
    return b"".join(parts.read(objects, stored, start))


def test_bytes_are_kept_in_parts_and_read_from_any_of_them(objects: Objects, database: Database, place: ObjectPlace) -> None:
    upload = upload_of_a(database)
    send(place.arrival(upload, 0, None), b"fi", b"rst", b" ")
    assert place.offset(upload) == 6
    send(ObjectPlace(objects, database).arrival(upload, 6, None), b"file")
    assert len(names(objects)) == 3
    for start in (0, 3, 5, 9):
        assert read(objects, database, upload, start) == CONTENTS["log/a"][start:]
    assert place.settle(upload, "") == sha(CONTENTS["log/a"])  # of which this process has seen the beginning alone


def test_of_two_writers_the_second_to_finish_a_part_hears_of_it_and_leaves_no_object(
    objects: Objects, database: Database, place: ObjectPlace
) -> None:
    upload = upload_of_a(database)
    late, early = place.arrival(upload, 0, None), place.arrival(upload, 0, None)
    send(early, b"first")
    late.take(memoryview(b"FIR"))
    with pytest.raises(BlockingIOError):
        late.close()
    assert read(objects, database, upload) == b"first"
    assert len(names(objects)) == 1
    with pytest.raises(OffsetConflictError, match="5 bytes are stored"):
        place.arrival(upload, 0, None)


def test_a_chunk_with_one_checksum_is_kept_whole_or_not_at_all(objects: Objects, database: Database, place: ObjectPlace) -> None:
    upload = upload_of_a(database)
    with pytest.raises(ChecksumMismatchError):
        send(place.arrival(upload, 0, Whole(hashlib.sha256(), hashlib.sha256(b"first f").digest())), b"first", b" F")
    assert place.offset(upload) == 0
    assert names(objects) == set()
    unfinished = place.arrival(upload, 0, Whole(hashlib.sha256(), hashlib.sha256(b"first f").digest()))
    unfinished.take(memoryview(b"first"))
    unfinished.close()
    assert place.offset(upload) == 0
    send(place.arrival(upload, 0, Whole(hashlib.sha256(), hashlib.sha256(b"first f").digest())), b"first", b" f")
    assert read(objects, database, upload) == b"first f"


def test_what_belongs_to_an_upload_that_was_dropped_meanwhile_is_not_stored(
    objects: Objects, database: Database, place: ObjectPlace
) -> None:
    upload = upload_of_a(database)
    arrival = place.arrival(upload, 0, None)
    with database.write() as session:
        uploads.remove(session, upload.id)
    with pytest.raises(NotFoundError):
        send(arrival, b"first")
    assert names(objects) == set()


class AwayForNow(Objects):
    """Takes so many objects."""

    def __init__(self, takes: int) -> None:
        super().__init__("memory:///")
        self._takes = takes

    def put(self, name: str, content: bytes | bytearray) -> None:
        self._takes -= 1
        if self._takes < 0:
            raise BlobError("away")
        super().put(name, content)


def test_what_was_stored_before_the_object_store_went_away_stays(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(part_writer, "PART_BYTES", 4)
    objects = AwayForNow(1)
    place, upload = ObjectPlace(objects, database), upload_of_a(database)
    with pytest.raises(BlobError):
        send(place.arrival(upload, 0, None), b"firs", b"t fi", b"le")
    assert place.offset(upload) == 4
    assert read(objects, database, upload) == b"firs"


@pytest.mark.parametrize("cuts", [(), (3,), (10,), (4, 11), (18,), range(1, 19)])
def test_a_pack_goes_on_at_any_byte_and_its_files_lie_in_its_parts(
    objects: Objects, database: Database, place: ObjectPlace, cuts: Sequence[int]
) -> None:
    upload = pack_of_all(database, place)
    begun = 0
    for end in (*cuts, len(STREAM)):
        assert place.offset(upload) == begun
        send(place.pack_arrival(upload, None, rows_of(database, place, upload)), STREAM[begun:end])
        begun = end
    assert read(objects, database, upload) == STREAM
    with database.read() as session:
        assert uploads.find(session, upload.id).complete
        assert drives.get(session, upload.drive_id).state == "queued"


@pytest.mark.parametrize("cut", [0, 12, 15])
def test_a_file_of_a_pack_that_is_not_the_one_announced_is_cut_off(
    objects: Objects, database: Database, place: ObjectPlace, cut: int
) -> None:
    upload = pack_of_all(database, place)
    wrong = b"first fileTHE THIRD"
    send(place.pack_arrival(upload, None, rows_of(database, place, upload)), wrong[:cut])
    with pytest.raises(ChecksumMismatchError, match="log/c has SHA-256"):
        send(place.pack_arrival(upload, None, rows_of(database, place, upload)), wrong[cut:])
    assert place.offset(upload) == 10
    assert read(objects, database, upload) == b"first file"
    send(place.pack_arrival(upload, None, rows_of(database, place, upload)), b"the third")
    assert read(objects, database, upload) == STREAM


def test_a_pack_that_is_dropped_keeps_the_files_that_have_arrived(objects: Objects, database: Database, place: ObjectPlace) -> None:
    upload = pack_of_all(database, place)
    send(place.pack_arrival(upload, None, rows_of(database, place, upload)), STREAM[:17])
    with database.write() as session:
        uploads.remove(session, upload.id)
    place.drop(upload)
    assert read(objects, database, upload) == CONTENTS["log/a"]
    assert "pack" not in names(objects)


def test_the_files_of_a_drive_are_read_out_of_its_parts(objects: Objects, database: Database, place: ObjectPlace) -> None:
    upload = pack_of_all(database, place)
    send(place.pack_arrival(upload, None, rows_of(database, place, upload)), STREAM[:17])
    found = {path: (size, b"".join(blocks)) for path, size, blocks in place.files(upload.drive_id)}
    assert found == {path: (len(CONTENTS[path]), CONTENTS[path]) for path in ("log/a", "log/b")}


def test_a_file_that_has_come_by_another_upload_meanwhile_is_read_from_that_one(
    objects: Objects, database: Database, place: ObjectPlace
) -> None:
    pack, alone = pack_of_all(database, place), upload_of_a(database)
    send(place.arrival(alone, 0, None), CONTENTS["log/a"])
    with database.write() as session:
        drives.mark_complete(session, alone.drive_id, "log/a", alone.id)
    send(place.pack_arrival(pack, None, rows_of(database, place, pack)), STREAM)
    with database.read() as session:
        found = {path: uploads.promised(session, Upload(drive_id=pack.drive_id, path=path)).upload_id for path in CONTENTS}
    assert found == {"log/a": alone.id, "log/b": pack.id, "log/c": pack.id}
