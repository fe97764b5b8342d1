"""Versions that hold a removed drive are withdrawn, and what they alone named is to be deleted."""

from dataclasses import replace
from pathlib import Path

import pytest
from sqlalchemy import select

from wayloom.errors import NotFoundError, WithdrawnError
from wayloom.store import drives, garbage, gate, jobs, map_versions, maps
from wayloom.store.blobs import BlobStore
from wayloom.store.database import Database
from wayloom.store.manifest import Manifest, ManifestFile
from wayloom.store.map_versions import NewVersion, RegionEntry, TileEntry
from wayloom.store.tables.maps import ForgottenBlob, MapDrive, MapVersion, RegionRow, TileRow


@pytest.fixture
def blobs(tmp_path: Path) -> BlobStore:
    return BlobStore(tmp_path / "blobs")


def register(database: Database, name: str) -> str:
    manifest = Manifest(name=name, files=(ManifestFile(path="log/a", size=1, sha256="0" * 64),))
    with database.write() as session:
        drive_id = drives.register(session, manifest, "city")[0].id
        gate.judge(session, drive_id, "A", [], "merge")
    return drive_id


def tile(blobs: BlobStore, x: int, content: bytes) -> TileEntry:
    return TileEntry("semantic", 18, x, 2, blobs.put(content), "image/png", len(content))


def publish(database: Database, held: tuple[str, ...], *tiles: TileEntry, **more: object) -> None:
    with database.write() as session:
        base = maps.ensure_map(session, "city").version
        new = NewVersion(base, (8.5, 49.5, 0.0), held, 1, (8.0, 49.0, 8.1, 49.1), tiles)
        map_versions.publish(session, "city", replace(new, **more), kept=20)  # type: ignore[arg-type]


def remove(database: Database, drive_id: str) -> None:
    with database.write() as session:
        drives.delete_rows(session, drive_id)


def served(database: Database) -> list[int]:
    with database.read() as session:
        return [row.version for row in maps.versions(session, "city")]


def shown(database: Database, number: int, x: int) -> str | None:
    with database.read() as session:
        row = maps.tile(session, "city", maps.version(session, "city", number).version, "semantic", 18, x, 2)
        return None if row is None else row.digest


def drop(database: Database, blobs: BlobStore) -> int:
    return garbage.drop_forgotten(database, blobs, list)


def test_the_version_that_holds_a_removed_drive_is_served_until_the_next_one_and_withdrawn_with_it(
    database: Database, blobs: BlobStore
) -> None:
    a, b = register(database, "a"), register(database, "b")
    street, joined, alone = tile(blobs, 1, b"street"), tile(blobs, 2, b"a and b"), tile(blobs, 2, b"a alone")
    region = RegionEntry(3, 4, "1" * 64, blobs.put(b"region with b"), [[b, "2" * 64]], 1)
    publish(database, (a,), street, alone)
    publish(database, (a, b), joined, tile(blobs, 7, b"b alone"), regions=[region], facts={"aligned": {b: 0.1}})
    remove(database, b)
    assert served(database) == [2, 1]
    assert shown(database, 2, 2) == joined.digest
    publish(database, (a,), alone, dropped_regions=[(3, 4)], dropped_tiles=[("semantic", 18, 7, 2)])
    assert served(database) == [3, 1]
    with pytest.raises(WithdrawnError, match="version 2 of map 'city' held a drive that was removed"):
        shown(database, 2, 1)
    assert [shown(database, number, x) for number in (1, 3) for x in (1, 2)] == 2 * [street.digest, alone.digest]
    with database.read() as session:
        changed, gone = map_versions.changes(session, "city", 3)
        assert [(row.x, row.digest) for row in changed] == [(2, alone.digest)]
        assert [row.x for row in gone] == [7]
    assert drop(database, blobs) == 3
    assert set(blobs.older_than(0.0)) == {street.digest, alone.digest}
    with database.read() as session:
        assert session.scalars(select(RegionRow)).all() == []
        assert {row.drive_id for row in session.scalars(select(MapDrive))} == {a}
        assert session.get_one(MapVersion, ("city", 2)).facts == {}
        assert session.scalars(select(ForgottenBlob)).all() == []


def test_versions_that_held_a_drive_which_had_left_the_map_go_with_it_at_once(database: Database, blobs: BlobStore) -> None:
    a, b = register(database, "a"), register(database, "b")
    publish(database, (a, b), tile(blobs, 1, b"a and b"))
    publish(database, (a, b), tile(blobs, 2, b"more"))
    publish(database, (a,), tile(blobs, 1, b"a"), dropped_tiles=[("semantic", 18, 2, 2)])
    remove(database, b)
    assert served(database) == [3]
    assert drop(database, blobs) == 2
    assert len([*blobs.older_than(0.0)]) == 1


def test_a_drive_that_is_sent_again_before_the_next_version_is_another_one(database: Database, blobs: BlobStore) -> None:
    a = register(database, "a")
    publish(database, (a,), tile(blobs, 1, b"first"))
    remove(database, a)
    assert register(database, "a") == a
    publish(database, (a,), tile(blobs, 1, b"again"))
    assert served(database) == [2]
    publish(database, (a,))
    assert served(database) == [3, 2]
    with database.read() as session:
        assert [(row.since, row.removed) for row in session.scalars(select(MapDrive))] == [(2, False)]
        assert [(row.since, bool(row.digest)) for row in session.scalars(select(TileRow).order_by(TileRow.since))] == [
            (1, False),
            (2, True),
        ]


def test_a_forgotten_blob_waits_for_the_jobs_that_may_be_about_to_name_it(database: Database, blobs: BlobStore) -> None:
    a, b = register(database, "a"), register(database, "b")
    publish(database, (a, b), tile(blobs, 1, b"a and b"))
    publish(database, (a,), tile(blobs, 1, b"a"))
    with database.write() as session:
        other = jobs.create_drive_jobs(session, a).job_id
        stitch = jobs.request_stitch(session, "city").id
    assert jobs.claim(database, other, "w", 60.0) is not None  # stores no tiles
    held = jobs.claim(database, stitch, "w", 60.0)
    assert held is not None
    remove(database, b)
    assert drop(database, blobs) == 0
    with database.write() as session:
        jobs.fail(session, held, "no luck", final=True)
    listed = list(blobs.older_than(0.0))
    assert garbage.drop_forgotten(database, blobs, lambda: listed) == 0
    assert drop(database, blobs) == 1


def test_a_blob_that_others_name_too_is_kept(database: Database, blobs: BlobStore) -> None:
    a, b = register(database, "a"), register(database, "b")
    quality = blobs.put(b"equal")
    with database.write() as session:
        for drive_id in (a, b):
            drives.get(session, drive_id).facts = {"quality": quality}
    remove(database, a)
    assert drop(database, blobs) == 0
    assert blobs.has(quality)
    remove(database, b)
    assert drop(database, blobs) == 1
    assert not blobs.has(quality)


def test_a_version_that_was_never_there_is_not_called_withdrawn(database: Database) -> None:
    publish(database, ())
    with pytest.raises(NotFoundError, match="no version 9"):
        shown(database, 9, 1)
