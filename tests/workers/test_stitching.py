"""The map's tiles depend on which drives are in it: not on which came first, nor on what was there before."""

import json
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sqlalchemy import select

from wayloom.config.gate import gate_of
from wayloom.config.progress import silent
from wayloom.geodesy import wgs84
from wayloom.geodesy.map_frame import MapFrame, map_frame_for
from wayloom.pipeline.settings import WayloomSettings
from wayloom.stitching.settings import MergeSettings
from wayloom.store import drives, garbage, gate, jobs, map_versions, maps, meetings, sweep
from wayloom.store.jobs import Claim, JobMessage
from wayloom.store.manifest import Manifest, ManifestFile
from wayloom.store.migrate import upgrade
from wayloom.store.tables.maps import MeetingRow, TileRow
from wayloom.submaps.submap import PlacedSubmap, Submap
from wayloom_workers import region_merging
from wayloom_workers.__main__ import make_context
from wayloom_workers.production import stage_hooks
from wayloom_workers.publishing import TILES_FILE, listed_tiles, publish, tidy
from wayloom_workers.runner import run_job
from wayloom_workers.stage_hooks import StageAttempt, WorkerContext
from wayloom_workers.stitching import stitch
from wayloom_workers.submap_rows import submap_row

LON, LAT = 8.4, 48.9995


def placed(drive_id: str, seed: int, lat: float = LAT, classes: tuple[int, ...] = (0, 1, 2, 8)) -> PlacedSubmap:
    """A street of 60 m with 500 points of some classes, in the frame of its own cell."""
    rng = np.random.default_rng(seed)
    xyz = (rng.uniform(-1.0, 1.0, (500, 3)) * (30.0, 30.0, 2.0)).astype(np.float32)
    label = rng.choice(classes, 500).astype(np.uint8)
    submap = Submap(
        xyz=xyz, label=label, variance=np.full(500, 0.01, np.float32), grey=np.zeros(500, np.uint8), seen_ns=np.arange(500),
        keyframe=np.zeros(500, np.uint32), vote_start=np.arange(501, dtype=np.uint32), vote_class=label,
        vote_weight=np.full(500, 0.1, np.float32), keyframe_frame=np.arange(2, dtype=np.uint32),
        keyframe_t_ns=np.array([0, 10**9]), T_submap_cam=np.stack([np.eye(4), np.eye(4)]), length_m=60.0, points_left_out={},
    )  # fmt: skip
    submap.T_submap_cam[1, 0, 3] = 30.0
    frame = map_frame_for(LON, lat)
    T_enu_submap = np.eye(4)
    T_enu_submap[:3, 3] = wgs84.enu_from_lonlatheight(np.array([[LON, lat, 110.0]]), frame)[0]
    return PlacedSubmap(submap, T_enu_submap, np.eye(6) * 0.01, drive_id, frame)


def add(
    context: WorkerContext, name: str, seed: int, lat: float = LAT, grade: str = "A", classes: tuple[int, ...] = (0, 1, 2, 8)
) -> str:
    """A drive of a grade, with one placed submap."""
    with context.database.write() as session:
        manifest = Manifest(name=name, files=(ManifestFile(path="log/a", size=1, sha256="0" * 64),))
        drive_id = drives.register(session, manifest, "city")[0].id
        item = placed(drive_id, seed, lat, classes)
        context.blobs.put(item.submap.encoded)
        maps.place_submaps(session, drive_id, [submap_row(drive_id, "city", 0, item)])
        gate.judge(session, drive_id, grade, [], gate_of(grade))
    return drive_id


def stitched(context: WorkerContext, out_dir: Path) -> dict[str, object]:
    """What `stitch` writes for the map as it is: what changes since the newest version."""
    out_dir.mkdir()
    stitch(attempt(context, "stitch", out_dir))
    found: dict[str, object] = json.loads((out_dir / TILES_FILE).read_text())
    return found


def attempt(context: WorkerContext, stage: str, folder: Path) -> StageAttempt:
    return StageAttempt(context, Claim(1, 1, stage, 1, None, "city", {}), None, None, folder, {}, folder, silent)


def published(context: WorkerContext, folder: Path) -> dict[str, object]:
    """The next version of the map, whole: its tiles, counts and regions, and what it says of itself."""
    folder.mkdir()
    said = stitched(context, folder / "stitch")
    with context.database.write() as session:
        publish(session, attempt(context, "publish", folder))
    return newest(context) | {"out_of_reach": said["out_of_reach"]}


