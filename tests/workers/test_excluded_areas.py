"""An excluded area has nothing in the map, in what drives left, and in versions of before."""

import json
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sqlalchemy import event

from places.made_places import random_places
from wayloom.dense.files import LOOKS_FILE, LookFile, save_looks
from wayloom.dense.types import Looks
from wayloom.errors import ConfigError, NotFoundError, WithdrawnError
from wayloom.exclusion.areas import area_of_geometry
from wayloom.geodesy import wgs84
from wayloom.geodesy.map_frame import MapFrame
from wayloom.geometry import se3
from wayloom.geometry.camera import PinholeCamera
from wayloom.ground.files import load_sheet, read_index
from wayloom.ground.sheet import CELL_M
from wayloom.objects import files as sighting_files
from wayloom.places.files import PLACES_FILE, load_places, save_places
from wayloom.stitching.region_files import decode_region
from wayloom.store import drives, excluded, garbage, jobs, map_versions, maps
from wayloom.store.database import DatabaseError
from wayloom.store.tables.drives import Job
from wayloom.submaps.files import load_submaps, save_submaps
from wayloom.submaps.submap import PlacedSubmap, decode_submap
from wayloom.tiles.grid import pixel_from_lonlat
from wayloom_workers import exclusion, sweeper
from wayloom_workers.exclusion import exclude
from wayloom_workers.publishing import listed_tiles
from wayloom_workers.stage_hooks import WorkerContext
from wayloom_workers.sweeper import exclude_late
from workers.test_features_of_map import FIRST, add, features
from workers.test_ground_of_map import FRAME, shown
from workers.test_stitching import publish_next

WEST, EAST, SOUTH, NORTH = 112.0, 136.0, 0.0, 60.0
"""m, in the map's frame: three of five things, and a piece of the street."""


def polygon(west: float = WEST, east: float = EAST) -> dict[str, Any]:
    corners = np.array([[west, SOUTH, 0.0], [east, SOUTH, 0.0], [east, NORTH, 0.0], [west, NORTH, 0.0], [west, SOUTH, 0.0]])
    return {"type": "Polygon", "coordinates": [wgs84.lonlatheight_from_enu(corners, FRAME)[:, :2].tolist()]}


def driven(context: WorkerContext, name: str, **how: Any) -> str:
    """A drive with all that its stages leave."""
    drive_id = add(context, name, **{**FIRST, **how})
    with context.database.write() as session:
        rows = maps.submaps_of(session, drive_id)
        items = [placed(context, row) for row in rows]
        folders = {}
        for stage in ("submaps", "places", "looks"):
            folders[stage] = context.folders.drive(drive_id) / "stages" / stage / "key"
            folders[stage].mkdir(parents=True)
            about = {"queue": "odometry", "state": "done", "position": 0, "payload": {"key": "key"}, "created_at": 0.0}
            session.add(Job(stage=stage, drive_id=drive_id, **about))
        drives.get(session, drive_id).track = [[*place, 0.0] for row in rows for place in row.track]
    save_submaps(items, folders["submaps"])
    frames = np.concatenate([item.submap.keyframe_frame for item in items])
    save_places(random_places(3, len(frames)), folders["places"] / PLACES_FILE)
    pictures = np.full((len(frames), 2, 3), 7, np.uint8)
    camera = PinholeCamera(2.0, 2.0, 1.0, 1.0, 3, 2)
    save_looks(Looks(camera, 0.01, np.sort(frames).astype(np.uint32), pictures, pictures, pictures), folders["looks"] / LOOKS_FILE)
    return drive_id


def placed(context: WorkerContext, row: Any) -> PlacedSubmap:
    submap = decode_submap(context.blobs.get(row.digest))
    T, covariance = np.array(row.T_enu_submap), np.array(row.covariance)
    return PlacedSubmap(submap, T, covariance, row.drive_id, MapFrame(*row.frame))


def inside(points_enu: np.ndarray, margin_m: float = 0.0) -> np.ndarray:
    lon_lat = wgs84.lonlatheight_from_enu(points_enu, FRAME)[:, :2]
    return area_of_geometry(polygon()).contains(lon_lat, margin_m)


