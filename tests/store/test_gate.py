"""The gate before the map: verdicts, releases, and what they do to a drive in any state."""

import threading

import pytest
from alembic import command
from alembic.config import Config

from wayloom.errors import ConflictError
from wayloom.store import drives, gate, jobs, map_versions, maps
from wayloom.store.database import Database
from wayloom.store.manifest import Manifest, ManifestFile
from wayloom.store.map_versions import NewVersion
from wayloom.store.migrate import migrations_dir, upgrade
from wayloom.store.tables.drives import SubmapRow
from wayloom_workers.completion import complete_drive


def new_drive(database: Database, name: str, grade: str | None, verdict: str, sound: bool = False) -> str:
    """A judged drive with a submap, all of whose stages are done."""
    manifest = Manifest(name=name, files=(ManifestFile(path="log/a", size=1, sha256="0" * 64),))
    with database.write() as session:
        drive = drives.register(session, manifest, "city")[0]
        drive.state, drive.placed = "running", grade is not None
        gate.judge(session, drive.id, grade, ["why"], verdict, sound)  # type: ignore[arg-type]
        row = SubmapRow(
            drive_id=drive.id, map_id="city", position=0, digest=drive.id, point_count=1, frame=[8.5, 49.5, 0.0],
            T_enu_submap=[[1.0, 0.0, 0.0, 5.0]] * 3, covariance=[], min_lon=8.0, min_lat=49.0, max_lon=8.1, max_lat=49.1,
        )  # fmt: skip
        if grade is not None:
            maps.place_submaps(session, drive.id, [row])
        return drive.id


def complete(database: Database, drive_id: str) -> int:
    """How many jobs follow from the drive's last stage."""
    with database.write() as session:
        return len(complete_drive(session, drive_id))


def merged(database: Database) -> set[str]:
    with database.read() as session:
        return {row.drive_id for row in maps.submaps(session, "city")}


def state(database: Database, drive_id: str) -> str:
    with database.read() as session:
        return drives.get(session, drive_id).state


def publish(database: Database, *drive_ids: str, verdicts: dict[str, bool] | None = None, by: int | None = None) -> None:
    """The next version with these drives, by this stitch job, and its verdicts on guests: whether they are admitted."""
    said = {name: {"admitted": admitted, "reason": "placed"} for name, admitted in (verdicts or {}).items()}
    with database.write() as session:
        base = maps.get(session, "city").version
        new = NewVersion(base, (8.5, 49.5, 0.0), drive_ids, 1, None, [], verdicts=said)
        map_versions.publish(session, "city", new, 5, by)


@pytest.mark.parametrize(
    ("grade", "verdict", "ends"),
    [("C", "merge", "stitching"), ("D", "hold", "held"), ("E", "quarantine", "quarantined"), (None, "hold", "held")],
)
def test_only_a_drive_that_passes_goes_on_to_the_map(database: Database, grade: str | None, verdict: str, ends: str) -> None:
    drive_id = new_drive(database, "a", grade, verdict)
    assert complete(database, drive_id) == (ends == "stitching")
    assert state(database, drive_id) == ends
    assert merged(database) == ({drive_id} if ends == "stitching" else set())


def test_a_release_is_kept_and_merges_the_drive_and_taking_it_back_takes_the_drive_out(database: Database) -> None:
    drive_id = new_drive(database, "a", "D", "hold")
    complete(database, drive_id)
    with database.write() as session:
        assert gate.release(session, drive_id, "Ada", "seen on site") is not None
    with database.read() as session:
        drive = drives.get(session, drive_id)
        assert (drive.state, drive.released_by, drive.released_why) == ("stitching", "Ada", "seen on site")
        assert drive.released_at is not None
    assert merged(database) == {drive_id}
    publish(database, drive_id)
    assert state(database, drive_id) == "done"
    with database.write() as session:
        assert gate.revoke(session, drive_id) is not None
    assert (state(database, drive_id), merged(database)) == ("held", set())


def test_a_release_before_the_last_stage_needs_no_map_job_of_its_own(database: Database) -> None:
    drive_id = new_drive(database, "a", "E", "quarantine")
    with database.write() as session:
        assert gate.release(session, drive_id, "Ada", "tunnel") is None
    assert complete(database, drive_id) == 1
    assert state(database, drive_id) == "stitching"