def newest(context: WorkerContext) -> dict[str, object]:
    with context.database.read() as session:
        version = maps.version(session, "city")
        assert map_versions.changed_boxes(session, "city") == {}
        regions = map_versions.current_regions(session, "city")
        return {
            "tiles": {key: entry.digest for key, entry in map_versions.all_current_tiles(session, "city").items()},
            "regions": {key: (entry.digest, entry.inputs, entry.members) for key, entry in regions.items()},
            "drives": list(maps.drives_of(session, "city", version.version)),
            "about": (version.frame, version.submap_count, version.drive_count, version.bounds, version.layers, version.tile_count),
            "bytes": version.byte_count,
        }


def other_service(context: WorkerContext, tmp_path: Path) -> WorkerContext:
    """An empty one on SQLite with the same tiles."""
    made = make_context(WayloomSettings(data_dir=tmp_path, tiles=context.settings.tiles))
    upgrade(made.database)
    return made


def test_the_order_in_which_drives_came_changes_no_byte(context: WorkerContext, tmp_path: Path) -> None:
    """Neither the order of drives within one version, nor how many versions they came in."""
    other, third = other_service(context, tmp_path / "other"), other_service(context, tmp_path / "third")
    for name, seed in (("a", 1), ("b", 2), ("c", 3)):
        add(context, name, seed, lat=LAT + 0.0004 * seed)
    at_once = published(context, tmp_path / "1")
    for name, seed in (("c", 3), ("a", 1), ("b", 2)):
        add(other, name, seed, lat=LAT + 0.0004 * seed)
        one_by_one = published(other, tmp_path / f"2{name}")
    for names in (("b", 2), ("c", 3)), (("a", 1),):
        for name, seed in names:
            add(third, name, seed, lat=LAT + 0.0004 * seed)
        in_two = published(third, tmp_path / f"3{len(names)}")
    assert at_once == one_by_one == in_two
    assert len(at_once["tiles"]) > 50  # type: ignore[arg-type]
    other.database.close()
    third.database.close()


def test_a_map_from_which_a_drive_was_removed_is_the_map_without_it(context: WorkerContext, tmp_path: Path) -> None:
    add(context, "a", 1)
    without = published(context, tmp_path / "1")
    removed = add(context, "b", 2, lat=LAT + 0.0003)
    assert published(context, tmp_path / "2") != without
    with context.database.write() as session:
        drives.request_removal(session, removed)
    assert published(context, tmp_path / "3") == without
    with context.database.write() as session:
        drives.delete_rows(session, removed)
    assert published(context, tmp_path / "4") == without
    other = other_service(context, tmp_path / "other")
    add(other, "a", 1)
    assert published(other, tmp_path / "5") == without
    other.database.close()


def test_adding_a_drive_makes_only_the_regions_and_tiles_that_it_touches(context: WorkerContext, tmp_path: Path) -> None:
    """Beside 1 drive, and beside 12 on other streets."""
    add(context, "a", 1)
    published(context, tmp_path / "1")
    sizes = []
    for count in (1, 12):
        for seed in range(100, 100 + count):
            add(context, f"other {count} {seed}", seed, lat=LAT + 0.002 * (seed - 98) + 0.03 * (count > 1))
        published(context, tmp_path / f"fill {count}")
        add(context, f"new {count}", 7, lat=LAT + 0.06 + 0.01 * (count > 1))
        said = stitched(context, tmp_path / f"new {count}")
        sizes.append((len(said["regions"]), len(said["tiles"])))  # type: ignore[arg-type]
        assert said["dropped_tiles"] == said["dropped_regions"] == []
        assert len(said["taken_in"]) <= 2  # type: ignore[arg-type]
        published(context, tmp_path / f"publish {count}")
    (regions, tiles), (regions_later, tiles_later) = sizes
    assert regions_later <= regions + 4  # as the grid cuts it
    assert tiles_later <= 1.5 * tiles
    with context.database.read() as session:
        assert maps.version(session, "city").tile_count > 5 * tiles


def test_a_stitch_of_a_map_that_has_not_changed_writes_nothing(context: WorkerContext, tmp_path: Path) -> None:
    add(context, "a", 1)
    before = published(context, tmp_path / "1")
    said = stitched(context, tmp_path / "2")
    assert [said[name] for name in ("tiles", "regions", "dropped_tiles", "dropped_regions", "taken_in")] == [[]] * 5
    assert published(context, tmp_path / "3") == before