def left_inside(context: WorkerContext, drive_id: str) -> dict[str, int]:
    """How much of each kind of what is kept of a drive lies in the area."""
    stages = context.folders.drive(drive_id) / "stages"
    with context.database.read() as session:
        rows = maps.submaps_of(session, drive_id)
        track = [*(place for row in rows for place in row.track), *(drives.get(session, drive_id).track or [])]
    items = {item.submap.digest: item for item in load_submaps(stages / "submaps" / "key")}
    assert [*items] == [row.digest for row in rows]
    found = dict.fromkeys(("points", "cells", "pixels", "things", "looked", "track", "looks", "places"), 0)
    frames = []
    for row in rows:
        item = placed(context, row)
        found["points"] += int(inside(item.points_enu()).sum())
        sheet = load_sheet(stages / "ground" / "key", read_index(stages / "ground" / "key")[row.digest])
        h, w = sheet.height_mm.shape
        x, y = np.meshgrid(CELL_M * (sheet.corner[0] + np.arange(w) + 0.5), CELL_M * (sheet.corner[1] + np.arange(h) + 0.5))
        cells = np.column_stack([x.ravel(), y.ravel(), np.nan_to_num(sheet.height).ravel()])
        here = inside(se3.transform(item.T_enu_submap @ sheet.T_submap_sheet, cells)).reshape(h, w)
        found["cells"] += int((np.isfinite(sheet.height) & here).sum() + sheet.votes[here].sum())
        found["pixels"] += int(sheet.colour[::2, ::2][here].sum() + sheet.sharpness[1::2, 1::2][here].sum())
        index = sighting_files.read_index(stages / "objects" / "key")
        if row.digest in index:
            sightings = sighting_files.load_one(stages / "objects" / "key", index[row.digest])
            found["things"] += int(inside(se3.transform(item.T_enu_submap, sightings.position.astype(float))).sum())
        at = inside(item.track_enu())
        frames += item.submap.keyframe_frame[at].tolist()
    found["track"] = int(inside(enu_of(track)).sum()) if track else 0
    found["looks"] = len(LookFile(stages / "looks" / "key" / LOOKS_FILE).of_frames(np.array(frames, np.int64)))
    places = load_places(stages / "places" / "key" / PLACES_FILE)
    found["places"] = int(np.isin(places.features.keyframe, frames).sum() + np.isin(places.cloud.keyframe, frames).sum())
    return found


def enu_of(track: list[Any]) -> np.ndarray:
    places = np.array([[*place[:2], 0.0] for place in track])
    return wgs84.enu_from_lonlatheight(places, FRAME)


def map_inside(context: WorkerContext) -> dict[str, int]:
    """How much of the newest version lies in the area."""
    with context.database.read() as session:
        regions = map_versions.current_regions(session, "city")
    voxels = [
        layer.points_enu for one in regions.values() for layer in decode_region(context.blobs.get(one.digest)).layers.values()
    ]
    things = [feature["geometry"]["coordinates"] for found in features(context, "objects").values() for feature in found]
    return {"voxels": sum(int(inside(points).sum()) for points in voxels), "things": int(inside(enu_of(things)).sum())}


def exclude_area(context: WorkerContext, geometry: dict[str, Any]) -> str:
    with context.database.write() as session:
        return excluded.add(session, "city", "works", geometry)[0].id


def test_an_area_that_is_excluded_leaves_the_map_its_versions_and_its_drives(context: WorkerContext) -> None:
    drive_id = driven(context, "a")
    publish_next(context)
    with context.database.read() as session:
        before = [row.digest for row in maps.submaps_of(session, drive_id)]
    had = left_inside(context, drive_id)
    assert all(had[name] > 0 for name in ("points", "cells", "pixels", "things", "track", "looks", "places"))
    assert min(map_inside(context).values()) > 0
    assert shown(context, "ortho", (124.0, 30.0, 0.0), context.settings.tiles.ortho_zoom).any()
    area_id = exclude_area(context, polygon())
    publish_next(context)
    assert set(left_inside(context, drive_id).values()) == {0}
    assert set(map_inside(context).values()) == {0}
    assert not shown(context, "ortho", (124.0, 30.0, 0.0), context.settings.tiles.ortho_zoom).any()
    assert shown(context, "ortho", (148.0, 30.0, 0.0), context.settings.tiles.ortho_zoom).any()
    assert sum(map(len, features(context, "objects").values())) == 2
    with context.database.read() as session:
        assert [row.since for row in excluded.of_map(session, "city")] == [2]
        with pytest.raises(WithdrawnError):
            maps.version(session, "city", 1)
        after = [row.digest for row in maps.submaps_of(session, drive_id)]
    garbage.drop_forgotten(context.database, context.blobs, lambda: listed_tiles(context.folders))
    gone = set(before) - set(after)
    assert gone
    assert not any(context.blobs.has(digest) for digest in gone)
    assert exclude(context, "city") == 0
    with context.database.write() as session:
        excluded.remove(session, area_id)
    publish_next(context)
    assert set(map_inside(context).values()) == {0}


