"""A drive 200 km from its map's anchor, or across any border, comes out of every way of the service to a millimetre."""

import json
from pathlib import Path

import laspy
import numpy as np
import pyproj
import pytest

from geodesy.closed_form import FAR, ecef_of, ecef_of_enu, lonlatheight_of
from wayloom.config.progress import silent
from wayloom.exports.las import projection_at
from wayloom.exports.laz import write_laz
from wayloom.exports.ply import write_ply
from wayloom.exports.points import batch_of_submap, batch_of_voxels
from wayloom.exports.track import export_geojson_track
from wayloom.files.ply import read_ply
from wayloom.geodesy import wgs84
from wayloom.geodesy.map_frame import MapFrame, map_frame_for
from wayloom.geometry import se3
from wayloom.pipeline.settings import WayloomSettings
from wayloom.stitching.merge import merge
from wayloom.store import drives, gate, maps
from wayloom.store.jobs import Claim
from wayloom.store.manifest import Manifest, ManifestFile
from wayloom.store.migrate import upgrade
from wayloom.submaps.files import load_submaps, save_submaps
from wayloom.submaps.submap import PlacedSubmap, Submap
from wayloom.tiles.points import decode_points
from wayloom_workers.__main__ import make_context
from wayloom_workers.publishing import TILES_FILE
from wayloom_workers.stage_hooks import StageAttempt
from wayloom_workers.stitching import stitch
from wayloom_workers.submap_rows import submap_row

COUNT = 300
MM = 1e-3