def test_other_settings_make_the_map_anew_and_as_if_it_had_been_made_with_them(context: WorkerContext, tmp_path: Path) -> None:
    for name, seed in (("a", 1), ("b", 2)):
        add(context, name, seed, lat=LAT + 0.0004 * seed)
    published(context, tmp_path / "1")
    coarse = replace(context, settings=context.settings.model_copy(update={"merge": MergeSettings(voxel_m=0.5)}))
    changed = published(coarse, tmp_path / "2")
    other = other_service(context, tmp_path / "other")
    fresh = replace(other, settings=other.settings.model_copy(update={"merge": MergeSettings(voxel_m=0.5)}))
    for name, seed in (("a", 1), ("b", 2)):
        add(fresh, name, seed, lat=LAT + 0.0004 * seed)
    assert published(fresh, tmp_path / "3") == changed
    other.database.close()


def test_a_map_without_the_held_and_the_quarantined_drives_is_the_map_of_the_others(context: WorkerContext, tmp_path: Path) -> None:
    add(context, "a", 1)
    alone = published(context, tmp_path / "1")
    held, quarantined = add(context, "b", 2, grade="D"), add(context, "c", 3, lat=LAT + 3.0, grade="E")
    assert published(context, tmp_path / "2") == alone
    with context.database.write() as session:
        gate.release(session, held, "Ada", "looked at it")
    assert held in published(context, tmp_path / "3")["drives"]  # type: ignore[operator]
    with context.database.read() as session:
        assert drives.get(session, quarantined).gate == "quarantine"


def test_drives_on_both_sides_of_a_degree_lie_side_by_side_in_one_frame(context: WorkerContext, tmp_path: Path) -> None:
    south, north = add(context, "south", 1), add(context, "north", 2, lat=49.0005)
    said = stitched(context, tmp_path / "1")
    assert said["frame"] == [8.5, 48.5, 0.0]
    assert said["drives"] == sorted([south, north])
    finest = {(tile["x"], tile["y"]) for tile in said["tiles"] if tile["layer"] == "points"}  # type: ignore[attr-defined]
    expected = set()
    for item in (placed(south, 1), placed(north, 2, lat=49.0005)):
        assert item.frame is not None
        expected |= tiles_of(item.points_enu(), item.frame)
    assert finest == expected


@pytest.mark.parametrize("far_lat", [LAT - 3.0, LAT + 3.0])
def test_a_drive_of_another_city_does_not_stop_the_map(context: WorkerContext, tmp_path: Path, far_lat: float) -> None:
    near = [add(context, "a", 1), add(context, "b", 2)]
    without = published(context, tmp_path / "1")
    far = add(context, "far", 3, lat=far_lat)
    said = published(context, tmp_path / "2")
    assert said["drives"] == sorted(near)
    assert said == without | {"out_of_reach": [far]}


def tiles_of(points_enu: np.ndarray, frame: MapFrame, zoom: int = 18) -> set[tuple[int, int]]:
    """The tiles in which points lie, each point by itself."""
    found = set()
    for lon, lat, _ in wgs84.lonlatheight_from_enu(points_enu, frame):
        x = (lon + 180.0) / 360.0
        y = 0.5 - np.arcsinh(np.tan(np.radians(lat))) / (2.0 * np.pi)
        found.add((int(x * (1 << zoom)), int(y * (1 << zoom))))
    return found


def test_the_settings_origin_is_the_frame_where_there_is_one(tmp_path: Path) -> None:
    context = make_context(WayloomSettings(data_dir=tmp_path / "data", map_origin=(8.41, 49.0, 100.0)))
    upgrade(context.database)
    add(context, "a", 1)
    assert stitched(context, tmp_path / "1")["frame"] == [8.41, 49.0, 100.0]
    context.database.close()