def test_drives_that_come_later_bring_nothing_of_it(context: WorkerContext) -> None:
    driven(context, "a")
    exclude_area(context, polygon())
    publish_next(context)
    later = driven(context, "b", t_s=5000, seed=7)
    publish_next(context)
    assert set(map_inside(context).values()) == {0}
    assert set(left_inside(context, later).values()) == {0}
    with context.database.read() as session:
        assert [row.version for row in maps.versions(session, "city")] == [2, 1]  # the first had nothing of it


def test_a_drive_that_no_stitch_looks_at_is_clipped_by_the_sweeper(context: WorkerContext) -> None:
    exclude_area(context, polygon())
    publish_next(context)
    held = driven(context, "held")
    with context.database.write() as session:
        drives.get(session, held).gate = "quarantine"
    assert left_inside(context, held)["points"] > 0
    exclude_late(context)
    assert set(left_inside(context, held).values()) == {0}


def test_a_drive_that_gets_its_place_by_a_version_takes_it_down_where_it_lies_in_an_area(context: WorkerContext) -> None:
    """As a guest does: the version's stitch could not know that it lies there."""
    exclude_area(context, polygon())
    publish_next(context)
    drive_id = driven(context, "guest")
    with context.database.write() as session:
        for row in maps.submaps_of(session, drive_id):
            row.min_lon = row.min_lat = row.max_lon = row.max_lat = None  # as one without a place
    exclude(context, "city")
    with context.database.write() as session:
        version = map_versions.NewVersion(1, (8.4, 49.0, 100.0), (drive_id,), 2, None, [tile_of_area()])
        map_versions.publish(session, "city", version, kept=20)
        for row in maps.submaps_of(session, drive_id):
            west, south, east, north = area_of_geometry(polygon()).box
            row.min_lon, row.min_lat, row.max_lon, row.max_lat = west, south, east, north
    exclude_late(context)
    publish_next(context)
    assert set(left_inside(context, drive_id).values()) == {0}
    with context.database.read() as session:
        assert [row.version for row in maps.versions(session, "city")] == [3, 1]


