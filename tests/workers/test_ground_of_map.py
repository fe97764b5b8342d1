"""The map's ground: made of the sheets that drives left, region by region, and gone with them."""

import hashlib
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ground.made_sheets import Street, cut
from wayloom.config.progress import silent
from wayloom.config.stages import drive_stages
from wayloom.files.submap_folder import INDEX
from wayloom.geodesy import wgs84
from wayloom.geodesy.map_frame import MapFrame
from wayloom.ground.files import save_sheets
from wayloom.ground.ground_map import GroundFile
from wayloom.ground.placed_sheet import PlacedSheet
from wayloom.pipeline.stages.submaps import PREVIEW_FILE
from wayloom.store import drives, garbage, gate, map_versions, maps
from wayloom.store.jobs import Claim
from wayloom.store.manifest import Manifest, ManifestFile
from wayloom.store.tables.drives import Job
from wayloom.store.withdrawal import NOTHING
from wayloom.submaps.files import save_submaps
from wayloom.submaps.submap import PlacedSubmap, Submap
from wayloom.tiles.grid import TileAddress, pixel_from_lonlat
from wayloom.tiles.rasters import ORTHO, RASTER_LAYERS, decode_picture, heights_of
from wayloom_workers import region_merging
from wayloom_workers.drive_sheets import GROUND
from wayloom_workers.drive_sightings import OBJECTS
from wayloom_workers.production import SUBMAPS, stage_hooks, submap_row
from wayloom_workers.publishing import listed_tiles
from wayloom_workers.stage_hooks import StageAttempt, WorkerContext
from workers.conftest import NewService, with_finest_tiles, with_one_database
from workers.test_stitching import published

STREET = Street()
FRAME = MapFrame(8.4, 49.0, 100.0)
FIRST, SECOND = {"start": 0.0, "t_s": 100}, {"start": 30.0, "t_s": 5000, "gain": 0.8, "seed": 7, "yaw": 3.3}


def add(
    context: WorkerContext,
    name: str,
    start: float = 0.0,
    pieces: int = 2,
    sheets: bool = True,
    **how: object,
) -> str:
    """A processed drive of grade A along the street, with the sheets that its stage of ground left."""
    with context.database.write() as session:
        manifest = Manifest(name=name, files=(ManifestFile(path="log/a", size=1, sha256="0" * 64),))
        drive_id = drives.register(session, manifest, "city")[0].id
        folder = context.folders.drive(drive_id) / "stages" / GROUND / "key"
        rows, made = [], []
        for piece in range(pieces):
            from_m = start + 40.0 * piece
            sheet = cut(STREET, from_m, from_m + 42.0, drive_id, **{"seed": 0, **how, "t_s": how.get("t_s", 100) + piece})  # type: ignore[arg-type]
            item = submap_at(sheet, piece)
            context.blobs.put(item.submap.encoded)
            rows.append(submap_row(drive_id, "city", piece, item))
            made.append(replace(sheet.read(), submap=item.submap.digest))
        save_sheets(made, folder)
        if sheets:
            about = {"queue": "odometry", "state": "done", "position": 0, "payload": {"key": "key"}, "created_at": 0.0}
            session.add(Job(stage=GROUND, drive_id=drive_id, **about))
        maps.place_submaps(session, drive_id, rows)
        gate.judge(session, drive_id, "A", [], "merge")
    return drive_id


def submap_at(sheet: PlacedSheet, piece: int) -> PlacedSubmap:
    """Some points around, in the frame of the sheet's submap."""
    rng = np.random.default_rng([piece, 9])
    xyz = (rng.uniform(-1.0, 1.0, (60, 3)) * (20.0, 2.0, 20.0)).astype(np.float32)
    label = np.full(60, 2, np.uint8)
    submap = Submap(
        xyz=xyz, label=label, variance=np.full(60, 0.01, np.float32), grey=np.zeros(60, np.uint8), seen_ns=np.arange(60),
        keyframe=np.zeros(60, np.uint32), vote_start=np.arange(61, dtype=np.uint32), vote_class=label,
        vote_weight=np.full(60, 0.1, np.float32), keyframe_frame=np.arange(2, dtype=np.uint32) + 2 * piece,
        keyframe_t_ns=np.array([0, 10**9]) + piece, T_submap_cam=np.stack([np.eye(4), np.eye(4)]), length_m=40.0,
        points_left_out={},
    )  # fmt: skip
    submap.T_submap_cam[1, 2, 3] = 20.0
    return PlacedSubmap(submap, sheet.T_map_submap, sheet.covariance, sheet.drive_id, FRAME)


def grounds(context: WorkerContext) -> dict[tuple[int, int], str]:
    with context.database.read() as session:
        return {key: entry.ground for key, entry in map_versions.current_regions(session, "city").items() if entry.ground}


