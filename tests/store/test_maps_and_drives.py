"""Drives, their files, and the versions of the map."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sqlalchemy import select

from wayloom.errors import ConflictError, NotFoundError
from wayloom.store import drives, gate, history, map_versions, maps, uploads
from wayloom.store.database import Database, Session
from wayloom.store.folders import Folders
from wayloom.store.manifest import Manifest, ManifestFile
from wayloom.store.map_versions import OUT_OF_REACH, NewVersion, RegionEntry, TileEntry, TileKey
from wayloom.store.tables.drives import SubmapRow
from wayloom.store.tables.maps import ChangedBox, MapDrive, RegionRow, TileRow

TILE = TileEntry("semantic", 18, 1, 2, "a" * 64, "image/png", 100)


def manifest(name: str, count: int = 3) -> Manifest:
    return Manifest(
        name=name, vehicle_id="car 7", files=tuple(ManifestFile(path=f"log/{i}", size=i, sha256="0" * 64) for i in range(count))
    )


def register(database: Database, name: str) -> str:
    with database.write() as session:
        drive_id = drives.register(session, manifest(name), "city")[0].id
        gate.judge(session, drive_id, "A", [], "merge")
        return drive_id


def version(*tiles: TileEntry, drives: tuple[str, ...] = (), base: int = 0, dropped: tuple[TileKey, ...] = ()) -> NewVersion:
    return NewVersion(base, (8.5, 49.5, 0.0), drives, 1, (8.0, 49.0, 8.1, 49.1), tiles, dropped)


def told(session: Session, drive_id: str) -> list[tuple[str, str, str]]:
    """The drive's history: stage, what, text; oldest first."""
    return [(row.stage, row.what, row.text) for row in reversed(history.of_drive(session, drive_id, 100))]


def publish_and_fail(database: Database) -> None:
    with database.write() as session:
        map_versions.publish(session, "city", version(replace(TILE, digest="b" * 64), base=1), kept=2)
        raise ConflictError("the power fails here")


def test_the_same_manifest_again_is_the_same_drive(database: Database) -> None:
    with database.write() as session:
        first, new = drives.register(session, manifest("a"), "city")
        again, new_again = drives.register(session, manifest("a"), "city")
    assert (new, new_again) == (True, False)
    assert first.id == again.id == manifest("a").drive_id


def test_the_drive_is_queued_when_its_last_file_has_arrived_and_only_then(database: Database) -> None:
    drive_id = register(database, "a")
    with database.write() as session:
        assert drives.mark_complete(session, drive_id, "log/0") is None
        assert drives.mark_complete(session, drive_id, "log/1") is None
        assert [path for path, _, _ in drives.missing_files(session, drive_id)] == ["log/2"]
        assert drives.received(session, [drives.get(session, drive_id)]) == {drive_id: drives.Received(2, 1)}
        assert drives.mark_complete(session, drive_id, "log/2") is not None
        assert drives.mark_complete(session, drive_id, "log/2") is None
        assert drives.get(session, drive_id).state == "queued"
        assert drives.received(session, [drives.get(session, drive_id)]) == {drive_id: drives.Received(3, 3)}


def test_an_unknown_drive_is_said_to_be_unknown(database: Database) -> None:
    with pytest.raises(NotFoundError), database.read() as session:
        drives.get(session, "f" * 64)


def test_publishing_flips_the_pointer_and_finishes_the_drives_that_wait(database: Database) -> None:
    drive_id, other = register(database, "a"), register(database, "b")
    with database.write() as session:
        for waiting in (drive_id, other):
            row = drives.get(session, waiting)
            row.state, row.stitch_job_id = "stitching", 1
        assert map_versions.publish(session, "city", version(TILE, drives=(drive_id,)), kept=5) == 1
    with database.read() as session:
        assert maps.get(session, "city").version == 1
        found = maps.version(session, "city")
        assert found.layers == {
            "semantic": {"min_zoom": 18, "max_zoom": 18, "media_type": "image/png", "tiles": 1, "zooms": {"18": 1}}
        }
        assert drives.get(session, drive_id).state == "done"
        assert drives.get(session, other).state == "stitching"
        tile = maps.tile(session, "city", 1, "semantic", 18, 1, 2)
        assert tile is not None
        assert tile.digest == TILE.digest
        assert maps.tile(session, "city", 1, "semantic", 18, 2, 1) is None