def tile_of_area() -> map_versions.TileEntry:
    """A tile of zoom 16 in the middle of the area."""
    middle = wgs84.lonlatheight_from_enu(np.array([[0.5 * (WEST + EAST), 30.0, 0.0]]), FRAME)[:, :2]
    column, row = (pixel_from_lonlat(middle, 16)[0] // 256).astype(int).tolist()
    return map_versions.TileEntry("semantic", 16, column, row, "1" * 64, "image/png", 1)


def test_versions_that_show_nothing_of_an_area_stay(context: WorkerContext) -> None:
    driven(context, "a")
    publish_next(context)
    exclude_area(context, polygon(west=5000.0, east=5100.0))
    publish_next(context)
    with context.database.read() as session:
        assert [row.version for row in maps.versions(session, "city")] == [2, 1]
    assert map_inside(context)["voxels"] > 0


def test_a_version_takes_down_what_areas_show_with_statements_that_do_not_grow_with_their_number(context: WorkerContext) -> None:
    values: list[int] = []

    def count(_connection: Any, _cursor: Any, _statement: str, parameters: Any, *_: Any) -> None:
        values.append(len(parameters))

    with context.database.write() as session:
        maps.ensure_map(session, "city")
        for number in range(20):
            excluded.add(session, "city", "far away", polygon(west=5000.0 + 30.0 * number, east=5010.0 + 30.0 * number))
        excluded.add(session, "city", "here", polygon())
        for base in range(2):
            version = map_versions.NewVersion(base, (8.4, 49.0, 100.0), (), 2, None, [tile_of_area()])
            map_versions.publish(session, "city", version, kept=20)
        job = jobs.request_stitch(session, "city")
        job.started_at = drives.now_s(session) + 1.0
        session.flush()
        event.listen(context.database.engine, "before_cursor_execute", count)
        excluded.published(session, "city", job.id)
        event.remove(context.database.engine, "before_cursor_execute", count)
        assert {row.since for row in excluded.of_map(session, "city")} == {2}
        assert [row.version for row in maps.versions(session, "city")] == [2]
    assert 50 < max(values) < 200  # of one area


def test_one_drive_is_rewritten_before_the_next_one_is_read(context: WorkerContext, monkeypatch: pytest.MonkeyPatch) -> None:
    """Submaps of a whole city do not fit into memory."""
    names = [driven(context, "a"), driven(context, "b", t_s=5000, seed=7)]
    exclude_area(context, polygon())
    steps: list[tuple[str, str]] = []
    clip, rewrite = exclusion._clipped, exclusion._rewrite
    monkeypatch.setattr(exclusion, "_clipped", lambda *asked: (steps.append(("read", asked[1].drive_id)), clip(*asked))[1])
    monkeypatch.setattr(exclusion, "_rewrite", lambda *asked: (steps.append(("rewrite", asked[1])), rewrite(*asked))[1])
    assert exclude(context, "city") >= 2
    assert [*dict.fromkeys(steps)] == [(what, name) for name in sorted(names) for what in ("read", "rewrite")]
    assert all(set(left_inside(context, name).values()) == {0} for name in names)


@pytest.mark.parametrize("dies", ["_of_each", "_of_looks", "_of_places", "_write_rows"])
def test_whoever_is_killed_is_followed_by_one_who_finds_the_rest(
    context: WorkerContext, monkeypatch: pytest.MonkeyPatch, dies: str
) -> None:
    drive_id = driven(context, "a")
    exclude_area(context, polygon())

    def die(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(f"wayloom_workers.exclusion.{dies}", die)
        with pytest.raises(KeyboardInterrupt):
            exclude(context, "city")
    exclude(context, "city")
    assert set(left_inside(context, drive_id).values()) == {0}


@pytest.mark.parametrize("damaged", ["ground", "objects", "places", "looks", "submaps"])
def test_what_is_damaged_goes_and_the_map_goes_on(context: WorkerContext, damaged: str) -> None:
    drive_id = driven(context, "a")
    folder = context.folders.drive(drive_id) / "stages" / damaged / "key"
    for file in folder.iterdir():
        file.write_bytes(file.read_bytes()[:40])
    exclude_area(context, polygon())
    publish_next(context)
    assert [*folder.iterdir()] == []
    assert map_inside(context)["voxels"] == 0


def test_the_areas_of_the_settings_follow_their_file(context: WorkerContext) -> None:
    with context.database.write() as session:
        own = excluded.add(session, "city", "asked for", polygon())[0].id
        excluded.sync(session, "city", [("yard", polygon()), ("works", polygon(0.0, 10.0))])
    with context.database.write() as session:
        names = {row.name: row.id for row in excluded.of_map(session, "city")}
        excluded.sync(session, "city", [("works", polygon(0.0, 10.0))])
    with context.database.write() as session:
        assert {row.name: row.id for row in excluded.of_map(session, "city")} == {"asked for": own, "works": names["works"]}
        with pytest.raises(NotFoundError):
            excluded.remove(session, names["yard"])


def test_a_sweeper_that_starts_while_the_database_is_away_excludes_the_areas_of_the_settings_later(
    context: WorkerContext, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    file, sync, tries = tmp_path / "areas.geojson", excluded.sync, []
    file.write_text(json.dumps({"type": "Feature", "properties": {"name": "yard"}, "geometry": polygon()}))
    with context.database.write() as session:
        maps.ensure_map(session, "city")

    def away_at_first(*asked: Any) -> None:
        tries.append(asked)
        if len(tries) == 1:
            raise DatabaseError("away")
        sync(*asked)

    monkeypatch.setattr(sweeper.excluded, "sync", away_at_first)
    monkeypatch.setattr(sweeper, "sweep_once", lambda *_: sweeper.stop_requested.set())
    monkeypatch.setattr(sweeper, "stop_requested", threading.Event())
    sweeper.sweep_until_stopped(
        replace(context, settings=context.settings.model_copy(update={"excluded_areas": file, "sweep_s": 0.01}))
    )
    with context.database.read() as session:
        assert [row.name for row in excluded.of_map(session, "city")] == ["yard"]


def test_a_sweeper_does_not_start_with_a_file_of_areas_that_cannot_be_read(context: WorkerContext, tmp_path: Path) -> None:
    settings = context.settings.model_copy(update={"excluded_areas": tmp_path / "nowhere.geojson"})
    with pytest.raises(ConfigError, match="excluded_areas"):
        sweeper.sweep_until_stopped(replace(context, settings=settings))
