"""The map's markings and kerbs: found on the merged ground of regions, each in one of them, and gone with their drives."""

import itertools
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import mapbox_vector_tile
import numpy as np
import pytest
from sqlalchemy import select

from wayloom.geodesy import wgs84
from wayloom.stitching.marking_files import AROUND_M, lines_of, read_features
from wayloom.stitching.region_grid import REGION_M, RegionKey
from wayloom.store import drives, garbage, map_versions, maps
from wayloom.store.spatial.feature_tables import FEATURE_TABLES
from wayloom.tiles.feature_layers import KERBS, MARKINGS
from wayloom.tiles.grid import lonlat_from_unit
from wayloom_workers import region_marking
from wayloom_workers.publishing import listed_tiles
from wayloom_workers.stage_hooks import WorkerContext
from workers.conftest import NewService, with_finest_tiles, with_one_database
from workers.test_ground_of_map import FRAME, add
from workers.test_stitching import published

START, END = 100.0, 182.0
"""Of a drive in two pieces. A dash of the street lies across the border of two regions, from 126 to 129 m; it sees the last, from
180 m on, to 182 m."""
FIRST, SECOND = {"start": START, "t_s": 100}, {"start": START + 10.0, "t_s": 5000, "gain": 0.8, "seed": 7, "yaw": 3.3}
MIDDLE_M, KERBS_M = 30.0, (26.0, 34.0)


def markings(context: WorkerContext) -> dict[RegionKey, str]:
    with context.database.read() as session:
        return dict(map_versions.regions_with(session, "city", maps.version(session, "city").version, "markings"))


def features(context: WorkerContext) -> dict[RegionKey, list[dict[str, Any]]]:
    return {key: read_features(context.blobs.get(digest), digest) for key, digest in markings(context).items()}


def of_kind(found: Sequence[dict[str, Any]], kind: str) -> list[dict[str, Any]]:
    return [one for one in found if one["properties"]["kind"] == kind]


def in_tables(context: WorkerContext) -> list[tuple[RegionKey, float]]:
    """Region and length of what the database's tables of markings and kerbs show."""
    tables = [one.table.c for one in FEATURE_TABLES if one.source == "markings"]
    with context.database.read() as session:
        rows = [row for at in tables for row in session.execute(select(at.east, at.north, at.length_m))]
    return sorted(((east, north), length) for east, north, length in rows)


def enu(feature: dict[str, Any]) -> np.ndarray:
    (line,) = lines_of(feature["geometry"])
    return np.asarray(wgs84.enu_from_lonlatheight(np.array(line), FRAME))


def tiles(context: WorkerContext, zoom: int) -> dict[tuple[int, int], dict[str, Any]]:
    with context.database.read() as session:
        rows = map_versions.all_current_tiles(session, "city")
    return {
        key[2:]: mapbox_vector_tile.decode(context.blobs.get(entry.digest), default_options={"y_coord_down": True})
        for key, entry in rows.items()
        if key[:2] == (MARKINGS, zoom)
    }


