"""The map's tiles depend on which drives are in it: not on which came first, nor on what was there before."""

import json
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from wayloom.config.gate import gate_of
from wayloom.config.progress import silent
from wayloom.geodesy import wgs84
from wayloom.geodesy.map_frame import MapFrame, map_frame_for
from wayloom.pipeline.settings import WayloomSettings
from wayloom.store import drives, gate, maps
from wayloom.store.jobs import Claim
from wayloom.store.manifest import Manifest, ManifestFile
from wayloom.store.migrate import upgrade
from wayloom.submaps.submap import PlacedSubmap, Submap
from wayloom_workers.__main__ import make_context
from wayloom_workers.production import submap_row
from wayloom_workers.publishing import TILES_FILE, tidy
from wayloom_workers.stage_hooks import StageAttempt, WorkerContext
from wayloom_workers.stitching import stitch

LON, LAT = 8.4, 48.9995


@pytest.fixture
def context(tmp_path: Path) -> Iterator[WorkerContext]:
    made = make_context(WayloomSettings(data_dir=tmp_path / "data"))
    upgrade(made.database)
    yield made
    made.database.close()


def placed(drive_id: str, seed: int, lat: float = LAT) -> PlacedSubmap:
    """A street of 60 m with 500 points, in the frame of its own cell."""
    rng = np.random.default_rng(seed)
    xyz = (rng.uniform(-1.0, 1.0, (500, 3)) * (30.0, 30.0, 2.0)).astype(np.float32)
    label = rng.choice([0, 1, 2, 8], 500).astype(np.uint8)
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


def add(context: WorkerContext, name: str, seed: int, lat: float = LAT, grade: str = "A") -> str:
    """A drive of a grade, with one placed submap."""
    with context.database.write() as session:
        manifest = Manifest(name=name, files=(ManifestFile(path="log/a", size=1, sha256="0" * 64),))
        drive_id = drives.register(session, manifest, "city")[0].id
        item = placed(drive_id, seed, lat)
        context.blobs.put(item.submap.encoded)
        maps.place_submaps(session, drive_id, [submap_row(drive_id, "city", 0, item)])
        gate.judge(session, drive_id, grade, [], gate_of(grade))
    return drive_id


def stitched(context: WorkerContext, out_dir: Path) -> dict[str, object]:
    """What `stitch` writes for the map as it is."""
    out_dir.mkdir()
    stitch(StageAttempt(context, Claim(1, 1, "stitch", 1, None, "city", {}), None, None, out_dir, {}, out_dir, silent))
    found: dict[str, object] = json.loads((out_dir / TILES_FILE).read_text())
    return found


def test_the_order_in_which_drives_came_changes_no_byte(context: WorkerContext, tmp_path: Path) -> None:
    other = make_context(WayloomSettings(data_dir=tmp_path / "other"))
    upgrade(other.database)
    for name, seed in (("a", 1), ("b", 2), ("c", 3)):
        add(context, name, seed)
    for name, seed in (("c", 3), ("a", 1), ("b", 2)):
        add(other, name, seed)
    assert stitched(context, tmp_path / "1") == stitched(other, tmp_path / "2")
    other.database.close()


def test_a_map_from_which_a_drive_was_removed_is_the_map_without_it(context: WorkerContext, tmp_path: Path) -> None:
    add(context, "a", 1)
    without = stitched(context, tmp_path / "1")
    removed = add(context, "b", 2)
    assert stitched(context, tmp_path / "2") != without
    with context.database.write() as session:
        drives.request_removal(session, removed)
    assert stitched(context, tmp_path / "3") == without


def test_a_map_without_the_held_and_the_quarantined_drives_is_the_map_of_the_others(context: WorkerContext, tmp_path: Path) -> None:
    add(context, "a", 1)
    alone = stitched(context, tmp_path / "1")
    held, quarantined = add(context, "b", 2, grade="D"), add(context, "c", 3, lat=LAT + 3.0, grade="E")
    assert stitched(context, tmp_path / "2") == alone
    with context.database.write() as session:
        gate.release(session, held, "Ada", "looked at it")
    assert held in stitched(context, tmp_path / "3")["drives"]  # type: ignore[operator]
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
    without = stitched(context, tmp_path / "1")
    far = add(context, "far", 3, lat=far_lat)
    said = stitched(context, tmp_path / "2")
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
    needed = {tile["digest"] for tile in said["tiles"]}  # type: ignore[attr-defined]
    with context.database.read() as session:
        needed |= {row.digest for row in maps.submaps(session, "city")}
    assert needed < set(context.blobs.older_than(0.0))
    claim = Claim(2, 1, "publish", 1, None, "city", {})
    tidy(StageAttempt(context, claim, None, None, tmp_path, {"stitch": "key"}, tmp_path, silent))
    assert set(context.blobs.older_than(0.0)) == needed
    assert [path.name for path in stitches.iterdir()] == ["key"]


def test_a_map_without_drives_has_no_tiles(context: WorkerContext, tmp_path: Path) -> None:
    with context.database.write() as session:
        maps.ensure_map(session, "city")
    said = stitched(context, tmp_path / "1")
    assert (said["tiles"], said["bounds"], said["drives"]) == ([], None, [])