def test_before_publishing_unused_blobs_go_and_everything_that_is_to_be_published_stays(
    context: WorkerContext, tmp_path: Path
) -> None:
    add(context, "a", 1)
    stitches = context.folders.map("city") / "stages" / "stitch"
    stitches.mkdir(parents=True)
    stitched(context, stitches / "earlier")
    add(context, "b", 2)
    said = stitched(context, stitches / "key")
    for blob in context.folders.blobs.glob("*/*"):
        os.utime(blob, (1e9, 1e9))
    left = context.folders.drive("f" * 64) / "attempts"
    left.mkdir(parents=True)
    with context.database.read() as session:
        kept = context.folders.drive(maps.submaps(session, "city")[0].drive_id)
    kept.mkdir()
    needed = {entry["digest"] for entry in [*said["tiles"], *said["regions"]]}  # type: ignore[misc]
    with context.database.read() as session:
        needed |= {row.digest for row in maps.submaps(session, "city")}
    assert needed < set(context.blobs.older_than(0.0))
    claim = Claim(2, 1, "publish", 1, None, "city", {})
    tidy(StageAttempt(context, claim, None, None, tmp_path, {"stitch": "key"}, tmp_path, silent))
    assert set(context.blobs.older_than(0.0)) == needed
    assert [path.name for path in stitches.iterdir()] == ["key"]
    assert [*context.folders.all_drives.iterdir()] == [kept]  # what a stage of a removed drive was still writing has gone


def test_what_is_parked_is_an_overlay_of_its_own_that_comes_and_goes_with_its_drives(
    context: WorkerContext, tmp_path: Path
) -> None:
    still = replace(context, settings=context.settings.model_copy(update={"merge": MergeSettings(standing_s=1e-9)}))
    add(still, "street", 1)
    without = published(still, tmp_path / "1")
    cars = add(still, "cars", 2, lat=LAT + 0.0004, classes=(0, 13))
    with_cars = published(still, tmp_path / "2")
    layers = with_cars["about"][4]  # type: ignore[index]
    assert {"parked", "parked-points", "parked-cloud", "parked-tilesets"} <= set(layers)
    assert layers["parked"]["min_zoom"] == still.settings.tiles.overlays_from_zoom
    assert not {"moving", "parked-counts"} & set(layers)
    other = other_service(context, tmp_path / "other")
    fresh = replace(other, settings=still.settings)
    add(fresh, "cars", 2, lat=LAT + 0.0004, classes=(0, 13))
    add(fresh, "street", 1)
    assert published(fresh, tmp_path / "3") == with_cars
    with still.database.write() as session:
        drives.request_removal(session, cars)
        drives.delete_rows(session, cars)
    assert published(still, tmp_path / "4") == without
    other.database.close()


def test_a_map_without_drives_has_no_tiles(context: WorkerContext, tmp_path: Path) -> None:
    with context.database.write() as session:
        maps.ensure_map(session, "city")
    said = stitched(context, tmp_path / "1")
    assert (said["tiles"], said["bounds"], said["drives"]) == ([], None, [])


def city(context: WorkerContext) -> None:
    """Six drives on 600 m of road."""
    for seed in range(6):
        add(context, f"drive {seed}", seed, lat=LAT + 0.001 * seed)


def run(context: WorkerContext, job_id: int) -> list[JobMessage]:
    """A worker's run of one job; the messages of those that follow."""
    sent: list[JobMessage] = []
    assert run_job(context, stage_hooks, sent.extend, job_id)
    return sent


def requested(context: WorkerContext) -> int:
    with context.database.write() as session:
        return jobs.request_stitch(session, "city").id


