"""The map's objects and areas: each in one region, the same in every order of arrival, and gone with their drives."""

import itertools
import json
from pathlib import Path
from typing import Any

import mapbox_vector_tile
import numpy as np
import pytest
from shapely.geometry import Polygon
from shapely.ops import unary_union

from objects.made_sightings import some_sightings
from wayloom.geodesy import wgs84
from wayloom.geometry import se3
from wayloom.objects.files import save_all
from wayloom.objects.types import POLE, SIGN
from wayloom.stitching.marking_files import lines_of, read_features
from wayloom.stitching.region_grid import REGION_M, RegionKey
from wayloom.store import drives, garbage, map_versions, maps
from wayloom.store.tables.drives import Job
from wayloom.tiles.feature_layers import AREAS, OBJECTS
from wayloom_workers import region_merging
from wayloom_workers.drive_sightings import OBJECTS as OBJECTS_STAGE
from wayloom_workers.stage_hooks import WorkerContext
from workers.conftest import NewService, with_one_database
from workers.test_ground_of_map import FRAME
from workers.test_ground_of_map import add as add_with_ground
from workers.test_stitching import published

FIRST, SECOND = {"start": 100.0, "t_s": 100}, {"start": 110.0, "t_s": 5000, "gain": 0.8, "seed": 7, "yaw": 3.3}
THINGS = np.array([[104.0, 36.0, 2.0], [120.0, 24.0, 2.2], [127.95, 36.0, 2.4], [128.4, 24.0, 4.0], [150.0, 24.0, 3.0]])
"""m, in the map's frame. The border of two regions lies at 128 m."""
KINDS = np.array([POLE, POLE, POLE, SIGN, POLE])


def add(context: WorkerContext, name: str, seen: tuple[int, ...] = (0, 1, 2, 3, 4), off_m: float = 0.0, **how: Any) -> str:
    """A drive with its ground, in whose first submap these things were seen, off by some metres to the east."""
    drive_id = add_with_ground(context, name, **how)
    folder = context.folders.drive(drive_id) / "stages" / OBJECTS_STAGE / "key"
    with context.database.write() as session:
        row = maps.submaps_of(session, drive_id)[0]
        points = se3.transform(se3.inverse(np.array(row.T_enu_submap)), THINGS[[*seen]] + [off_m, 0.0, 0.0])
        save_all([some_sightings(points, KINDS[[*seen]].tolist(), name=row.digest)], folder)
        about = {"queue": "odometry", "state": "done", "position": 0, "payload": {"key": "key"}, "created_at": 0.0}
        session.add(Job(stage=OBJECTS_STAGE, drive_id=drive_id, **about))
    return drive_id


def held(context: WorkerContext, of: str) -> dict[RegionKey, str]:
    with context.database.read() as session:
        return dict(map_versions.regions_with(session, "city", maps.version(session, "city").version, of))


def features(context: WorkerContext, of: str) -> dict[RegionKey, list[dict[str, Any]]]:
    return {key: read_features(context.blobs.get(digest), digest) for key, digest in held(context, of).items()}


def enu(feature: dict[str, Any]) -> list[np.ndarray]:
    """Its lines in the map's frame."""
    return [np.asarray(wgs84.enu_from_lonlatheight(np.array(line), FRAME)) for line in lines_of(feature["geometry"])]


def polygon(feature: dict[str, Any]) -> Polygon:
    outer, *holes = (np.round(ring[:, :2], 3) for ring in enu(feature))
    return Polygon(outer, holes)


def tiles(context: WorkerContext, layer: str, zoom: int) -> dict[tuple[int, int], dict[str, Any]]:
    with context.database.read() as session:
        rows = map_versions.all_current_tiles(session, "city")
    return {
        key[2:]: mapbox_vector_tile.decode(context.blobs.get(entry.digest), default_options={"y_coord_down": True})
        for key, entry in rows.items()
        if key[:2] == (layer, zoom)
    }