def test_a_drive_released_while_the_map_is_stitched_waits_for_the_next_stitch(database: Database) -> None:
    first, late = new_drive(database, "a", "A", "merge"), new_drive(database, "b", "D", "hold")
    for drive_id in (first, late):
        complete(database, drive_id)
    with database.read() as session:
        running = drives.get(session, first).stitch_job_id
    assert running is not None
    held = jobs.claim(database, running, "worker", 60.0)
    seen = merged(database)
    with database.write() as session:
        following = gate.release(session, late, "Ada", "seen")
    assert following is not None
    assert following.job_id != running
    assert held is not None
    with database.write() as session:
        jobs.finish(session, held, "key")
    publish(database, *seen)
    assert [state(database, drive_id) for drive_id in (first, late)] == ["done", "stitching"]
    publish(database, *merged(database))
    assert state(database, late) == "done"


def test_a_drive_that_a_stitch_under_way_took_in_is_done_by_it_and_not_by_the_later_one_it_asked_for(database: Database) -> None:
    first, late = new_drive(database, "a", "A", "merge"), new_drive(database, "b", "A", "merge")
    complete(database, first)
    with database.read() as session:
        running = drives.get(session, first).stitch_job_id
    assert running is not None
    assert jobs.claim(database, running, "worker", 60.0) is not None
    complete(database, late)
    publish(database, first, late, by=running)
    with database.read() as session:
        rows = [drives.get(session, drive_id) for drive_id in (first, late)]
        assert [(row.state, row.stitch_job_id) for row in rows] == [("done", running)] * 2
        shown = drives.jobs_of(session, rows)
    assert [job.id for job in shown[late] if job.map_id is not None] == [running]


def test_a_release_and_the_drives_last_stage_at_once_end_in_the_map_whoever_is_first(database: Database) -> None:
    for number in range(6):
        drive_id = new_drive(database, f"drive {number}", "D", "hold")
        start = threading.Barrier(2)

        def release(drive_id: str = drive_id, start: threading.Barrier = start) -> None:
            start.wait()
            with database.write() as session:
                gate.release(session, drive_id, "Ada", "seen")

        other = threading.Thread(target=release)
        other.start()
        start.wait()
        complete(database, drive_id)
        other.join()
        assert state(database, drive_id) == "stitching"


def test_a_stricter_verdict_ends_a_release_and_an_equal_one_does_not(database: Database) -> None:
    drive_id = new_drive(database, "a", "D", "hold")
    with database.write() as session:
        gate.release(session, drive_id, "Ada", "seen")
        gate.judge(session, drive_id, "D", ["again"], "hold")
        assert gate.passes(drives.get(session, drive_id))
        gate.judge(session, drive_id, "E", ["worse"], "quarantine")
        drive = drives.get(session, drive_id)
        assert not gate.passes(drive)
        assert drive.reasons == ["worse", "the release by Ada was for a better grade and has lapsed"]


def test_a_merged_drive_that_is_found_worse_leaves_the_map_with_the_next_stitch(database: Database) -> None:
    drive_id = new_drive(database, "a", "A", "merge")
    complete(database, drive_id)
    publish(database, drive_id)
    with database.write() as session:
        gate.judge(session, drive_id, "E", ["a burst"], "quarantine")
    assert complete(database, drive_id) == 1
    assert (state(database, drive_id), merged(database)) == ("quarantined", set())


def test_what_cannot_be_released_is_refused_with_the_reason(database: Database) -> None:
    def refusal(drive_id: str) -> str:
        with pytest.raises(ConflictError) as refused, database.write() as session:
            gate.release(session, drive_id, "Ada", "seen")
        return str(refused.value)

    assert "needs no release" in refusal(new_drive(database, "good", "B", "merge"))
    assert "no place on Earth" in refusal(new_drive(database, "without GNSS", None, "hold"))
    held = new_drive(database, "held", "D", "hold")
    with database.write() as session:
        gate.release(session, held, "Bob", "seen")
    assert "released by Bob already" in refusal(held)
    removed = new_drive(database, "removed", "D", "hold")
    with database.write() as session:
        drives.request_removal(session, removed)
    assert "being removed" in refusal(removed)
    with pytest.raises(ConflictError, match="was not released"), database.write() as session:
        gate.revoke(session, new_drive(database, "never released", "D", "hold"))


def test_drives_of_before_the_gate_stay_in_the_map_and_those_without_a_place_are_held(empty_database: Database) -> None:
    config = Config()
    config.set_main_option("script_location", str(migrations_dir()))
    with empty_database.engine.connect() as connection:
        config.attributes["connection"] = connection
        command.upgrade(config, "0002")
        connection.exec_driver_sql("INSERT INTO maps (id, version, created_at) VALUES ('city', 1, 1)")
        for name, placed in (("placed", "TRUE"), ("nowhere", "FALSE"), ("on its way", "NULL")):
            connection.exec_driver_sql(
                "INSERT INTO drives (id, name, map_id, manifest, file_count, byte_count, state, placed, facts, created_at) "
                f"VALUES ('{name}', '{name}', 'city', '{{}}', 1, 1, 'done', {placed}, '{{}}', 1)"
            )
        connection.commit()
    upgrade(empty_database)
    with empty_database.read() as session:
        found = {
            name: (drives.get(session, name).gate, drives.get(session, name).state) for name in ("placed", "nowhere", "on its way")
        }
    assert found == {"placed": ("merge", "done"), "nowhere": ("hold", "held"), "on its way": (None, "done")}