def of_rasters(said: dict[str, object]) -> dict[object, object]:
    tiles: dict[tuple[object, ...], object] = said["tiles"]  # type: ignore[assignment]
    return {key: digest for key, digest in tiles.items() if key[0] in RASTER_LAYERS}


def shown(context: WorkerContext, layer: str, xyz: tuple[float, float, float], zoom: int) -> np.ndarray:
    """The pixel of a tile of the newest version at a place of the map's frame."""
    lon_lat = wgs84.lonlatheight_from_enu(np.array([xyz]), FRAME)[:, :2]
    column, row = pixel_from_lonlat(lon_lat, zoom + 1)[0].tolist()
    with context.database.read() as session:
        number = maps.version(session, "city").version
        tile = maps.tile(session, "city", number, layer, *TileAddress(zoom, column // 512, row // 512))
    if tile is None:
        return np.zeros(4, np.uint8)
    return np.asarray(decode_picture(context.blobs.get(tile.digest))[row % 512, column % 512])


@with_finest_tiles
def test_the_map_shows_the_ground_of_its_drives_where_it_is(context: WorkerContext, tmp_path: Path) -> None:
    add(context, "a")
    said = published(context, tmp_path / "1")
    layers = said["about"][4]  # type: ignore[index]
    assert {name: (layers[name]["media_type"], layers[name]["min_zoom"], layers[name]["max_zoom"]) for name in RASTER_LAYERS} == {
        "ortho": ("image/webp", 12, 20), "height": ("image/png", 12, 19), "surface": ("image/png", 12, 19),
    }  # fmt: skip
    for x in (7.0, 31.0, 61.5, 70.0):
        for y, label, kerb in ((27.5, (128, 64, 128, 255), 0.0), (24.0, (244, 35, 232, 255), 0.12)):
            z = float(STREET.height(np.array(x), np.array(y)))
            grey = float(STREET.grey(np.array(x), np.array(y)))
            seen = shown(context, "ortho", (x, y, z), 20).astype(float)
            assert seen[3] == 255
            assert np.abs(seen[:3] - grey).max() < 16.0, (x, y)
            assert tuple(shown(context, "surface", (x, y, z), 19).tolist()) == label
            height = heights_of(shown(context, "height", (x, y, z), 19))
            above = wgs84.lonlatheight_from_enu(np.array([[x, y, z]]), FRAME)[0, 2]
            assert height == pytest.approx(above, abs=0.015), (x, y, kerb)
    assert shown(context, "ortho", (40.0, 45.0, 0.0), 20)[3] == 0
    assert shown(context, "ortho", (40.0, 30.0, 0.0), 16)[3] == 255


@with_finest_tiles
@with_one_database
def test_no_order_of_arrival_changes_a_byte_of_the_ground(new_service: NewService, tmp_path: Path) -> None:
    one, other = new_service(tmp_path / "one"), new_service(tmp_path / "other")
    add(one, "a", **FIRST)
    published(one, tmp_path / "1")
    add(one, "b", **SECOND)
    stepwise = published(one, tmp_path / "2")
    add(other, "b", **SECOND)
    add(other, "a", **FIRST)
    at_once = published(other, tmp_path / "3")
    assert grounds(one) == grounds(other)
    assert stepwise == at_once
    assert len(of_rasters(at_once)) > 30


def test_a_map_from_which_a_drive_was_removed_shows_the_ground_of_the_others_alone(new_service: NewService, tmp_path: Path) -> None:
    context = new_service(tmp_path / "data")
    add(context, "a", **FIRST)
    without, ground = published(context, tmp_path / "1"), grounds(context)
    two = add(context, "b", **SECOND)
    published(context, tmp_path / "2")
    held = {*grounds(context).values()} - {*ground.values()}
    photos = tiles_of(context, 2) - tiles_of(context, 1)
    assert held
    assert photos
    with context.database.write() as session:
        drives.request_removal(session, two)
    assert published(context, tmp_path / "3") == without
    assert grounds(context) == ground
    with context.database.write() as session:
        drives.delete_rows(session, two)
    garbage.drop_forgotten(context.database, context.blobs, lambda: ())
    assert not any(context.blobs.has(digest) for digest in held | photos)
    assert all(context.blobs.has(digest) for digest in ground.values())


def tiles_of(context: WorkerContext, number: int) -> set[str]:
    """The digests of a version's raster tiles."""
    with context.database.read() as session:
        rows = map_versions.changes(session, "city", number)[0]
        return {row.digest for row in rows if row.layer in RASTER_LAYERS} - {NOTHING}


@with_one_database
def test_a_drive_elsewhere_makes_no_ground_anew(context: WorkerContext, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    add(context, "a", **FIRST)
    published(context, tmp_path / "1")
    before, finest = grounds(context), (ORTHO, context.settings.tiles.ortho_zoom)
    merged: list[tuple[float, ...]] = []
    real = region_merging.merge_sheets
    monkeypatch.setattr(
        region_merging, "merge_sheets", lambda sheets, low, edge: merged.append(tuple(low)) or real(sheets, low, edge)
    )
    add(context, "far", start=640.0)
    published(context, tmp_path / "2")
    assert min(low[0] for low in merged) > 500.0
    assert before.items() <= grounds(context).items()
    with context.database.read() as session:
        new = [row for row in map_versions.changes(session, "city", 2)[0] if (row.layer, row.z) == finest]
        all_of_map = [key for key in map_versions.all_current_tiles(session, "city") if key[:2] == finest]
    assert 0 < len(new) < 0.7 * len(all_of_map)


@pytest.mark.parametrize("kept", ["without the stage", "without its index", "with a damaged sheet"])
def test_a_drive_without_sheets_is_in_the_map_and_shows_no_ground(context: WorkerContext, tmp_path: Path, kept: str) -> None:
    drive_id = add(context, "a", pieces=1, sheets=kept != "without the stage")
    folder = context.folders.drive(drive_id) / "stages" / GROUND / "key"
    if kept == "without its index":
        (folder / INDEX).unlink()
    if kept == "with a damaged sheet":
        (path,) = folder.glob("*.ground")
        path.write_bytes(path.read_bytes()[:-1])
    said = published(context, tmp_path / "1")
    assert said["about"][2] == 1  # type: ignore[index]
    assert grounds(context) == {}
    assert of_rasters(said) == {}


def test_a_drive_that_makes_its_ground_anew_has_its_regions_made_anew(context: WorkerContext, tmp_path: Path) -> None:
    add(context, "a", pieces=1, sheets=False)
    published(context, tmp_path / "1")
    add(context, "a", pieces=1)
    published(context, tmp_path / "2")
    assert grounds(context)


def test_the_ground_of_a_list_that_waits_to_be_published_is_kept(context: WorkerContext, tmp_path: Path) -> None:
    add(context, "a", pieces=1)
    published(context, tmp_path / "1")
    entry = {"tiles": [], "regions": [{"digest": "r", "ground": "g"}, {"digest": "s", "ground": ""}]}
    folder = context.folders.map("city") / "stages" / "stitch" / "key"
    folder.mkdir(parents=True)
    (folder / "tiles.json").write_text(json.dumps(entry))
    assert [*listed_tiles(context.folders)] == ["r", "s", "g"]


@with_one_database
def test_cells_say_who_saw_them_last(context: WorkerContext, tmp_path: Path) -> None:
    one, two = add(context, "a", **FIRST), add(context, "b", **SECOND)
    published(context, tmp_path / "1")
    made = GroundFile(context.blobs.get(grounds(context)[0, 0])).ground_map()
    row, both, alone = 275, 500, 100
    newest = [made.sheets[made.newest[row, column] - 1][0] for column in (alone, both)]
    assert newest == [one, two]
    assert [made.looks[row, column] for column in (alone, both)] == [1, 2]
    last_seen_ns = made.t_ns[made.newest[row, [alone, both]] - 1, 1]
    assert last_seen_ns[1] > last_seen_ns[0]


def test_the_submaps_of_a_drive_enter_the_map_with_its_last_stage_the_objects(context: WorkerContext, tmp_path: Path) -> None:
    """Not before: a stitch in between would take them in without their ground and objects."""
    with context.database.write() as session:
        manifest = Manifest(name="a", files=(ManifestFile(path="log/a", size=1, sha256="0" * 64),))
        drive_id = drives.register(session, manifest, "city")[0].id
    item = submap_at(cut(STREET, 0.0, 42.0, drive_id), 0)
    save_submaps([item], tmp_path / SUBMAPS)
    (tmp_path / SUBMAPS / PREVIEW_FILE).write_bytes(b"a picture")
    claim = Claim(1, 1, OBJECTS, 1, drive_id, None, {})
    attempt = StageAttempt(context, claim, None, None, tmp_path, {}, tmp_path, silent)
    assert drive_stages()[-1] == OBJECTS
    for stage, count in ((SUBMAPS, 0), (GROUND, 0), (OBJECTS, 1)):
        hooks = stage_hooks(stage)
        hooks.share(attempt)
        record = hooks.record(attempt)
        if stage == OBJECTS:
            shutil.rmtree(tmp_path / SUBMAPS)  # nothing is read while others wait for the transaction
        with context.database.write() as session:
            record(session)
            assert len(maps.submaps_of(session, drive_id)) == count
    assert context.blobs.has(item.submap.digest)
    with context.database.read() as session:
        assert drives.get(session, drive_id).facts["preview"] == hashlib.sha256(b"a picture").hexdigest()
        assert len(map_versions.changed_boxes(session, "city")) == 1