def test_areas_cover_the_street_once_join_at_the_border_and_each_object_is_in_its_region(
    context: WorkerContext, tmp_path: Path
) -> None:
    drive_id = add(context, "a", **FIRST)
    layers = published(context, tmp_path / "1")["about"][4]  # type: ignore[index]
    assert {name: (layers[name]["min_zoom"], layers[name]["max_zoom"]) for name in (AREAS, OBJECTS)} == {
        AREAS: (14, 18), OBJECTS: (15, 18),
    }  # fmt: skip
    areas = features(context, "areas")
    everything = [one for key in sorted(areas) for one in areas[key]]
    shapes = [polygon(one) for one in everything]
    assert set(areas) == {(1, 0), (2, 0)}
    assert all(shape.is_valid for shape in shapes)
    assert unary_union(shapes).area == pytest.approx(sum(shape.area for shape in shapes), abs=1e-6)
    roads = [shape for shape, one in zip(shapes, everything, strict=True) if one["properties"]["kind"] == "road"]
    assert sum(one.area for one in roads) == pytest.approx(82.0 * 8.0, rel=0.01)
    assert unary_union(shapes).area == pytest.approx(82.0 * 18.0, rel=0.01)
    assert unary_union(roads).geom_type == "Polygon"  # one street in two regions, without a gap
    assert min(one["properties"]["confidence"] for one in everything) > 0.9
    heights = np.vstack([ring for one in everything for ring in enu(one)])
    off = np.abs(heights[:, 1] - 30.0)
    clear = np.abs(off - 4.0) > 0.3
    wanted = 0.02 * heights[:, 0] + 0.01 * (heights[:, 1] - 30.0) + 0.12 * (off > 4.0)
    assert np.abs(heights[clear, 2] - wanted[clear]).max() < 0.03

    objects = features(context, "objects")
    assert {key: len(found) for key, found in objects.items()} == {(1, 0): 3, (2, 0): 2}
    found = sorted((enu(one)[0][0].tolist(), one) for one in itertools.chain(*objects.values()))
    np.testing.assert_allclose([place for place, _ in found], sorted(THINGS.tolist()), atol=0.01)
    for place, one in found:
        assert one["id"].startswith(f"{int(place[0] // REGION_M)}.0.{one['properties']['kind']}-")
        assert one["properties"]["drives"] == [drive_id]
    for zoom in (15, 18):
        drawn = {
            one["properties"]["id"]
            for tile in tiles(context, OBJECTS, zoom).values()
            for one in tile["objects"]["features"]
            if all(0 <= value < 4096 for value in one["geometry"]["coordinates"])
        }
        assert drawn == {one["id"] for _, one in found}
        rings = [one for tile in tiles(context, AREAS, zoom).values() for one in tile["areas"]["features"]]
        assert {one["properties"]["kind"] for one in rings} == {"road", "sidewalk"}


@with_one_database
def test_no_order_of_arrival_changes_a_byte_of_objects_and_areas(new_service: NewService, tmp_path: Path) -> None:
    one, other = new_service(tmp_path / "one"), new_service(tmp_path / "other")
    add(one, "a", **FIRST)
    published(one, tmp_path / "1")
    alone = held(one, "objects"), held(one, "areas")
    add(one, "b", off_m=0.06, **SECOND)
    stepwise = published(one, tmp_path / "2")
    add(other, "b", off_m=0.06, **SECOND)
    add(other, "a", **FIRST)
    assert published(other, tmp_path / "3") == stepwise
    both = held(one, "objects"), held(one, "areas")
    assert both == (held(other, "objects"), held(other, "areas"))
    assert all(after != before for after, before in zip(both, alone, strict=True))
    counts = [len(one["properties"]["drives"]) for found in features(one, "objects").values() for one in found]
    assert counts == [2] * len(THINGS)


def test_a_removed_drive_leaves_the_objects_and_areas_of_the_others_alone(new_service: NewService, tmp_path: Path) -> None:
    context = new_service(tmp_path / "data")
    add(context, "a", seen=(0, 2), **FIRST)
    without, alone = published(context, tmp_path / "1"), {of: held(context, of) for of in ("objects", "areas")}
    two = add(context, "b", **SECOND)
    published(context, tmp_path / "2")
    gone = {digest for of in alone for digest in {*held(context, of).values()} - {*alone[of].values()}}
    assert len(gone) > 2
    with context.database.write() as session:
        drives.request_removal(session, two)
    assert published(context, tmp_path / "3") == without
    assert {of: held(context, of) for of in alone} == alone
    with context.database.write() as session:
        drives.delete_rows(session, two)
    garbage.drop_forgotten(context.database, context.blobs, lambda: ())
    assert not any(context.blobs.has(digest) for digest in gone)
    assert all(context.blobs.has(digest) for found in alone.values() for digest in found.values())


@with_one_database
def test_a_drive_elsewhere_makes_no_objects_anew_and_a_damaged_file_shows_none(
    context: WorkerContext, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = add(context, "a", **FIRST)
    (path,) = (context.folders.drive(first) / "stages" / OBJECTS_STAGE / "key").glob("*.objects")
    published(context, tmp_path / "1")
    before = held(context, "objects")
    made: list[RegionKey] = []
    real = region_merging.region_objects
    monkeypatch.setattr(region_merging, "region_objects", lambda key, *rest: made.append(key) or real(key, *rest))
    far = add_with_ground(context, "far", start=640.0, pieces=1)
    published(context, tmp_path / "2")
    assert made == []
    assert held(context, "objects") == before
    path.write_bytes(path.read_bytes()[:-1])
    index = path.parent / "index.json"
    index.write_text(json.dumps({**json.loads(index.read_text()), "version": 9}))
    add(context, "b", seen=(), **SECOND)
    with context.database.write() as session:
        drives.request_removal(session, far)
    published(context, tmp_path / "3")
    assert held(context, "objects") == {}