def test_a_drive_that_a_later_map_job_takes_in_is_done_though_its_own_had_failed(database: Database) -> None:
    drive_id, broken = register(database, "a"), register(database, "b")
    with database.write() as session:
        row = drives.get(session, drive_id)
        row.state, row.stitch_job_id, row.error = "failed", 1, "publish: the disk was full"
        drives.get(session, broken).state = "failed"
        map_versions.publish(session, "city", version(TILE, drives=(drive_id, broken)), kept=5)
    with database.read() as session:
        assert (drives.get(session, drive_id).state, drives.get(session, drive_id).error) == ("done", None)
        assert drives.get(session, broken).state == "failed"
        assert told(session, drive_id) == [("publish", "done", "the drive is in the map since version 1")]
        assert told(session, broken) == []


def test_a_drive_out_of_the_maps_reach_fails_and_says_why(database: Database) -> None:
    drive_id = register(database, "a")
    with database.write() as session:
        row = drives.get(session, drive_id)
        row.state, row.stitch_job_id = "stitching", 1
        map_versions.publish(session, "city", replace(version(TILE), out_of_reach=(drive_id,)), kept=5)
    with database.read() as session:
        row = drives.get(session, drive_id)
        assert (row.state, row.error) == ("failed", OUT_OF_REACH)
        assert told(session, drive_id) == [("publish", "failed", OUT_OF_REACH)]


def test_nothing_published_and_no_map_are_told_apart(database: Database) -> None:
    with database.write() as session:
        maps.ensure_map(session, "city")
    with database.read() as session:
        with pytest.raises(NotFoundError, match="nothing has been published"):
            maps.version(session, "city")
        with pytest.raises(NotFoundError, match="there is no map"):
            maps.version(session, "elsewhere")
        with pytest.raises(NotFoundError, match="no version 7"):
            maps.version(session, "city", 7)


def test_old_versions_are_forgotten_with_their_tiles(database: Database) -> None:
    with database.write() as session:
        maps.ensure_map(session, "city")
        for base in range(4):
            map_versions.publish(session, "city", version(replace(TILE, digest=str(base) * 64), base=base), kept=2)
        assert [row.version for row in maps.versions(session, "city")] == [4, 3]
        assert maps.tile(session, "city", 2, "semantic", 18, 1, 2) is None
        for number in (3, 4):
            tile = maps.tile(session, "city", number, "semantic", 18, 1, 2)
            assert tile is not None
            assert tile.digest == str(number - 1) * 64
        assert len(session.scalars(select(TileRow)).all()) == 2


def test_a_version_costs_what_it_changes_and_every_kept_one_is_read_whole(database: Database) -> None:
    """300 tiles, then five versions that each change one, drop one and bring one."""
    rng = np.random.default_rng(0)
    shown = {x: replace(TILE, x=x, digest=f"{x:064d}") for x in range(300)}
    expected = [dict(shown)]
    with database.write() as session:
        maps.ensure_map(session, "city")
        map_versions.publish(session, "city", version(*shown.values()), kept=9)
        for base in range(1, 6):
            changed, gone, new = int(rng.choice(sorted(shown))), int(rng.choice(sorted(shown))), 300 + base
            shown.pop(gone)
            entries = [replace(TILE, x=x, digest=f"{x + 1000 * base:064d}") for x in {changed, new} - {gone}]
            shown |= {entry.x: entry for entry in entries}
            dropped = (("semantic", 18, gone, 2),)
            map_versions.publish(session, "city", version(*entries, base=base, dropped=dropped), kept=9)
            expected.append(dict(shown))
            came, ended = map_versions.changes(session, "city", base + 1)
            assert {row.x: row.digest for row in came} == {entry.x: entry.digest for entry in entries}
            assert [row.x for row in ended] == [gone]
    with database.read() as session:
        assert len(session.scalars(select(TileRow)).all()) <= 300 + 5 * 2
        for number, tiles in enumerate(expected, 1):
            rows = {x: maps.tile(session, "city", number, "semantic", 18, x, 2) for x in range(310)}
            assert {x: row.digest for x, row in rows.items() if row} == {x: entry.digest for x, entry in tiles.items()}
            found = maps.version(session, "city", number)
            assert (found.tile_count, found.byte_count) == (len(tiles), 100 * len(tiles))
        assert map_versions.current_tiles(session, "city", [entry.key for entry in tiles.values()]) == {
            entry.key: entry for entry in tiles.values()
        }


