"""The service's map drops what has gone and lists it with the drives that are the evidence, as long as these are in the map."""

from pathlib import Path

import pytest

from stitching.made_sights import Passing, drawn, driven
from wayloom.dense.files import LOOKS_FILE, save_looks
from wayloom.store import drives, gate, map_versions, maps
from wayloom.store.jobs import new_job
from wayloom.store.manifest import Manifest, ManifestFile
from wayloom_workers.production import submap_row
from wayloom_workers.stage_hooks import WorkerContext
from workers.test_stitching import other_service, published

STANDS, IS_GONE = Passing(0), Passing(1, pole=False)


def add(context: WorkerContext, way: Passing, looks: bool = True) -> str:
    """A processed drive of grade A, with what its stage of looks left."""
    with context.database.write() as session:
        manifest = Manifest(name=way.drive_id, files=(ManifestFile(path="log/a", size=1, sha256="0" * 64),))
        drive_id = drives.register(session, manifest, "city")[0].id
        item = driven(way)
        context.blobs.put(item.submap.encoded)
        if looks:
            session.add(new_job("looks", 0.0, state="done", drive_id=drive_id, position=0, payload={"key": "key"}))
            save_looks(drawn(way), looks_file(context, drive_id))
        maps.place_submaps(session, drive_id, [submap_row(drive_id, "city", 0, item)])
        gate.judge(session, drive_id, "A", [], "merge")
    return drive_id


def looks_file(context: WorkerContext, drive_id: str) -> Path:
    folder = context.folders.drive(drive_id) / "stages" / "looks" / "key"
    folder.mkdir(parents=True, exist_ok=True)
    return folder / LOOKS_FILE


def things(context: WorkerContext) -> list[dict[str, object]]:
    with context.database.read() as session:
        return map_versions.changed_things(session, "city")


def test_what_has_gone_is_listed_until_its_evidence_goes(context: WorkerContext, tmp_path: Path) -> None:
    one = add(context, STANDS)
    alone = published(context, tmp_path / "1")
    assert things(context) == []
    two = add(context, IS_GONE)
    published(context, tmp_path / "2")
    (thing,) = things(context)
    said = thing["properties"]
    assert (said["kind"], said["class"], said["seen_by"], said["seen_through_by"]) == ("gone", "pole", [one], [two])
    assert said["last_seen"] < said["noticed"] == said["first_seen_through"]
    with context.database.read() as session:
        assert map_versions.things_of_version(session, "city", 2) == ([thing], [])
        assert map_versions.things_of_version(session, "city", 1) == ([], [])
    with context.database.write() as session:
        drives.request_removal(session, two)
    assert published(context, tmp_path / "3") == alone
    assert things(context) == []
    with context.database.read() as session:
        assert map_versions.things_of_version(session, "city", 3) == ([], [thing])


def test_the_order_of_arrival_changes_no_byte(context: WorkerContext, tmp_path: Path) -> None:
    add(context, STANDS)
    published(context, tmp_path / "1")
    add(context, IS_GONE)
    after = published(context, tmp_path / "2")
    other = other_service(context, tmp_path / "other")
    add(other, IS_GONE)
    published(other, tmp_path / "3")
    add(other, STANDS)
    assert published(other, tmp_path / "4") == after
    assert things(other) == things(context)
    other.database.close()


@pytest.mark.parametrize("kept", ["without the stage", "without its file", "with a damaged file"])
def test_a_drive_without_looks_is_in_the_map_and_no_witness(context: WorkerContext, tmp_path: Path, kept: str) -> None:
    add(context, STANDS)
    two = add(context, IS_GONE, looks=kept != "without the stage")
    if kept == "without its file":
        looks_file(context, two).unlink()
    if kept == "with a damaged file":
        looks_file(context, two).write_bytes(b"WLLOOKS")
    said = published(context, tmp_path / "1")
    assert said["about"][2] == 2
    assert things(context) == []


def test_a_drive_that_looks_anew_has_its_regions_made_anew(context: WorkerContext, tmp_path: Path) -> None:
    add(context, STANDS)
    two = add(context, IS_GONE, looks=False)
    published(context, tmp_path / "1")
    save_looks(drawn(IS_GONE), looks_file(context, two))
    with context.database.write() as session:
        session.add(new_job("looks", 0.0, state="done", drive_id=two, position=0, payload={"key": "key"}))
        maps.place_submaps(session, two, [submap_row(two, "city", 0, driven(IS_GONE))])
    published(context, tmp_path / "2")
    assert len(things(context)) == 1
