"""Which blobs are dropped, and which never are."""

import hashlib
from collections.abc import Iterator
from pathlib import Path

import pytest

from wayloom.store import drives, garbage, jobs, map_versions, maps
from wayloom.store.blobs import BlobStore
from wayloom.store.database import Database
from wayloom.store.garbage import drop_unused
from wayloom.store.manifest import Manifest, ManifestFile
from wayloom.store.map_versions import NewVersion, TileEntry
from wayloom.store.tables.drives import SubmapRow


@pytest.fixture(params=["folder", "memory"])
def blobs(request: pytest.FixtureRequest, tmp_path: Path) -> BlobStore:
    return BlobStore(tmp_path / "blobs", "memory:///" if request.param == "memory" else None)


def new_drive(database: Database) -> str:
    manifest = Manifest(name="a", files=(ManifestFile(path="log/a", size=1, sha256="0" * 64),))
    with database.write() as session:
        return drives.register(session, manifest, "city")[0].id


def publish(database: Database, digest: str, kept: int) -> None:
    tile = TileEntry("semantic", 18, 1, 2, digest, "image/png", 1)
    with database.write() as session:
        base = maps.ensure_map(session, "city").version
        map_versions.publish(session, "city", NewVersion(base, (8.5, 49.5, 0.0), (), 1, None, [tile]), kept)


def test_a_tile_lives_as_long_as_a_version_that_shows_it(database: Database, blobs: BlobStore) -> None:
    old, both, new = (blobs.put(content) for content in (b"old", b"both", b"new"))
    for digest in (old, both, new, both):
        publish(database, digest, kept=3)
    assert drop_unused(database, blobs, list, grace_s=0.0) == 1
    assert [blobs.has(digest) for digest in (old, both, new)] == [False, True, True]
    publish(database, both, kept=1)
    assert drop_unused(database, blobs, list, grace_s=0.0) == 1
    assert list(blobs.older_than(0.0)) == [both]


def test_a_drives_submaps_and_picture_go_with_the_drive(database: Database, blobs: BlobStore) -> None:
    drive_id, submap, picture = new_drive(database), blobs.put(b"points"), blobs.put(b"picture")
    quality = blobs.put(b"quality")
    with database.write() as session:
        row = SubmapRow(
            drive_id=drive_id, map_id="city", position=0, digest=submap, point_count=1, frame=[8.5, 49.5, 0.0],
            T_enu_submap=[], covariance=[], min_lon=8.0, min_lat=49.0, max_lon=8.1, max_lat=49.1,
        )  # fmt: skip
        maps.place_submaps(session, drive_id, [row])
        drives.get(session, drive_id).facts = {"preview": picture, "quality": quality, "log": {"frames": 3}}
    assert drop_unused(database, blobs, list, grace_s=0.0) == 0
    with database.write() as session:
        drives.delete_rows(session, drive_id)
    assert drop_unused(database, blobs, list, grace_s=0.0) == 3


def test_tiles_that_wait_for_their_publication_and_young_blobs_are_kept(database: Database, blobs: BlobStore) -> None:
    listed = blobs.put(b"stitched, not yet published")
    assert drop_unused(database, blobs, lambda: [listed], grace_s=0.0) == 0
    assert drop_unused(database, blobs, list, grace_s=60.0) == 0
    assert blobs.has(listed)


def test_nothing_is_dropped_while_a_job_that_stores_blobs_is_running(database: Database, blobs: BlobStore) -> None:
    blobs.put(b"of a job that has not said so yet")
    with database.write() as session:
        maps.ensure_map(session, "city")
        job_id = jobs.create_map_job(session, "stitch", "city").id
    held = jobs.claim(database, job_id, "elsewhere|1|1", 60.0)
    assert held is not None
    assert drop_unused(database, blobs, list, grace_s=0.0) == 0
    with database.write() as session:
        jobs.finish(session, held, "k")
    assert drop_unused(database, blobs, list, grace_s=0.0) == 1


def test_a_job_that_is_claimed_during_the_look_stops_the_dropping(
    database: Database, blobs: BlobStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(garbage, "BATCH", 1)
    for content in (b"1", b"2", b"3"):
        blobs.put(content)
    with database.write() as session:
        maps.ensure_map(session, "city")
        job_id = jobs.create_map_job(session, "stitch", "city").id

    def claimed_meanwhile() -> Iterator[str]:
        held = jobs.claim(database, job_id, "elsewhere|1|1", 60.0)
        assert held is not None
        with database.write() as session:
            jobs.finish(session, held, "k")
        yield "f" * 64

    assert drop_unused(database, blobs, claimed_meanwhile, grace_s=0.0) == 0
    assert len(list(blobs.older_than(0.0))) == 3


def test_what_is_no_blob_is_left_alone(database: Database, tmp_path: Path) -> None:
    blobs = BlobStore(tmp_path / "blobs")
    digest = hashlib.sha256(b"x").hexdigest()
    strangers = [tmp_path / "blobs" / name for name in ("readme", f"zz/{digest}", f"{digest[:2]}/{digest}.part")]
    for path in strangers:
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(b"x")
    assert drop_unused(database, blobs, list, grace_s=0.0) == 0
    assert all(path.exists() for path in strangers)