def test_regions_and_drives_are_shared_by_versions_like_tiles(database: Database) -> None:
    first, second = register(database, "a"), register(database, "b")
    region = RegionEntry(3, -4, "1" * 64, "2" * 64, [[first, "3" * 64]], 10)
    with database.write() as session:
        map_versions.publish(session, "city", replace(version(drives=(first,)), regions=[region]), kept=2)
        map_versions.publish(session, "city", version(drives=(first, second), base=1), kept=2)
        assert map_versions.current_regions(session, "city") == {(3, -4): region}
        assert map_versions.current_regions(session, "city", [(0, 0)]) == {}
        map_versions.publish(session, "city", replace(version(drives=(second,), base=2), dropped_regions=[(3, -4)]), kept=2)
        assert map_versions.current_regions(session, "city") == {}
        assert map_versions.region_made_from(session, "city", (3, -4), "1" * 64) == region
        assert [list(maps.drives_of(session, "city", number)) for number in (2, 3)] == [sorted([first, second]), [second]]
        map_versions.publish(session, "city", version(drives=(second,), base=3), kept=1)
        assert map_versions.region_made_from(session, "city", (3, -4), "1" * 64) is None
        assert session.scalars(select(RegionRow)).all() == []
        assert [row.drive_id for row in session.scalars(select(MapDrive))] == [second]


def test_a_version_stitched_from_an_older_one_than_the_newest_is_refused(database: Database) -> None:
    with database.write() as session:
        maps.ensure_map(session, "city")
        map_versions.publish(session, "city", version(TILE), kept=2)
        with pytest.raises(ConflictError, match="version 1 was published while the changes of 0 were stitched"):
            map_versions.publish(session, "city", version(TILE), kept=2)


def test_where_submaps_come_go_and_are_let_in_the_map_has_changed_until_a_version_takes_it_in(database: Database) -> None:
    drive_id = register(database, "a")

    def boxes() -> list[float]:
        with database.read() as session:
            return [box[0] for box in map_versions.changed_boxes(session, "city").values()]

    def row(west: float) -> SubmapRow:
        return SubmapRow(
            drive_id=drive_id, map_id="city", position=0, digest="0" * 64, point_count=1, frame=[8.5, 49.5, 0.0], T_enu_submap=[],
            covariance=[], min_lon=west, min_lat=49.0, max_lon=west + 0.1, max_lat=49.1,
        )  # fmt: skip

    with database.write() as session:
        maps.place_submaps(session, drive_id, [row(8.0)])
    assert boxes() == [8.0]
    with database.write() as session:
        maps.place_submaps(session, drive_id, [row(9.0)])
    assert boxes() == [8.0, 8.0, 9.0]
    with database.write() as session:
        taken_in = [*map_versions.changed_boxes(session, "city")]
        gate.judge(session, drive_id, "E", ["worse"], "quarantine")
        map_versions.publish(session, "city", replace(version(), taken_in=taken_in), kept=2)
    assert boxes() == [9.0]
    with database.write() as session:
        gate.judge(session, drive_id, "E", ["as bad"], "quarantine")
    assert boxes() == [9.0]
    with database.write() as session:
        session.execute(ChangedBox.__table__.delete())  # type: ignore[attr-defined]
        drives.request_removal(session, drive_id)
    assert boxes() == [9.0]
    with database.write() as session:
        drives.delete_rows(session, drive_id)
    assert boxes() == [9.0, 9.0]


def test_the_coverage_is_of_the_deepest_zoom_that_is_asked_for_and_names_a_place_once(database: Database) -> None:
    def at(layer: str, z: int, x: int) -> TileEntry:
        return replace(TILE, layer=layer, z=z, x=x)

    tiles = [at("semantic", 15, 7), at("semantic", 16, 5), at("features", 16, 4), at("features", 16, 5), at("semantic", 18, 9)]
    with database.write() as session:
        maps.ensure_map(session, "city")
        assert maps.coverage(session, "city", 17) == (0, [])
        map_versions.publish(session, "city", version(at("semantic", 16, 1)), kept=2)
        map_versions.publish(session, "city", version(*tiles, base=1, dropped=(("semantic", 16, 1, 2),)), kept=2)
        assert maps.coverage(session, "city", 17) == (16, [(4, 2), (5, 2)])


def test_a_version_that_fails_to_be_written_leaves_the_old_one(database: Database) -> None:
    with database.write() as session:
        maps.ensure_map(session, "city")
        map_versions.publish(session, "city", version(TILE), kept=2)
    with pytest.raises(ConflictError, match="power"):
        publish_and_fail(database)
    with database.read() as session:
        assert maps.get(session, "city").version == 1
        with pytest.raises(NotFoundError, match="no version 2"):
            maps.version(session, "city", 2)
        assert [(row.since, row.until, row.digest) for row in session.scalars(select(TileRow))] == [(1, None, TILE.digest)]