def test_each_dash_and_each_kerb_lies_in_one_region_where_it_is(context: WorkerContext, tmp_path: Path) -> None:
    add(context, "a", **FIRST)
    published(context, tmp_path / "1")
    found = features(context)
    assert set(found) == {(1, 0), (2, 0)}
    everything = [one for key in sorted(found) for one in found[key]]
    middles = sorted(enu(one)[:, :2].mean(axis=0).tolist() for one in of_kind(everything, "dash"))
    wanted = [*(x + 1.5 for x in range(102, 180, 6)), 181.0]
    assert np.abs(np.array(middles) - [[x, MIDDLE_M] for x in wanted]).max() < 0.05
    (across,) = [one for one in of_kind(everything, "dash") if abs(enu(one)[0, 0] - 127.5) < 2.0]
    assert across["properties"]["length_m"] == pytest.approx(3.0, abs=0.1)
    assert across["properties"]["width_m"] == pytest.approx(0.12, abs=0.03)
    assert across["properties"]["sigma_place_m"] == pytest.approx(0.02, abs=0.005)
    assert across in found[1, 0]
    for y in KERBS_M:
        west, east = (
            [enu(one) for one in of_kind(found[key], "kerb") if abs(enu(one)[0, 1] - y) < 1.0] for key in ((1, 0), (2, 0))
        )
        assert sum(np.ptp(one[:, 0]) for one in [*west, *east]) == pytest.approx(END - START, abs=3.0)
        ends = [np.concatenate(side)[:, 0] for side in (west, east)]
        assert ends[0].max() == pytest.approx(2 * REGION_M, abs=0.002)
        assert ends[1].min() == pytest.approx(2 * REGION_M, abs=0.002)
        assert np.abs(np.concatenate([*west, *east])[:, 1] - y).max() < 0.15
    heights = [one["properties"]["height_m"] for one in of_kind(everything, "kerb")]
    np.testing.assert_allclose(heights, 0.12, atol=0.02)
    assert in_tables(context) == sorted((key, one["properties"]["length_m"]) for key in found for one in found[key])


@with_one_database
def test_threads_of_a_stitch_change_no_byte(context: WorkerContext, new_service: NewService, tmp_path: Path) -> None:
    shared = new_service(tmp_path / "shared")
    shared = replace(shared, settings=shared.settings.model_copy(update={"threads": 3}))
    for service in (context, shared):
        add(service, "a", **FIRST)
        published(service, tmp_path / f"1{service.settings.threads}")
        add(service, "b", **SECOND)
    assert published(context, tmp_path / "2") == published(shared, tmp_path / "3")
    assert markings(context) == markings(shared) != {}


@with_finest_tiles
def test_vector_tiles_show_them_whole_at_every_zoom(context: WorkerContext, tmp_path: Path) -> None:
    add(context, "a", **FIRST)
    layers = published(context, tmp_path / "1")["about"][4]  # type: ignore[index]
    assert (layers[MARKINGS]["min_zoom"], layers[MARKINGS]["max_zoom"]) == (16, 20)
    for zoom in (16, 20):
        drawn = {KERBS: 0.0, MARKINGS: 0.0}
        for (x, y), tile in tiles(context, zoom).items():
            for name, layer in tile.items():
                for feature in layer["features"]:
                    line = np.array(feature["geometry"]["coordinates"], np.float64)
                    line = np.vstack([np.linspace(*ends, 200) for ends in itertools.pairwise(line)])
                    inside = ((line >= 0.0) & (line < 4096.0)).all(axis=1)
                    lon_lat = lonlat_from_unit((line / 4096.0 + (x, y)) / (1 << zoom))
                    places = wgs84.enu_from_lonlatheight(np.column_stack([lon_lat, np.full(len(line), 103.0)]), FRAME)
                    steps = np.linalg.norm(np.diff(places[:, :2], axis=0), axis=1)
                    drawn[name] += float(steps[inside[1:]].sum())
                    assert feature["properties"]["sigma_m"] > 0.0
                    assert ("height_m" in feature["properties"]) == (name == KERBS)
        everything = [one["properties"] for found in features(context).values() for one in found]
        for name, kerb in ((KERBS, True), (MARKINGS, False)):
            whole = sum(one["length_m"] for one in everything if (one["kind"] == "kerb") == kerb)
            assert drawn[name] == pytest.approx(whole, rel=0.02)


@with_one_database
def test_no_order_of_arrival_changes_a_byte_of_the_markings(new_service: NewService, tmp_path: Path) -> None:
    one, other = new_service(tmp_path / "one"), new_service(tmp_path / "other")
    add(one, "a", **FIRST)
    published(one, tmp_path / "1")
    alone = markings(one)
    add(one, "b", **SECOND)
    stepwise = published(one, tmp_path / "2")
    add(other, "b", **SECOND)
    add(other, "a", **FIRST)
    assert published(other, tmp_path / "3") == stepwise
    assert markings(one) == markings(other) != alone