def test_a_guest_asks_the_map_and_its_verdict_says_how_it_ends(database: Database) -> None:
    guest = new_drive(database, "a", "D", "hold", sound=True)
    assert complete(database, guest) == 1
    assert (state(database, guest), merged(database)) == ("stitching", set())
    publish(database, verdicts={guest: False})
    assert (state(database, guest), merged(database)) == ("held", set())
    publish(database, guest, verdicts={guest: True})
    assert (state(database, guest), merged(database)) == ("done", {guest})
    publish(database, verdicts={guest: False})
    assert (state(database, guest), merged(database)) == ("held", set())


def test_a_guest_that_is_released_while_it_is_asked_waits_for_the_next_version(database: Database) -> None:
    guest = new_drive(database, "a", "D", "hold", sound=True)
    complete(database, guest)
    with database.write() as session:
        assert gate.release(session, guest, "Ada", "seen") is not None
    publish(database, verdicts={guest: False})
    assert (state(database, guest), merged(database)) == ("stitching", {guest})
    publish(database, guest)
    assert state(database, guest) == "done"


def test_an_admitted_drive_that_is_found_broken_leaves_the_map(database: Database) -> None:
    guest = new_drive(database, "a", "D", "hold", sound=True)
    complete(database, guest)
    publish(database, guest, verdicts={guest: True})
    with database.write() as session:
        gate.judge(session, guest, "D", ["broken"], "hold", sound=False)
    assert merged(database) == set()
    assert complete(database, guest) == 1
    assert state(database, guest) == "held"
    assert guest in changed(database)


def changed(database: Database) -> set[str]:
    with database.read() as session:
        return {*map_versions.changed_drives(session, "city")}


def test_submaps_without_a_place_touch_no_box_are_near_nobody_and_still_call_for_a_stitch(database: Database) -> None:
    nowhere, here = new_drive(database, "a", "D", "hold", sound=True), new_drive(database, "b", "A", "merge")
    row = SubmapRow(
        drive_id=nowhere, map_id="city", position=0, digest=nowhere, point_count=1, located=False, frame=None,
        T_enu_submap=[[1.0, 0.0, 0.0, 5.0]] * 3, covariance=[],
    )  # fmt: skip
    with database.write() as session:
        maps.place_submaps(session, nowhere, [row])
        drives.get(session, nowhere).admitted = True
        session.flush()
        box = session.get_one(SubmapRow, (here, 0))
        box.near_min_lon, box.near_min_lat, box.near_max_lon, box.near_max_lat = -180.0, -90.0, 180.0, 90.0
    assert nowhere in changed(database)
    assert merged(database) == {here}
    with database.read() as session:
        assert {one.drive_id for one in maps.submaps(session, "city", (-180.0, -90.0, 180.0, 90.0), with_guests=True)} == {here}
        assert maps.candidates(session, "city") == sorted((here, nowhere))
        assert maps.candidates_near(session, here) == maps.candidates_near(session, nowhere) == []
        place = next(one for one in maps.places(session, "city") if one.drive_id == nowhere)
        assert (place.frame, place.box, place.is_guest, place.located) == (None, None, True, False)
        assert None in map_versions.changed_boxes(session, "city").values()


@pytest.mark.parametrize(("one", "other", "near"), [((0.0, 1.0), (1.0, 2.0), True), ((0.0, 1.0), (1.1, 2.0), False),
                                                  ((179.0, 180.5), (-179.6, -179.0), True)])  # fmt: skip
def test_drives_are_near_each_other_by_both_their_own_boxes_whoever_asks(
    database: Database, one: tuple[float, float], other: tuple[float, float], near: bool
) -> None:
    ids = [new_drive(database, name, "A", "merge") for name in "ab"]
    with database.write() as session:
        for drive_id, (west, east) in zip(ids, (one, other), strict=True):
            row = session.get_one(SubmapRow, (drive_id, 0))
            row.near_min_lon, row.near_max_lon, row.near_min_lat, row.near_max_lat = west, east, 10.0, 10.1
    with database.read() as session:
        found = [list(maps.candidates_near(session, drive_id)) for drive_id in ids]
    assert found == ([[ids[1]], [ids[0]]] if near else [[], []])