def test_submaps_of_a_box_are_those_that_a_look_at_each_one_finds(database: Database) -> None:
    drive_id = register(database, "a")
    rng = np.random.default_rng(7)
    corners = rng.uniform(8.0, 9.0, (60, 2))
    boxes = np.hstack([corners, corners + rng.uniform(0.0, 0.2, (60, 2))])
    rows = [
        SubmapRow(
            drive_id=drive_id, map_id="city", position=i, digest=f"{i:064}", point_count=1, frame=[8.5, 49.5, 0.0],
            T_enu_submap=np.eye(4).tolist(), covariance=np.eye(6).tolist(),
            min_lon=box[0], min_lat=box[1], max_lon=box[2], max_lat=box[3],
        )
        for i, box in enumerate(boxes.tolist())
    ]  # fmt: skip
    with database.write() as session:
        maps.place_submaps(session, drive_id, rows)
    for _ in range(20):
        west, south, width, height = rng.uniform(8.0, 9.0, 2).tolist() + rng.uniform(0.0, 0.3, 2).tolist()
        east, north = west + width, south + height
        expected = {i for i, box in enumerate(boxes) if box[0] <= east and box[2] >= west and box[1] <= north and box[3] >= south}
        with database.read() as session:
            assert {row.position for row in maps.submaps(session, "city", (west, south, east, north))} == expected


def test_placing_submaps_again_replaces_them(database: Database) -> None:
    drive_id = register(database, "a")
    for count in (3, 2):
        rows = [
            SubmapRow(
                drive_id=drive_id, map_id="city", position=i, digest=f"{i:064}", point_count=1, frame=[8.5, 49.5, 0.0],
                T_enu_submap=[], covariance=[], min_lon=8.0, min_lat=49.0, max_lon=8.1, max_lat=49.1,
            )
            for i in range(count)
        ]  # fmt: skip
        with database.write() as session:
            maps.place_submaps(session, drive_id, rows)
    with database.write() as session:
        assert len(maps.submaps(session, "city")) == 2
        drives.delete_rows(session, drive_id)
        assert len(maps.submaps(session, "city")) == 0


def test_the_bytes_of_an_expired_upload_go_first_and_its_row_an_hour_later(database: Database, tmp_path: Path) -> None:
    drive_id, folders = register(database, "a"), Folders(tmp_path)
    with database.write() as session:
        old = uploads.create(session, drive_id, "log/1", 1, "", expiry_s=-1.0).id
        fresh = uploads.create(session, drive_id, "log/2", 2, "", expiry_s=60.0).id
    for upload_id in (old, fresh):
        folders.uploads.mkdir(exist_ok=True)
        uploads.part(folders, upload_id).path.write_bytes(b"x")
    with database.write() as session:
        assert [upload.id for upload in uploads.unfinished(session, drive_id)] == [fresh]
        assert uploads.drop_expired(session, folders) == 0
        assert uploads.find(session, old).path == "log/1"
        assert uploads.drop_expired(session, folders, grace_s=0.0) == 1
    assert not uploads.part(folders, old).path.exists()
    assert uploads.part(folders, fresh).path.exists()
    with database.read() as session, pytest.raises(NotFoundError):
        uploads.find(session, old)


def test_bytes_whose_drive_was_removed_meanwhile_are_dropped(database: Database, tmp_path: Path) -> None:
    drive_id, folders = register(database, "a"), Folders(tmp_path)
    with database.write() as session:
        upload_id = uploads.create(session, drive_id, "log/1", 1, "", expiry_s=60.0).id
        drives.delete_rows(session, drive_id)
    folders.uploads.mkdir()
    late = (uploads.part(folders, upload_id), uploads.staged_part(folders, upload_id))
    for part in late:
        part.path.write_bytes(b"x")
    with database.write() as session:
        uploads.drop_expired(session, folders)
    assert [part.path.exists() for part in late] == [False, False]


def test_the_row_of_a_finished_upload_goes_as_soon_as_it_expires(database: Database, tmp_path: Path) -> None:
    drive_id = register(database, "a")
    with database.write() as session:
        upload = uploads.create(session, drive_id, "log/1", 1, "", expiry_s=-1.0)
        upload.complete = True
    with database.write() as session:
        assert uploads.drop_expired(session, Folders(tmp_path)) == 1


@pytest.mark.parametrize(("drive", "path"), [("x\0", "log/1"), ("known", "log/1\0"), ("known", "log/other"), ("f" * 64, "log/1")])
def test_an_upload_of_what_no_manifest_names_is_not_found(database: Database, drive: str, path: str) -> None:
    drive_id = register(database, "a")
    with database.write() as session, pytest.raises(NotFoundError):
        uploads.create(session, drive_id if drive == "known" else drive, path, 1, "", 60.0)
    with database.read() as session, pytest.raises(NotFoundError):
        uploads.find(session, "x\0")