def test_a_removed_drive_leaves_the_markings_of_the_others_alone(new_service: NewService, tmp_path: Path) -> None:
    context = new_service(tmp_path / "data")
    add(context, "a", **FIRST)
    without, alone = published(context, tmp_path / "1"), markings(context)
    two = add(context, "b", **SECOND)
    published(context, tmp_path / "2")
    gone = {*markings(context).values()} - {*alone.values()}
    assert gone
    with context.database.write() as session:
        drives.request_removal(session, two)
    assert published(context, tmp_path / "3") == without
    assert markings(context) == alone
    with context.database.write() as session:
        drives.delete_rows(session, two)
    garbage.drop_forgotten(context.database, context.blobs, lambda: ())
    assert not any(context.blobs.has(digest) for digest in gone)
    assert all(context.blobs.has(digest) for digest in alone.values())


@with_one_database
def test_a_second_drive_has_markings_found_only_where_the_ground_around_has_changed(
    context: WorkerContext, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    add(context, "a", **FIRST)
    published(context, tmp_path / "1")
    before = markings(context)
    looked: list[RegionKey] = []
    real = region_marking.region_markings
    monkeypatch.setattr(region_marking, "region_markings", lambda key, *rest: looked.append(key) or real(key, *rest))
    add(context, "far", start=500.0, pieces=1)
    published(context, tmp_path / "2")
    assert min(east for east, _ in looked) >= (500.0 - REGION_M - 26.0) // REGION_M - 1
    assert before.items() < markings(context).items()
    with context.database.read() as session:
        new = [row for row in map_versions.changes(session, "city", 2)[0] if row.layer == MARKINGS and row.z == 20]
        held = [key for key in map_versions.all_current_tiles(session, "city") if key[:2] == (MARKINGS, 20)]
    assert 0 < len(new) < 0.5 * len(held)


@with_one_database
def test_a_region_whose_neighbour_alone_has_changed_gets_its_markings_anew(context: WorkerContext, tmp_path: Path) -> None:
    """The second drive ends the dash that the first one has only begun to see, in the next region."""
    add(context, "a", start=85.4, pieces=1)
    published(context, tmp_path / "1")
    with context.database.read() as session:
        first = map_versions.current_regions(session, "city")[1, 0]
    add(context, "b", start=128.1 + 26.0, pieces=1, t_s=5000, seed=7)
    published(context, tmp_path / "2")
    add(context, "c", start=127.4, pieces=1, t_s=9000, seed=9)
    published(context, tmp_path / "3")
    everything = [one for found in features(context).values() for one in found]
    across = [enu(one) for one in of_kind(everything, "dash") if abs(enu(one)[:, 0].mean() - 127.5) < 2.0]
    assert [np.ptp(one[:, 0]) for one in across] == pytest.approx([3.0], abs=0.1)
    assert first.markings != markings(context)[1, 0]


def test_markings_reach_no_further_than_the_square_in_which_they_are_looked_for(context: WorkerContext, tmp_path: Path) -> None:
    add(context, "a", **FIRST)
    published(context, tmp_path / "1")
    for key, found in features(context).items():
        for one in found:
            places = enu(one)[:, :2] - REGION_M * np.array(key)
            assert places.min() > -AROUND_M
            assert places.max() < REGION_M + AROUND_M


def test_the_markings_of_a_list_that_waits_to_be_published_are_kept(context: WorkerContext) -> None:
    folder = context.folders.map("city") / "stages" / "stitch" / "key"
    folder.mkdir(parents=True)
    entry = {
        "tiles": [],
        "regions": [
            {"digest": "r", "ground": "g", "markings": "m", "areas": "a", "objects": "o"},
            {"digest": "s", "ground": "", "markings": ""},
        ],
    }
    (folder / "tiles.json").write_text(json.dumps(entry))
    assert [*listed_tiles(context.folders)] == ["r", "s", "g", "m", "a", "o"]