def made_points() -> np.ndarray:
    """(N, 3) m, in voxels of their own, no float lost in 32 bits."""
    grid = np.random.default_rng(0).permutation(80 * 80)[:COUNT]
    flat = np.column_stack([grid // 80, grid % 80]) - 40.0
    return np.column_stack([flat, np.random.default_rng(1).integers(-2, 20, COUNT)]) + 1.0 / 64.0


def made_submap(xyz: np.ndarray) -> Submap:
    label = np.full(COUNT, 2, np.uint8)
    T = np.stack([np.eye(4), np.eye(4)])
    T[:, :3, 3] = [[-40.0, 0.0, 0.0], [40.0, 0.0, 0.0]]
    return Submap(
        xyz=xyz.astype(np.float32), label=label, variance=np.full(COUNT, 0.01, np.float32), grey=np.zeros(COUNT, np.uint8),
        seen_ns=np.arange(COUNT), keyframe=np.zeros(COUNT, np.uint32), vote_start=np.arange(COUNT + 1, dtype=np.uint32),
        vote_class=label, vote_weight=np.full(COUNT, 0.1, np.float32), keyframe_frame=np.arange(2, dtype=np.uint32),
        keyframe_t_ns=np.array([0, 10**9]), T_submap_cam=T, length_m=80.0, points_left_out={},
    )  # fmt: skip


def T_ecef(lon_deg: float, lat_deg: float, height_m: float) -> np.ndarray:
    """(4, 4) of a tangent plane by the closed formulas."""
    corners = ecef_of_enu(np.vstack([np.zeros(3), np.eye(3)]), lon_deg, lat_deg, height_m)
    return se3.from_rotation_translation((corners[1:] - corners[0]).T.astype(np.float64), corners[0].astype(np.float64))


def apart(one: np.ndarray, other: np.ndarray) -> float:
    """m: how far each of `one` is from the nearest of `other`, at most; both Earth-centred."""
    difference = one.astype(np.float64)[:, None] - other.astype(np.float64)[None]
    return float(np.linalg.norm(difference, axis=2).min(axis=1).max())


@pytest.mark.parametrize("name", FAR)
def test_every_way_out_of_the_map_gives_the_true_place(name: str, tmp_path: Path) -> None:
    anchor, place = FAR[name]
    cell = map_frame_for(*place[:2])
    T_cell_submap = se3.inverse(T_ecef(cell.lon_deg, cell.lat_deg, cell.height_m)) @ T_ecef(*place)
    xyz = made_points()
    truth = ecef_of_enu(xyz, *place)
    save_submaps([PlacedSubmap(made_submap(xyz), T_cell_submap, np.eye(6) * 0.01, "far", cell)], tmp_path / "submaps")
    (item,) = load_submaps(tmp_path / "submaps")
    context = make_context(WayloomSettings(data_dir=tmp_path / "data", map_origin=anchor))
    upgrade(context.database)
    with context.database.write() as session:
        manifest = Manifest(name="far", files=(ManifestFile(path="log/a", size=1, sha256="0" * 64),))
        drive_id = drives.register(session, manifest, "city")[0].id
        context.blobs.put(item.submap.encoded)
        maps.place_submaps(session, drive_id, [submap_row(drive_id, "city", 0, item)])
        gate.judge(session, drive_id, "A", [], "merge")
    (tmp_path / "out").mkdir()
    claim = Claim(1, 1, "stitch", 1, None, "city", {})
    stitch(StageAttempt(context, claim, None, None, tmp_path, {}, tmp_path / "out", silent))
    said = json.loads((tmp_path / "out" / TILES_FILE).read_text())
    assert said["drives"] == [drive_id]

    tiles = [decode_points(context.blobs.get(tile["digest"])) for tile in said["tiles"] if tile["layer"] == "points"]
    origins = [(tile.origin.lon_deg, tile.origin.lat_deg, tile.origin.height_m) for tile in tiles]
    shown = np.vstack([ecef_of_enu(tile.position, *origin) for tile, origin in zip(tiles, origins, strict=True)])
    assert len(shown) == COUNT
    assert apart(shown, truth) < 0.005 * np.sqrt(3.0) + MM  # a point tile is rounded to 1 cm

    lon_lat = lonlatheight_of(truth)[:, :2]
    with context.database.read() as session:
        for lon, lat in lon_lat[:20]:
            assert len(maps.submaps(session, "city", (lon - 1e-8, lat - 1e-8, lon + 1e-8, lat + 1e-8))) == 1
        beside = 0.002 / np.cos(np.radians(place[1]))
        assert maps.submaps(session, "city", (place[0] + beside, place[1], place[0] + beside + 0.1, place[1] + 0.1)) == []
    west, south, east, north = said["bounds"]
    assert (east - west) % 360.0 < 0.01
    assert south < place[1] < north
    context.database.close()


@pytest.mark.parametrize("name", FAR)
def test_every_export_of_a_far_cloud_gives_the_true_place(name: str, tmp_path: Path) -> None:
    anchor, place = FAR[name]
    frame, T_anchor = MapFrame(*anchor), T_ecef(*anchor)
    T_anchor_submap = se3.inverse(T_anchor) @ T_ecef(*place)
    xyz = made_points()
    truth = ecef_of_enu(xyz, *place)
    voxels = merge([PlacedSubmap(made_submap(xyz), T_anchor_submap, np.eye(6), "far", frame)])
    assert np.linalg.norm(T_anchor_submap[:3, 3]) > 180_000.0
    assert apart(ecef_of_enu(voxels.points_enu, *anchor), truth) < MM

    middle = T_anchor_submap[:3, 3]
    write_laz(tmp_path / "cloud.laz", [batch_of_voxels(voxels)], projection_at(middle, frame), {})
    cloud = laspy.read(tmp_path / "cloud.laz")
    crs = cloud.header.parse_crs()
    assert cloud.header.system_identifier == "ellipsoidal heights"
    lon, lat = pyproj.Transformer.from_crs(crs, crs.geodetic_crs, always_xy=True).transform(np.array(cloud.x), np.array(cloud.y))
    assert (
        apart(ecef_of(np.column_stack([lon, lat, cloud.z])), truth) < 0.0005 * np.sqrt(3.0) + 0.2 * MM
    )  # a LAZ is rounded to 1 mm
    assert crs.utm_zone in zones_of(place)

    write_ply(tmp_path / "cloud.ply", [batch_of_voxels(voxels)], middle, frame)
    origin = (tmp_path / "cloud.ply").read_bytes()[:400].split(b"ENU at ")[1].split(b" (")[0].split()
    assert apart(ecef_of_enu(read_ply(tmp_path / "cloud.ply").points, *map(float, origin)), truth) < MM

    T = np.tile(np.eye(4), (COUNT, 1, 1))
    T[:, :3, 3] = voxels.points_enu
    export_geojson_track(tmp_path / "track.geojson", T, frame)
    geometry = json.loads((tmp_path / "track.geojson").read_text())["features"][0]["geometry"]
    crosses = name == "on the antimeridian"
    assert geometry["type"] == ("MultiLineString" if crosses else "LineString")
    lines = geometry["coordinates"] if crosses else [geometry["coordinates"]]
    line = np.array([point for part in lines for point in part if abs(point[0]) != 180.0])
    assert apart(ecef_of(line), truth) < MM


def zones_of(place: tuple[float, float, float]) -> set[str]:
    """The UTM zones at a place; two on a border."""
    side = "N" if place[1] > 0 else "S"
    return {f"{int((place[0] + shift + 180.0) // 6) % 60 + 1}{side}" for shift in (-1e-6, 1e-6)}


def test_a_cloud_of_two_zones_is_one_file_in_the_zone_of_its_place(tmp_path: Path) -> None:
    frame, place = MapFrame(12.5, 48.5, 0.0), (12.0, 48.0, 500.0)
    T = se3.inverse(T_ecef(12.5, 48.5, 0.0)) @ T_ecef(*place)
    item = PlacedSubmap(made_submap(made_points()), T, np.eye(6), "two zones", frame)
    lon = wgs84.lonlatheight_from_enu(item.points_enu(), frame)[:, 0]
    assert lon.min() < 12.0 < lon.max()
    for east_m, zone in ((-1.0, "32N"), (1.0, "33N")):
        at = se3.transform(T, np.array([[east_m, 0.0, 0.0]]))[0]
        write_laz(tmp_path / "cloud.laz", [batch_of_submap(item)], projection_at(at, frame), {})
        assert laspy.read(tmp_path / "cloud.laz").header.parse_crs().utm_zone == zone