def test_regions_merged_in_parts_by_workers_in_any_order_are_the_same_map(
    context: WorkerContext, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = other_service(context, tmp_path / "other")
    city(context)
    city(other)
    monkeypatch.setattr(region_merging, "REGIONS_OF_PART", 64)
    (publishing,) = run(other, requested(other))
    run(other, publishing.job_id)
    monkeypatch.setattr(region_merging, "REGIONS_OF_PART", 4)
    parent = requested(context)
    parts = run(context, parent)
    assert len(parts) > 3
    with ThreadPoolExecutor(2) as two_workers:
        following = [message for sent in two_workers.map(lambda part: run(context, part.job_id), parts[::-1]) for message in sent]
    assert [message.job_id for message in following] == [parent]
    (publishing,) = run(context, parent)
    run(context, publishing.job_id)
    assert newest(context) == newest(other)
    assert not (context.folders.map("city") / "parts" / "stitch").exists() or not any(
        (context.folders.map("city") / "parts" / "stitch").rglob(region_merging.PART_FILE)
    )
    other.database.close()


def test_while_a_stitch_waits_for_its_parts_no_other_job_of_the_map_is_to_be_had(
    context: WorkerContext, monkeypatch: pytest.MonkeyPatch
) -> None:
    city(context)
    monkeypatch.setattr(region_merging, "REGIONS_OF_PART", 4)
    parent = requested(context)
    parts = run(context, parent)
    late = add(context, "late", 9)
    second = requested(context)
    assert second != parent
    assert not run_job(context, stage_hooks, lambda _: None, second)
    held = jobs.claim(context.database, parts[0].job_id, "dead", 0.0)
    assert held is not None
    for part in parts[1:]:
        run(context, part.job_id)
    assert sweep.requeue_lost(context.database, 3) == 1
    (again,) = run(context, parts[0].job_id)
    (publishing,) = run(context, again.job_id)
    assert not run_job(context, stage_hooks, lambda _: None, second)
    run(context, publishing.job_id)
    with context.database.read() as session:  # the regions that the late drive bears on were merged by the stitch itself
        assert late in maps.drives_of(session, "city", 1)


def test_a_part_that_fails_for_good_fails_its_stitch_and_the_map_goes_on(
    context: WorkerContext, monkeypatch: pytest.MonkeyPatch
) -> None:
    city(context)
    monkeypatch.setattr(region_merging, "REGIONS_OF_PART", 4)
    parts = run(context, requested(context))
    held = jobs.claim(context.database, parts[0].job_id, "w", 60.0)
    assert held is not None
    with context.database.write() as session:
        jobs.fail(session, held, "no luck", final=True)
    for part in parts[1:]:
        run(context, part.job_id)
    (publishing, *_) = run_to_the_end(context, requested(context))
    run(context, publishing.job_id)
    assert len(newest(context)["drives"]) == 6  # type: ignore[arg-type]


def test_a_removed_drive_leaves_no_blob_and_no_file_that_names_it(context: WorkerContext) -> None:
    """Two drives on one street, one of them removed after a third version; what is left is the map of the other alone."""
    stays = add(context, "stays", 1)
    publish_next(context)
    alone = newest(context)
    goes = add(context, "goes", 2, lat=LAT + 0.0002)
    publish_next(context)
    add(context, "later", 3, lat=LAT + 0.01)
    publish_next(context)
    with context.database.write() as session:
        blob = context.blobs.put(f"what {goes} and {stays} have in common".encode())
        pair = sorted([goes, stays])
        row = MeetingRow(map_id="city", drive_a=pair[0], drive_b=pair[1], inputs="1" * 64, digest=blob, count=0)
        meetings.keep(session, [row])
        submaps = [one.digest for one in maps.submaps_of(session, goes)]
        removal = drives.request_removal(session, goes)
    left = context.folders.drive(goes) / "stages" / "places" / ("2" * 64)
    left.mkdir(parents=True)
    (left / "drive.places").write_text(goes)
    assert naming(context, goes)
    (stitching,) = run(context, removal.job_id)
    drop_forgotten(context)
    assert naming(context, goes)  # the newest version is whole until the next one
    (publishing,) = run(context, stitching.job_id)
    run(context, publishing.job_id)
    drop_forgotten(context)
    assert naming(context, goes) == []
    assert not any(context.blobs.has(digest) for digest in submaps)
    with context.database.read() as session:
        assert [row.version for row in maps.versions(session, "city")] == [4, 1]
        assert session.scalars(select(MeetingRow)).all() == []
        first = {row.digest for row in session.scalars(select(TileRow).where(TileRow.since == 1)) if row.digest}
    assert first == set(alone["tiles"].values())  # type: ignore[attr-defined]
    assert all(context.blobs.has(digest) for digest in first)


def publish_next(context: WorkerContext) -> None:
    (publishing,) = run(context, requested(context))
    run(context, publishing.job_id)


def drop_forgotten(context: WorkerContext) -> None:
    garbage.drop_forgotten(context.database, context.blobs, lambda: listed_tiles(context.folders))


def naming(context: WorkerContext, drive_id: str) -> list[Path]:
    """The files that have the drive's id in their name or content, but for the database's own."""
    files = [path for path in context.folders.root.rglob("*") if path.is_file() and not path.name.startswith("wayloom.db")]
    return [path for path in files if drive_id in str(path) or drive_id.encode() in path.read_bytes()]


def run_to_the_end(context: WorkerContext, job_id: int) -> list[JobMessage]:
    """A stitch with its parts."""
    sent = run(context, job_id)
    while sent and sent[0].queue == "stitch":
        sent = [message for part in sent for message in run(context, part.job_id)]
    return sent
